"""Section scenarios: files, what shapes their simulation, and windows as they are handed out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from same_values import same_values
from section_text import SMALL_SECTION

from estimation.errors import NotFoundError, ScenarioError
from estimation.values.windows import ACCELERATIONS
from estimation.vehicle.equations_of_motion import VehicleParameters
from ingest.simulator.section_file import builtin_section_scenarios, load_section_scenario, read_section_scenario
from ingest.simulator.section_run import SectionRun, simulate_section
from ingest.simulator.section_scenario import SectionScenario
from ingest.simulator.section_simulation import (
    ensure_simulated,
    journey_speed,
    section_track,
    simulation_key,
    vehicle_parameters,
    wheelset_contact,
    wheelset_file,
)


def read(folder: Path, text: str) -> SectionScenario:
    path = folder / "section.toml"
    path.write_text(text, encoding="utf-8")
    return read_section_scenario(path)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SectionScenario:
    return read(tmp_path_factory.mktemp("scenario"), SMALL_SECTION)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def small_run(small: SectionScenario, cache: Path) -> SectionRun:
    return simulate_section(small, 3, cache, workers=1)


ROWS = {  # alignment known, gauge std mm, gauge known, position offset m
    "known": (True, 0.0, False, 0.0),
    "unknown": (False, 0.0, False, 0.0),
    "unknown_position": (False, 0.0, False, 20.0),
    "gauge_1mm_unknown": (False, 1.0, False, 20.0),
    "gauge_2mm_known": (False, 2.0, True, 20.0),
    "gauge_2mm_unknown": (False, 2.0, False, 20.0),
}


@pytest.mark.parametrize("name", ROWS)
def test_the_rows_of_the_accuracy_table(name: str) -> None:
    scenario = load_section_scenario(name)
    told = (scenario.alignment_known, 1e3 * scenario.gauge_std, scenario.gauge_known, scenario.position_offset)
    assert told == pytest.approx(ROWS[name])
    assert scenario.position_scale == pytest.approx(1e-3 if scenario.position_offset else 0.0)
    assert (scenario.name, scenario.vehicles, scenario.wheelsets, scenario.passes) == (name, 4, 4, 3)
    assert (scenario.length, scenario.alignment_std) == (12_000.0, 2e-3)
    assert (scenario.lowest_speed, scenario.highest_speed) == (14.0, 25.0)
    assert [scenario.pair(seed).name for seed in (0, 1, 2)] == ["P8/113A", "S1002/60E1", "P8/113A"]
    assert scenario.pair(0).inclination == 1 / 20
    assert scenario.pair(1).inclination == 1 / 40
    assert not scenario.errors_drawn


def test_measured_profiles_are_those_of_the_first_wheelsets_but_for_a_stretch(small_run: SectionRun) -> None:
    assert small_run.measured() == {}
    found = replace(small_run, scenario=replace(small_run.scenario, wheelsets_measured=2)).measured()
    assert list(found) == ["W00", "W01"]
    for serial, curve in found.items():
        truth = small_run.truth(serial)
        inner = np.abs(truth.displacement - truth.zero_crossing) < 3e-3
        back, reached = curve.at(truth.difference[inner])
        assert reached.all()
        stretch = float(np.polyfit(truth.displacement[inner], back, 1)[0])
        assert 0.0 < abs(stretch - 1.0) < 0.1
        np.testing.assert_allclose(back, stretch * (truth.displacement[inner] - truth.zero_crossing), atol=0.12e-3)


def test_a_section_without_information_is_one_of_the_files() -> None:
    assert set(builtin_section_scenarios()) == {*ROWS, "no_information", "measured_wheelset"}
    scenario = load_section_scenario("no_information")
    assert scenario.wear_alike
    assert scenario.speed_alike


BAD = [
    ("vehicles = 2", "vehicles = 0", "fleet.vehicles", "outside"),
    ("passes = 2", 'passes = "2"', "fleet.passes", "whole number"),
    ("length_m = 2000.0", "length_m = 20.0", "section.length_m", "outside"),
    ("length_m = 2000.0", "length_km = 2.0", "section.length_km", "unknown"),
    ("highest_m_s = 25.0", "highest_m_s = 10.0", "speed.highest_m_s", "outside"),
    ('kind = "mems"', 'kind = "laser"', "sensors.kind", "neither"),
    ("drawn = false", "drawn = 1", "vehicle_errors.drawn", "neither true nor false"),
    ("deepest_wear_mm = 0.6", "deepest_wear_mm = 60", "pairs[1].deepest_wear_mm", "outside"),
    ("deepest_wear_mm = 1.2", "", "pairs[0].deepest_wear_mm", "missing"),
    ('"S1002"', '"S1003"', "pairs[1].wheel_profile", "S1003"),
    ('"56E1"', '"S1002"', "pairs[0].rail_profile", "S1002"),
    ("position_scale_percent = 0.1", "position_scale_percent = 7", "known.position_scale_percent", "outside"),
]


@pytest.mark.parametrize(("old", "new", "field", "reason"), BAD, ids=[item[1] or item[2] for item in BAD])
def test_a_bad_entry_is_refused_with_file_and_field(
    tmp_path: Path, old: str, new: str, field: str, reason: str
) -> None:
    assert old in SMALL_SECTION
    with pytest.raises(ScenarioError, match=reason) as caught:
        read(tmp_path, SMALL_SECTION.replace(old, new, 1))
    assert caught.value.field == field
    assert caught.value.file == str(tmp_path / "section.toml")
    assert caught.value.line is not None


@pytest.mark.parametrize("text", ["name = ", b"\xff\xfe"])
def test_what_is_no_toml_is_refused(tmp_path: Path, text: str | bytes) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ScenarioError, match=r"bad\.toml.*no TOML"):
        read_section_scenario(path)


def test_a_scenario_that_is_not_there_is_refused_with_the_names_that_are() -> None:
    with pytest.raises(ScenarioError, match="gauge_2mm_known"):
        load_section_scenario("gauge_3mm")


def test_what_is_known_does_not_shape_the_simulation(small: SectionScenario) -> None:
    key = simulation_key(small, 3)
    for same in (
        replace(small, alignment_known=True),
        replace(small, gauge_known=True),
        replace(small, position_offset=0.0, position_scale=0.0),
        replace(small, name="other", description="other"),
    ):
        assert simulation_key(same, 3) == key
    for other in (
        replace(small, gauge_std=1e-3),
        replace(small, passes=3),
        replace(small, errors_drawn=True),
        replace(small, sensors=replace(small.sensors, rate_hz=500)),
    ):
        assert simulation_key(other, 3) != key
    assert simulation_key(small, 4) != key


def test_two_processes_make_what_one_makes(small: SectionScenario, small_run: SectionRun, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    folder = ensure_simulated(small, 3, tmp_path, workers=2, progress=lambda done, of: told.append((done, of)))
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    for number in range(4):
        with (
            np.load(wheelset_file(folder, number)) as first,
            np.load(wheelset_file(small_run.folder, number)) as second,
        ):
            assert sorted(first) == sorted(second)
            assert all(np.array_equal(first[name], second[name]) for name in first)
    assert list(tmp_path.iterdir()) == [folder]


def test_windows_hold_counts_on_the_section_and_nothing_off_it(small_run: SectionRun) -> None:
    windows = list(small_run.windows("W01"))
    assert len({window.start_ns for window in windows}) == len(windows)
    assert all(window.start_ns % window.length_ns == 0 for window in windows)
    for window in windows:
        on = window.valid
        for name, one in zip(ACCELERATIONS, window.resolution, strict=True):
            values = getattr(window, name)
            assert np.isnan(values[~on]).all()
            counts = values[on] / one
            np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
        assert np.isnan(window.distance[~on]).all()
        assert window.quality.coverage == pytest.approx(on.mean())
    distance = np.concatenate([window.distance[window.valid] for window in windows])
    assert distance.min() < 0.2
    assert distance.max() > 1999.8
    assert (distance >= 0).all()
    assert (distance <= 2000).all()
    moved = sum(float(window.speed[window.valid].sum()) * window.sample_interval_s for window in windows)
    assert moved == pytest.approx(2 * 2000.0, rel=2e-3)


def test_positions_are_off_as_the_journey_says(small_run: SectionRun) -> None:
    exact = replace(small_run, scenario=replace(small_run.scenario, position_offset=0.0, position_scale=0.0))
    wrong, right = list(small_run.windows("W01")), list(exact.windows("W01"))
    offsets = []
    for one, other in zip(wrong, right, strict=True):
        journey = (one.start_ns - wrong[0].start_ns) // (86_400 * 10**9)
        error = small_run.position_error(1, int(journey))
        both = one.valid & other.valid
        expected = error.offset + error.scale * (other.distance[both] - 1000.0)
        np.testing.assert_allclose((one.distance - other.distance)[both], expected, atol=1e-9)
        np.testing.assert_array_equal(one.lateral_acceleration[both], other.lateral_acceleration[both])
        offsets.append(error.offset)
    assert 0 < max(abs(offset) for offset in offsets) <= 20.0
    assert len(set(offsets)) == 2


def test_the_second_axle_is_behind_the_first(small_run: SectionRun) -> None:
    first, second = (next(iter(small_run.windows(serial))) for serial in ("W00", "W02"))
    assert (first.vehicle, first.axle, second.vehicle, second.axle) == ("V0", 1, "V0", 2)
    both = first.valid & second.valid
    np.testing.assert_allclose((first.distance - second.distance)[both], 2.6, rtol=0.01)
    with pytest.raises(NotFoundError, match="W99"):
        list(small_run.windows("W99"))


def test_truth_is_that_of_wheels_worn_more_and_more(small_run: SectionRun) -> None:
    assert small_run.pair.name == "S1002/60E1"
    assert [truth.serial for truth in small_run.wheelsets] == ["W00", "W01", "W02", "W03"]
    at_3_mm = [truth.conicity[-1] for truth in small_run.wheelsets]
    assert at_3_mm == sorted(at_3_mm)
    assert 0.1 < at_3_mm[0] < at_3_mm[-1] < 0.45


def test_what_is_told_of_the_track(small_run: SectionRun) -> None:
    scenario = small_run.scenario
    assert small_run.known_track() is None
    assert small_run.known_gauge() is None
    true = small_run.true_track()
    assert (true.s[0], true.s[-1], true.gauge_known) == (0.0, 2000.0, True)
    assert 1e3 * true.alignment.std() == pytest.approx(2.0, rel=0.3)
    blind = replace(small_run, scenario=replace(scenario, gauge_std=1e-3)).true_track()
    assert not blind.gauge_known
    assert (blind.gauge_deviation_std == 1e-3).all()
    seen = replace(small_run, scenario=replace(scenario, gauge_std=1e-3, gauge_known=True)).known_gauge()
    assert seen is not None
    assert np.isnan(seen.alignment).all()


def test_vehicles_are_as_assumed_unless_drawn(small: SectionScenario) -> None:
    standard = VehicleParameters()
    assert vehicle_parameters(small, 3, 1) == standard
    drawn = replace(small, errors_drawn=True)
    seeds = [[vehicle_parameters(drawn, seed, vehicle) for vehicle in (0, 1)] for seed in range(300)]
    for first, second in seeds:
        assert first.longitudinal_creep_coefficient == second.longitudinal_creep_coefficient
        assert first.yaw_stiffness != second.yaw_stiffness
        ratio = first.lateral_creep_coefficient / first.longitudinal_creep_coefficient
        assert ratio == pytest.approx(standard.lateral_creep_coefficient / standard.longitudinal_creep_coefficient)
    for name, limit in (("longitudinal_creep_coefficient", 0.2), ("yaw_stiffness", 0.1), ("wheelset_mass", 0.05)):
        relative = np.array([getattr(first, name) for first, _ in seeds]) / getattr(standard, name) - 1.0
        assert np.quantile(np.abs(relative), 0.95) == pytest.approx(limit, rel=0.15)


def test_speeds_keep_to_their_range(small: SectionScenario) -> None:
    speeds = [journey_speed(small, 3, vehicle, 0) for vehicle in (0, 1)]
    assert all(speed.min() >= 18.0 and speed.max() <= 25.0 and speed.std() > 0.05 for speed in speeds)
    alike = replace(small, speed_alike=True)
    np.testing.assert_array_equal(journey_speed(alike, 3, 0, 0), journey_speed(alike, 3, 1, 1))


def test_a_wheelset_that_derails_is_refused(small: SectionScenario, tmp_path: Path) -> None:
    wild = replace(small, highest_speed=79.0, lowest_speed=78.0, pairs=(replace(small.pairs[0], deepest_wear=4e-3),))
    with pytest.raises(ScenarioError, match="derails") as caught:
        simulate_section(wild, 0, tmp_path, workers=1)
    assert caught.value.field == "pairs.deepest_wear_mm"
    assert list(tmp_path.iterdir()) == []


def test_a_wheelset_that_would_derail_is_less_worn(small: SectionScenario, tmp_path: Path) -> None:
    fast = replace(small, lowest_speed=42.0, highest_speed=43.0, pairs=(replace(small.pairs[0], deepest_wear=2.4e-3),))
    run = simulate_section(fast, 0, tmp_path, workers=1)
    drawn = wheelset_contact(fast, 0, 3, section_track(fast, 0))
    with np.load(wheelset_file(run.folder, 3)) as kept:
        assert not np.array_equal(kept["difference"], drawn.rolling_radius_difference[:, 0])
    with np.load(wheelset_file(run.folder, 0)) as kept:
        least = wheelset_contact(fast, 0, 0, section_track(fast, 0))
        np.testing.assert_array_equal(kept["difference"], least.rolling_radius_difference[:, 0])


def test_the_same_simulation_is_read_again(small_run: SectionRun, cache: Path) -> None:
    again = simulate_section(replace(small_run.scenario, name="again"), 3, cache, workers=1)
    assert again.folder == small_run.folder
    for first, second in zip(again.windows("W00"), small_run.windows("W00"), strict=True):
        assert same_values(first, second)
