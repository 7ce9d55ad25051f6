"""``treadwatch vehicle``: what it lists, prints and refuses, with real files; and the page that shows its tables."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from in_process_command import Run

from ingest.vehicle_class_schema import shipped_classes, shipped_path

PAGE = Path(__file__).parents[2] / "docs" / "vehicles.md"


def test_list_names_every_shipped_class(treadwatch: Run) -> None:
    done = treadwatch("vehicle", "list")
    assert done.returncode == 0
    assert [line.split()[0] for line in done.stdout.splitlines()] == list(shipped_classes())


def test_what_show_prints_can_be_copied_and_checked(treadwatch: Run, tmp_path: Path) -> None:
    shown = treadwatch("vehicle", "show", "coach")
    assert shown.stdout == shipped_path("coach").read_text(encoding="utf-8")
    copy = tmp_path / "copy.toml"
    copy.write_text(shown.stdout, encoding="utf-8")
    assert treadwatch("vehicle", "check", copy).stdout == treadwatch("vehicle", "check", "coach").stdout


@pytest.mark.parametrize("code", shipped_classes())
def test_check_prints_modes_critical_speeds_and_what_is_seen(treadwatch: Run, code: str) -> None:
    done = treadwatch("vehicle", "check", code, "--speed", "25", "--conicity", "0.15")
    assert done.returncode == 0, done.stderr
    assert "Modes at 25 m/s, conicity 0.15" in done.stdout
    assert re.search(r"^  kinematic.* \d+\.\d\d ", done.stdout, re.MULTILINE)
    assert len(re.findall(r"^  conicity 0\.\d: \d+ m/s", done.stdout, re.MULTILINE)) == 4
    assert re.search(r"^  rL - rR, as conicity +0\.15 .* yes$", done.stdout, re.MULTILINE)
    assert re.search(r"^  nominal_radius +0\.01[45]", done.stdout, re.MULTILINE)


def test_a_vehicle_that_hunts_is_not_said_to_be_observable(treadwatch: Run) -> None:
    done = treadwatch("vehicle", "check", "soft_bogie", "--speed", "45")
    assert done.returncode == 0
    assert "the vehicle hunts at this speed" in done.stdout
    assert "What the sensors see" not in done.stdout


def test_an_implausible_class_is_refused_with_file_line_and_field(treadwatch: Run, tmp_path: Path) -> None:
    text = shipped_path("coach").read_text(encoding="utf-8")
    path = tmp_path / "tonnes.toml"
    path.write_text(text.replace("frame_mass_kg = 2615.0", "frame_mass_kg = 2.615"), encoding="utf-8")
    line = text[: text.index("frame_mass_kg")].count("\n") + 1
    done = treadwatch("vehicle", "check", path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert f"{path}:{line}, field 'bogie.frame_mass_kg" in done.stderr
    assert "the mode 'frame lateral on the primary springs' would be 388 Hz" in done.stderr


@pytest.mark.parametrize("arguments", [("check", "no-such.toml"), ("show", "tram"), ("check", "coach", "--speed", "0")])
def test_what_does_not_exist_is_refused(treadwatch: Run, arguments: tuple[str, ...]) -> None:
    done = treadwatch("vehicle", *arguments)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_the_tables_of_the_page_are_what_the_command_prints(treadwatch: Run) -> None:
    blocks = re.findall(
        r"^```\n(\$ treadwatch vehicle .*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    assert len(blocks) >= 2
    for block in blocks:
        command, *lines = block.splitlines()
        printed = treadwatch(*command.removeprefix("$ treadwatch ").split()).stdout.splitlines()
        assert [line for line in lines if line != "..." and line not in printed] == []
