"""Rows of the world bench with measured wheels: which wheels make wheelsets, and which can run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.world import MEASURED_ROWS, SCENARIOS, main, measured_wheels, with_wheels
from estimation.contact.profiles import Profile, wheel_profile
from estimation.contact.wear import WearFamily, wear_course, worn
from estimation.errors import ScenarioError
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario

ROOT = -33.0  # mm, in the flange of an S1002: a corner, where no tread is
REVERSE = -1.0 / 40.0  # slope of a tread that steers to the wrong side


def write_wheel(path: Path, wheel: Profile, slope: float | None = None) -> Path:
    """Write a wheel; with ``slope`` its tread has that one instead."""
    y = np.arange(-69.9, 60.0, 0.25)
    z = 1e3 * wheel.height(1e-3 * y)
    if slope is not None:
        root = float(np.interp(ROOT, y, z))
        z = np.where(y > ROOT, root - slope * (y - ROOT), z)
    points = "\n".join(f"{a + 70:.4f} {b:.4f}" for a, b in zip(y, z, strict=True))
    path.write_text(f"ProgramName=MiniProf\nXYPoints={len(y)}\nColumnDef=X,Y\n\n{points}\n", encoding="utf-8")
    return path


def worn_wheel(path: Path, depth: float) -> Path:
    return write_wheel(path, worn(wheel_profile("S1002"), wear_course(WearFamily.S1002_ON_60E1, depth)))


def small(row: str, seed: int) -> Scenario:
    scenario = load_scenario(SCENARIOS / f"{row}.toml")
    assert scenario.drawn is not None
    sessions = replace(scenario.sessions, campaigns=1, duration=30.0)
    return with_seed(
        replace(scenario, drawn=replace(scenario.drawn, given_vehicles=1, wheelsets=2), sessions=sessions), seed
    )


def test_wheels_become_wheelsets_and_what_cannot_run_is_left_out_with_its_reason(tmp_path: Path) -> None:
    first, second = worn_wheel(tmp_path / "a.whl", 0.1e-3), worn_wheel(tmp_path / "b.whl", 0.3e-3)
    left, right = worn_wheel(tmp_path / "left_1.whl", 0.2e-3), worn_wheel(tmp_path / "right_1.whl", 0.25e-3)
    worn_wheel(tmp_path / "hollow.whl", 1.6e-3)
    (tmp_path / "broken.whl").write_text("ColumnDef=X,Y\n\n1 2\n")
    section = small(MEASURED_ROWS[0], 0).section
    found = measured_wheels(tmp_path, section)
    assert set(found.pairs) == {(first, first), (second, second), (left, right), (first, second), (second, first)}
    assert [line.partition(":")[0] for line in found.left_out] == ["broken", "hollow"]
    assert "equivalent conicity of 0.45" in found.left_out[1]
    for path in (first, second, left, right):
        path.unlink()
    with pytest.raises(ScenarioError, match=r"no measured wheels that can run; broken: .*; hollow: "):
        measured_wheels(tmp_path, section)


def test_a_row_draws_its_wheelsets_by_seed(tmp_path: Path) -> None:
    wheels = [worn_wheel(tmp_path / f"{depth}.whl", 1e-4 * depth) for depth in (1, 3)]
    pairs = [(wheel, wheel) for wheel in wheels]
    scenario, left_out = with_wheels(small(MEASURED_ROWS[1], 3), pairs)
    assert left_out == ()
    assert scenario.section.rail_profile == "60E1"
    assert not scenario.section.surveyed
    files = [item.wheel_files for item in scenario.vehicles[0].wheelsets]
    assert set(files) <= set(pairs)
    assert with_wheels(small(MEASURED_ROWS[1], 3), pairs)[0] == scenario
    others = [with_wheels(small(MEASURED_ROWS[1], seed), pairs)[0].vehicles for seed in (4, 5)]
    assert any([item.wheel_files for item in other[0].wheelsets] != files for other in others)


def test_a_wheelset_that_runs_on_its_flange_is_left_out(tmp_path: Path) -> None:
    wrong = write_wheel(tmp_path / "wrong.whl", wheel_profile("S1002"), REVERSE)
    sound = worn_wheel(tmp_path / "sound.whl", 0.1e-3)
    with pytest.raises(ScenarioError, match=r"W00, wrong: flange contact in \d+% of campaign 1"):
        with_wheels(small(MEASURED_ROWS[0], 0), [(wrong, wrong)])
    scenario, left_out = with_wheels(small(MEASURED_ROWS[0], 0), [(sound, sound), *[(wrong, wrong)] * 3])
    assert [item.wheel_files for item in scenario.vehicles[0].wheelsets] == [(sound, sound)] * 2
    assert left_out
    assert all("wrong: flange contact" in line for line in left_out)


def test_the_rows_need_their_wheels(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="measured_known, measured_unknown need --measured"):
        main(["--rows", "measured_known", "--out", str(tmp_path / "out")])
