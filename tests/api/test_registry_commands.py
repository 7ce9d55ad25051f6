"""``treadwatch registry load``, ``check`` and ``export``: whole or nothing, and everything that is wrong is printed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from in_process_command import Run, command_line

from fleet_db.migrate import upgrade

REGISTRY: dict[str, Any] = {
    "format": "treadwatch-registry-1",
    "fleets": [{"code": "N", "name": "North"}],
    "vehicles": [
        {
            "code": "N-1",
            "fleet": "N",
            "vehicle_class": "coach",
            "axles": 2,
            "max_speed_km_h": 140.0,
            "axle_offsets_m": [2.0, 4.56],
        }
    ],
    "wheelsets": [{"serial": "W-1", "fleet": "N", "wheel_profile": "S1002", "nominal_radius_mm": 460.0}],
    "mountings": [
        {
            "wheelset": "W-1",
            "vehicle": "N-1",
            "axle": 1,
            "from": "2024-01-08T00:00:00Z",
            "vehicle_odometer_km": 50_000.0,
            "wheelset_mileage_km": 50_000.0,
        }
    ],
}
WRONG = {
    "format": "treadwatch-registry-1",
    "wheelsets": [{"serial": "W/2", "fleet": "N", "wheel_profile": "S1002", "nominal_radius_mm": 920.0}],
    "reprofilings": [{"wheelset": "W-1", "at": "2036-01-01T00:00:00Z", "mileage_km": 10.0}],
}
REPROFILING = ["reprofilings[0].at", "reprofilings[0].mileage_km"]
UNREADABLE = WRONG | {"reprofilings": [{"wheelset": "W-1", "at": "soon"}]}


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Run]:
    """Yield what runs a command on an own database, in a folder with the files."""
    url = f"sqlite:///{tmp_path / 'data.sqlite3'}"
    upgrade(url)
    monkeypatch.setenv("TREADWATCH_DATABASE_URL", url)
    monkeypatch.setenv("TREADWATCH_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.chdir(tmp_path)
    for name, content in (("right", REGISTRY), ("wrong", WRONG), ("unreadable", UNREADABLE)):
        Path(f"{name}.json").write_text(json.dumps(content), encoding="utf-8")
    with command_line(monkeypatch, capsys) as done:
        yield done


def test_a_registry_is_checked_loaded_and_exported_without_a_recording(run: Run) -> None:
    checked = run("registry", "check", "right.json")
    assert (checked.returncode, checked.stdout) == (0, "right.json: nothing is wrong with it\n")
    assert "0 records" in run("registry", "export", "nothing.json").stdout
    loaded = run("registry", "load", "right.json", "--by", "ada", "--why", "first")
    assert (loaded.returncode, loaded.stdout.startswith("loaded right.json")) == (0, True)
    history = run("registry", "history", "W-1").stdout
    shown = [line.split(" ", 1)[1][:22] for line in history.splitlines()]
    assert shown == ["entered wheelset W-1 b", "entered mounting W-1 2"]
    assert "by ada (first)" in history
    assert "wrote again.json: 4 records, 0 files beside it" in run("registry", "export", "again.json").stdout
    exported = json.loads(Path("again.json").read_text(encoding="utf-8"))
    assert exported == REGISTRY | {"mountings": [REGISTRY["mountings"][0] | {"to": None, "reversed": False}]}


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("wrong", ["wheelsets[0].serial", "wheelsets[0].nominal_radius_mm", *REPROFILING]),
        ("unreadable", REPROFILING),
    ],
)
def test_everything_that_is_wrong_is_printed_and_nothing_stored(run: Run, name: str, fields: list[str]) -> None:
    run("registry", "load", "right.json")
    before = run("registry", "export", "before.json") and Path("before.json").read_text(encoding="utf-8")
    checked = run("registry", "check", f"{name}.json")
    assert checked.returncode == 1
    assert [line.split("'")[1] for line in checked.stdout.splitlines()] == fields
    assert all(line.startswith(f"{name}.json, field ") for line in checked.stdout.splitlines())
    loaded = run("registry", "load", f"{name}.json")
    assert loaded.returncode == 2
    of_load = [line.split("our clock")[0] for line in loaded.stderr.splitlines()]
    assert of_load == [f"treadwatch: {line}".split("our clock")[0] for line in checked.stdout.splitlines()]
    run("registry", "export", "after.json")
    assert Path("after.json").read_text(encoding="utf-8") == before


def test_what_is_so_all_the_same_is_confirmed(run: Run) -> None:
    steam = {"serial": "W-3", "fleet": "N", "wheel_profile": "S1002", "nominal_radius_mm": 1000.0}
    Path("steam.json").write_text(json.dumps(REGISTRY | {"wheelsets": [steam], "mountings": []}), encoding="utf-8")
    refused = run("registry", "load", "steam.json")
    assert "(if it is so all the same, confirm unusual_radius)" in refused.stderr
    assert run("registry", "load", "steam.json", "--confirm", "unusual_radius").returncode == 0


def test_a_file_that_is_not_there_is_one_line(run: Run) -> None:
    for command, code in (("check", 1), ("load", 2)):
        done = run("registry", command, "lost.json")
        assert done.returncode == code
        assert (done.stdout + done.stderr).count("\n") == 1
        assert "lost.json: cannot be read" in done.stdout + done.stderr
