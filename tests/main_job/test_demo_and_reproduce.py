"""``treadwatch demo`` and ``treadwatch reproduce`` as a newcomer runs them, in processes of their own."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import httpx
import numpy as np
import pytest
from faces import compared
from in_process_command import Run
from matplotlib import image
from tiny_fleet import DEAD, WORN

from api.settings import Settings
from api.terminal.demo import free_port, serving_api
from estimation.values.geometry import COMBINATIONS
from ingest.simulator.scenario_file import load_scenario

TREADWATCH = Path(sys.executable).with_name("treadwatch")


def in_a_process(
    *arguments: str | Path, cwd: Path, columns: int = 200, seconds: float = 300.0
) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("TREADWATCH_")} | {"COLUMNS": str(columns)}
    command = [str(TREADWATCH), *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=cwd, env=environment, timeout=seconds
    )


@pytest.mark.slow
def test_the_demo_prints_its_table_and_ends(scenario_file: Path, tmp_path: Path) -> None:
    arguments = ("demo", "--once", "--scenario", scenario_file, "--folder", "own", "--port", "0")
    done = in_a_process(*arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    number = r"(\d\.\d{3})"
    line = re.search(rf"{WORN}\s+91,00[01]\s+{number}\s+{number} \[{number}, {number}\]\s+(yes|no)", done.stdout)
    assert line is not None, done.stdout
    true, value, low, high = map(float, line.groups()[:4])
    assert abs(true - value) < 0.03
    assert low - 0.02 < true < high + 0.02
    dead, *_ = (row for row in done.stdout.splitlines() if row.strip().startswith(DEAD))
    assert "no_data (critical)" in dead
    assert "conicity_limit (critical, unknown)" in dead
    _, to_do = done.stdout.split("what to do, the most urgent first")
    (first, *_) = (line.strip() for line in to_do.splitlines() if line.strip())
    assert first.startswith(f"{DEAD} (vehicle ")
    assert "limit exceeded when it could be assessed last: turn the wheelset" in first
    assert "http://" not in done.stdout  # nothing is served any more
    assert (tmp_path / "own" / "data" / "treadwatch.sqlite").is_file()


@pytest.mark.slow
def test_no_two_faces_of_the_demo_differ_in_a_number(tmp_path: Path) -> None:
    done = in_a_process("demo", "--once", "--folder", "own", "--port", "0", cwd=tmp_path, seconds=1800.0)
    assert done.returncode == 0, done.stderr
    port = free_port("127.0.0.1", 0)
    settings = Settings(data_dir=tmp_path / "own" / "data", port=port, log_level="warning", _env_file=None)
    with serving_api(settings) as url, httpx.Client(base_url=url, timeout=60.0) as client:
        found = compared(client, tmp_path)
    assert found.differences == []
    assert found.seen >= {"over_limit", "due", "fine", "conicity_limit", "measure"}


@pytest.mark.slow
def test_the_demo_shows_a_signature_where_geometry_is_silent_and_low_adhesion(tmp_path: Path) -> None:
    arguments = ("demo", "--once", "--scenario", "demo_autumn", "--folder", "own", "--port", "0")
    done = in_a_process(*arguments, cwd=tmp_path, columns=400)
    assert done.returncode == 0, done.stderr
    signature = re.search(
        r"WS-2041: no geometry .*says (\d\.\d{3}) \[(\d\.\d{3}), (\d\.\d{3})\], true (\d\.\d{3})", done.stdout
    )
    assert signature is not None, done.stdout
    value, low, high, true = map(float, signature.groups())
    assert abs(value - true) < 0.02
    assert low - 0.01 < true < high + 0.01
    adhesion = re.search(
        r"KM21: alert of low adhesion in the feed, at (\d+) to (\d+) m, friction (\S+) to", done.stdout
    )
    assert adhesion is not None, done.stdout
    begin, end, friction = map(float, adhesion.groups())
    assert abs(begin - 2400.0) <= 100.0
    assert abs(end - 2800.0) <= 100.0
    assert abs(friction - 0.08) < 0.04
    found = re.search(r"(\d+) of 13 intervals cover", done.stdout)
    assert found is not None
    assert int(found.group(1)) >= 12


@pytest.mark.parametrize("kind", ["folder", "file", "link"])
def test_the_demo_refuses_what_is_not_its_own(treadwatch: Run, tmp_path: Path, kind: str) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.txt").write_text("years of work")
    folder = {"folder": precious, "file": precious / "thesis.txt", "link": tmp_path / "link"}[kind]
    if kind == "link":
        folder.symlink_to(precious)
    done = treadwatch("demo", "--once", "--folder", folder)
    assert done.returncode == 2
    assert done.stderr.startswith(f"treadwatch: {folder} ")
    assert "--folder" in done.stderr
    assert (precious / "thesis.txt").read_text() == "years of work"
    assert [path.name for path in precious.iterdir()] == ["thesis.txt"]


def test_a_scenario_that_cannot_be_read_leaves_the_last_demo_alone(treadwatch: Run, tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir()
    (own / "made-by-treadwatch-demo").touch()
    (own / "table.txt").write_text("seen")
    (tmp_path / "wrong.toml").write_text('name = "wrong"\nsped = 3\n')
    done = treadwatch("demo", "--once", "--scenario", "wrong.toml", "--folder", own)
    assert done.returncode == 2
    assert done.stderr.startswith("treadwatch: wrong.toml")
    assert (own / "table.txt").read_text() == "seen"


def test_a_vehicle_that_cannot_be_registered_is_refused_before_anything_is_simulated(
    treadwatch: Run, scenario_file: Path, tmp_path: Path
) -> None:
    text = scenario_file.read_text(encoding="utf-8")
    code = load_scenario(str(scenario_file)).vehicles[0].code
    (tmp_path / "wrong.toml").write_text(text.replace(f'"{code}"', '"N__1"'), encoding="utf-8")
    done = treadwatch("demo", "--once", "--scenario", "wrong.toml", "--folder", "own")
    assert done.returncode == 2
    assert "'N__1' has '__'" in done.stderr
    assert not list((tmp_path / "own").rglob("*.blf"))


def test_figures_need_a_folder(treadwatch: Run, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    done = treadwatch("reproduce", "--out", "taken")
    assert done.returncode == 2
    assert done.stderr.startswith("treadwatch: field '--out': taken: ")


@pytest.mark.slow
def test_the_figures_are_drawn_and_their_numbers_are_true(tmp_path: Path) -> None:
    done = in_a_process("reproduce", "--seconds", "120", "--out", "figures", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    out = tmp_path / "figures"
    for name in ("figure_3.png", "figure_4.png", "figure_6.png", "figure_7.png"):
        pixels = image.imread(out / name)
        assert min(pixels.shape[:2]) > 400
        assert 0.005 < (pixels[..., :3].min(axis=2) < 0.8).mean() < 0.5  # ink on paper
    numbers = json.loads((out / "numbers.json").read_text(encoding="utf-8"))
    _check_constant_gauge(numbers["figure_6"])
    seven = numbers["figure_7"]
    assert seven["gauge_std_mm"] == 2.0
    spread = np.array(seven["rolling_radius_sum_mm"]["std"], dtype=float)
    assert np.nanmedian(spread) > 5 * np.nanmedian(np.array(numbers["figure_6"]["rolling_radius_sum_mm"]["std"], float))
    for name in ("figure_6.md", "figure_7.md"):
        assert (out / name).read_text(encoding="utf-8").count("\n|") > 10


def _check_constant_gauge(six: dict[str, object]) -> None:
    samples, jump = np.array(six["samples"], float), np.array(six["contact_jump_inside_mm"], float)
    good = (samples >= 2000) & (jump == 0)
    assert good.sum() >= 8
    reach = {
        "rolling_radius_sum": 0.02,
        "rolling_radius_difference": 0.005,
        "contact_angle_difference": 0.01,
        "contact_angle_sum": 0.02,
    }
    for name in COMBINATIONS:
        column = six[f"{name}_{'mm' if name.startswith('rolling') else 'rad'}"]
        assert isinstance(column, dict)
        truth, found = (np.array(column[key], float) for key in ("truth", "estimate"))
        scale = {"rolling_radius_sum": 1.0, "contact_angle_sum": float(np.abs(truth[good]).min())}
        range_ = float(np.ptp(truth[good]))
        known = good & np.isfinite(found)  # two minutes are not enough for every bin
        assert known.sum() >= 0.8 * good.sum()
        assert np.abs(found - truth)[known].max() <= reach[name] * scale.get(name, range_), name
        crossed = (samples >= 2000) & (jump > 0)
        assert crossed.sum() >= 2
        assert np.isnan(found[crossed]).all()
        assert {column["status"][b] for b in np.flatnonzero(crossed)} == {"contact_jump"}
