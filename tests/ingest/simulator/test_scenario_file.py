"""Scenario files: what a good one becomes, and how a bad one is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenario_text import SMALL

from estimation.errors import ScenarioError
from ingest.simulator.campaign import scenario_track, vehicle_run
from ingest.simulator.motion import STEP
from ingest.simulator.scenario import FaultKind
from ingest.simulator.scenario_file import builtin_scenarios, load_scenario, read_scenario


def write(folder: Path, text: str) -> Path:
    path = folder / "scenario.toml"
    path.write_text(text, encoding="utf-8")
    return path


def line_of(text: str, start: str) -> int:
    return next(number for number, line in enumerate(text.splitlines(), start=1) if line.startswith(start))


def test_a_scenario_is_si_inside(tmp_path: Path) -> None:
    scenario = read_scenario(write(tmp_path, SMALL))
    vehicle = scenario.vehicle("V-1")
    assert vehicle.max_speed == pytest.approx(100.0 / 3.6)
    first, second, third = vehicle.wheelsets
    assert first.reprofilings == (30e6,)
    assert first.rate_left == first.rate_right == pytest.approx(1e-3 / 1e8)
    assert (second.rate_left, second.rate_right) == (pytest.approx(0.5e-11), pytest.approx(0.1e-11))
    assert third.fault is not None
    assert third.fault.kind is FaultKind.NO_TRANSMISSION
    assert scenario.section.inclination == pytest.approx(0.05)
    assert scenario.sessions.duration == pytest.approx(12.0)
    assert scenario.sensors.lateral.noise_density == pytest.approx(100e-6 * 9.80665)
    assert scenario.odometer(1) == pytest.approx(50_500e3)
    assert scenario.start_ns(vehicle, 1) - scenario.start_ns(vehicle, 0) == 100 * 86_400 * 10**9
    assert scenario.at_odometer_ns(scenario.odometer(1)) == scenario.start_ns(vehicle, 1)


def test_the_runs_of_one_vehicle_may_be_shorter(tmp_path: Path) -> None:
    usual = read_scenario(write(tmp_path, SMALL))
    shorter = read_scenario(write(tmp_path, SMALL.replace("[[vehicles]]", "[[vehicles]]\nminutes_each = 0.1", 1)))
    track = scenario_track(usual)
    long, short = (vehicle_run(one, track, one.vehicles[0], 0) for one in (usual, shorter))
    assert STEP * (len(long.speed) - 1) == pytest.approx(12.0)
    assert STEP * (len(short.speed) - 1) == pytest.approx(6.0)
    np.testing.assert_array_equal(short.speed, long.speed[: len(short.speed)])


@pytest.mark.parametrize("name", ["demo", "demo_autumn", "demo_coach", "demo_single", "live", "mems", "paper"])
def test_built_in_scenarios_are_good(name: str) -> None:
    assert name in builtin_scenarios()
    assert load_scenario(name).name == name


BAD = [
    (
        "wear_mm_per_100000_km = 1.0",
        "wear_mm_per_1000_km = 1.0",
        "vehicles[0].wheelsets[0].wear_mm_per_1000_km",
        "unknown",
    ),
    ("[fleet]", '[fleet]\ncolour = "red"', "fleet.colour", "unknown"),
    ("[[vehicles]]", "[[vehicles]]\nminutes_each = 0", "vehicles[0].minutes_each", "outside"),
    ("seed = 5", "seeds = 5", "seed", "missing"),
    ("seed = 5", "seed = -5", "seed", "outside"),
    ("seed = 5", "seed = 5.5", "seed", "whole number"),
    ("campaigns = 2", "campaigns = true", "sessions.campaigns", "whole number"),
    ("lowest_m_s = 15.0", "lowest_m_s = 0.1", "speed.lowest_m_s", "outside"),
    ("highest_m_s = 22.0", "highest_m_s = 12.0", "speed.highest_m_s", "outside"),
    ("highest_m_s = 22.0", "highest_m_s = nan", "speed.highest_m_s", "finite"),
    ("length_m = 700.0", "length_m = 200.0", "section.length_m", "200 m"),
    ("number = 9", "number = 65535", "section.number", "outside"),
    ("start = 2024-01-08T05:30:00Z", "start = 2024-01-08T05:30:00", "sessions.start", "offset from UTC"),
    ("start = 2024-01-08T05:30:00Z", 'start = "monday"', "sessions.start", "date and time"),
    ('kind = "mems"', 'kind = "magic"', "sensors.kind", "neither"),
    ('kind = "mems"', 'kind = "mems"\nrate_hz = 300', "sensors.rate_hz", "divide"),
    ('kind = "mems"', 'kind = "ideal"\nlateral_limit_g = 4', "sensors.lateral_limit_g", "unknown"),
    ('kind = "sensor_fault"', 'kind = "asleep"', "vehicles[0].wheelsets[1].fault.kind", "none of"),
    ("from_campaign = 1", "from_campaign = 9", "vehicles[0].wheelsets[2].fault.from_campaign", "outside"),
    ('serial = "C"', 'serial = "A"', "vehicles", "'A' occurs twice"),
    ('serial = "C"', 'serial = "C"\nwheel_profile = "P9"', "vehicles[0].wheelsets[2].wheel_profile", "P9"),
    ('code = "S-9"', 'code = "S-9"\nrail_profile = "X"', "section.rail_profile", "'X'"),
    ("axle_offsets_m = [2.0, 4.5, 12.0]", "axle_offsets_m = [2.0, 4.5]", "vehicles[0].axle_offsets_m", "3 wheelsets"),
    ("axle_offsets_m = [2.0, 4.5, 12.0]", "axle_offsets_m = [2, 1, 3]", "vehicles[0].axle_offsets_m", "increase"),
    ("axle_offsets_m = [2.0, 4.5, 12.0]", 'axle_offsets_m = [2, "a", 3]', "vehicles[0].axle_offsets_m[1]", "number"),
    ('name = "Small fleet"', 'name = ""', "fleet.name", "empty"),
]


@pytest.mark.parametrize(("old", "new", "field", "words"), BAD)
def test_a_bad_entry_is_refused_by_file_line_and_key(
    tmp_path: Path, old: str, new: str, field: str, words: str
) -> None:
    assert old in SMALL
    text = SMALL.replace(old, new)
    path = write(tmp_path, text)
    with pytest.raises(ScenarioError) as refused:
        read_scenario(path)
    error = refused.value
    assert error.file == str(path)
    assert error.field == field
    assert words in str(error)
    if words != "missing" and field.rsplit(".", maxsplit=1)[-1] in new:
        last = new.splitlines()[-1]
        assert error.line is not None
        assert text.splitlines()[error.line - 1] == last


def test_a_line_is_found_among_repeated_tables(tmp_path: Path) -> None:
    text = SMALL.replace("initial_wear_mm = 0.4", "initial_wear_mm = 99")
    with pytest.raises(ScenarioError) as refused:
        read_scenario(write(tmp_path, text))
    assert refused.value.line == line_of(text, "initial_wear_mm = 99")


def test_runs_over_the_whole_section_are_not_shortened(tmp_path: Path) -> None:
    whole = SMALL.replace("minutes_each = 0.2", "whole_section = true")
    text = whole.replace("[[vehicles]]", "[[vehicles]]\nminutes_each = 0.1", 1)
    with pytest.raises(ScenarioError, match="whole section") as refused:
        read_scenario(write(tmp_path, text))
    assert refused.value.field == "vehicles[0].minutes_each"


@pytest.mark.parametrize(("content", "words"), [("= 3", "no TOML"), ("name = 'x'", "missing")])
def test_a_file_that_is_no_scenario_is_refused(tmp_path: Path, content: str, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        read_scenario(write(tmp_path, content))


def test_an_unknown_name_lists_what_there_is() -> None:
    with pytest.raises(
        ScenarioError, match=r"demo, demo_autumn, demo_coach, demo_single, gauge_1mm_.*live, .*mems, .*unknown_position"
    ):
        load_scenario("no-such-scenario")
