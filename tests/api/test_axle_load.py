"""The load W: the paper's in its reproduction and published scenarios, else the whole axle load or what is given."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from scenario_text import SMALL

from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.registry_file import read_registry
from ingest.simulator.fleet import prepare
from ingest.simulator.scenario_file import builtin_scenarios, load_scenario, read_scenario

PAPER = 12263.0  # N
AXLE = 9.81 * (1250.0 + 8000.0)  # N


def test_the_whole_axle_load_turns_the_factor_of_the_contact_angle_difference() -> None:
    paper = VehicleParameters()
    assert paper.load == PAPER
    assert paper.wheelset_mass * 9.81 == pytest.approx(PAPER, abs=1.0)
    assert paper.axle_load == pytest.approx(90.74e3, rel=1e-4)
    creep = paper.lateral_spin_creep_coefficient / paper.nominal_radius
    assert creep - paper.load / 2 > 0.0 > creep - paper.axle_load / 2


def test_a_scenario_has_the_whole_axle_load_of_its_masses_if_it_gives_none(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(SMALL)
    assert read_scenario(path).parameters.load == pytest.approx(9.81 * 9250.0)
    path.write_text(SMALL.replace("[fleet]", "[dynamics]\nsuspended_mass = 6000.0\n[fleet]"))
    assert read_scenario(path).parameters.load == pytest.approx(9.81 * 7250.0)
    path.write_text(SMALL.replace("[fleet]", "[dynamics]\nload = 50000.0\n[fleet]"))
    assert read_scenario(path).parameters.load == 50000.0


@pytest.mark.parametrize("name", sorted(set(builtin_scenarios()) - {"demo", "demo_autumn", "demo_coach", "live"}))
def test_scenarios_of_the_package_have_the_load_that_their_results_were_published_with(name: str) -> None:
    assert load_scenario(name).parameters == VehicleParameters()


@pytest.mark.parametrize("name", ["demo_autumn", "live"])
def test_vehicles_whose_creep_or_bus_is_shown_stand_on_the_rails_with_their_whole_weight(name: str) -> None:
    assert load_scenario(name).parameters == replace(VehicleParameters(), load=AXLE)


def test_the_class_in_the_registry_of_a_scenario_has_its_parameters(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(SMALL.replace("[fleet]", "[dynamics]\nload = 50000.0\nyaw_stiffness = 1e6\n[fleet]"))
    scenario = read_scenario(path)
    (found,) = read_registry(prepare(scenario, tmp_path)).classes
    assert found.parameters == scenario.parameters
    assert {plan.vehicle_class for plan in scenario.vehicles} == {found.code}
