"""Fleets whose wheelsets are drawn: wear, pairs, parameters, journeys over the whole section, what is on file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.registry_file import read_registry
from ingest.simulator.campaign import scenario_track, vehicle_run
from ingest.simulator.drawn_fleet import vehicle_parameters, with_less_wear, with_seed
from ingest.simulator.fleet import prepare
from ingest.simulator.scenario import Scenario, VehicleErrors, WheelsetPlan
from ingest.simulator.scenario_file import builtin_scenarios, load_scenario


def short(name: str, seed: int = 0) -> Scenario:
    scenario = load_scenario(name)
    recipe = scenario.section.recipe
    assert recipe is not None
    return with_seed(replace(scenario, section=replace(scenario.section, recipe=replace(recipe, length=1500.0))), seed)


def by_serial(scenario: Scenario) -> list[WheelsetPlan]:
    return sorted((item for plan in scenario.vehicles for item in plan.wheelsets), key=lambda item: item.serial)


@pytest.mark.parametrize("name", builtin_scenarios())
def test_every_scenario_of_the_package_loads_and_takes_a_seed(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert with_seed(scenario, scenario.seed) == scenario
    assert with_seed(scenario, 7).seed == 7


def test_a_seed_chooses_wheel_and_rail_and_draws_the_wear() -> None:
    even, odd = with_seed(load_scenario("unknown"), 0), with_seed(load_scenario("unknown"), 1)
    assert (even.pair, odd.pair) == ("P8/113A", "S1002/60E1")
    assert (even.section.rail_profile, odd.section.rail_profile) == ("56E1", "60E1")
    assert odd.section.inclination == pytest.approx(1 / 40)
    wear = [0.5 * (item.initial_left + item.initial_right) for item in by_serial(even)]
    assert len(wear) == 16
    assert wear == sorted(wear)
    assert 0.0 <= wear[0] < 1.8e-3 / 16
    assert 1.8e-3 * 15 / 16 <= wear[-1] <= 1.8e-3
    assert all(item.initial_left != item.initial_right for item in by_serial(even))
    assert by_serial(with_seed(even, 2))[3] != by_serial(even)[3]


def test_wear_alike_is_half_of_the_deepest_on_both_sides() -> None:
    depths = {(item.initial_left, item.initial_right) for item in by_serial(load_scenario("no_information"))}
    ((left, right),) = depths
    assert left == right == pytest.approx(0.9e-3)


def test_less_wear_is_that_of_one_wheelset() -> None:
    scenario = load_scenario("unknown")
    less = with_less_wear(scenario, "V1", 2, 0.5)
    before, after = scenario.vehicle("V1").wheelsets[2], less.vehicle("V1").wheelsets[2]
    assert (after.initial_left, after.initial_right) == (0.5 * before.initial_left, 0.5 * before.initial_right)
    assert less.vehicle("V0") == scenario.vehicle("V0")
    assert less.vehicle("V1").wheelsets[1] == scenario.vehicle("V1").wheelsets[1]


def test_parameter_errors_share_the_creep_and_draw_the_springs() -> None:
    scenario = load_scenario("unknown")
    assert vehicle_parameters(scenario, "V0") == VehicleParameters()
    drawn = replace(scenario, vehicle_errors=VehicleErrors())
    first, second = vehicle_parameters(drawn, "V0"), vehicle_parameters(drawn, "V1")
    assert first.longitudinal_creep_coefficient == second.longitudinal_creep_coefficient
    assert first.longitudinal_creep_coefficient != VehicleParameters().longitudinal_creep_coefficient
    assert first.yaw_stiffness != second.yaw_stiffness
    springs = [vehicle_parameters(with_seed(drawn, seed), "V0").yaw_stiffness for seed in range(200)]
    assert np.std(springs) / VehicleParameters().yaw_stiffness == pytest.approx(0.10 / 1.96, rel=0.2)


def test_a_run_over_the_whole_section_begins_before_it_and_ends_behind_it() -> None:
    scenario = short("unknown_position")
    track, vehicle = scenario_track(scenario), scenario.vehicles[1]
    runs = [vehicle_run(scenario, track, vehicle, campaign) for campaign in range(3)]
    for run in runs:
        assert track.s[0] <= run.distance[0] - vehicle.axle_offsets[-1] < -100.0
        assert 1500.0 < run.distance[-1] - vehicle.axle_offsets[-1] < track.s[-1]
        assert run.speed.min() >= 14.0
        assert run.speed.max() <= 25.0
        assert 0.0 < np.abs(run.reported - run.distance).max() <= 20.0 + 2.0
    assert len({run.speed.mean() for run in runs}) == 3


def test_a_gauge_may_be_on_file_without_an_alignment(tmp_path: Path) -> None:
    contents = read_registry(prepare(short("gauge_2mm_known"), tmp_path))
    (known,) = contents.alignments
    assert np.isnan(known.alignment).all()
    assert known.gauge_known
    assert np.std(known.gauge_deviation) == pytest.approx(2e-3, rel=0.3)
    assert (known.s[0], known.s[-1]) == (0.0, 1500.0)
    assert contents.sections[0].length_m == 1500.0


def test_nothing_is_on_file_of_an_unknown_track(tmp_path: Path) -> None:
    assert read_registry(prepare(short("unknown"), tmp_path)).alignments == ()


def test_measured_profiles_are_on_file(tmp_path: Path) -> None:
    contents = read_registry(prepare(short("measured_wheelset"), tmp_path))
    (measured,) = contents.measured_profiles
    assert measured.wheelset == "W00"
    assert measured.mileage_km == 100.0
