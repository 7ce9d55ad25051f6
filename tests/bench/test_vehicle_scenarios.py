"""Scenario files of the vehicle bench: each can be read, and what is on file is wrong only where its name says so."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest

from ingest.simulator.fleet import prepare
from ingest.simulator.scenario_file import read_scenario
from ingest.vehicle_class_schema import read_vehicle_class, shipped_class

SCENARIOS = Path(__file__).parents[2] / "bench" / "vehicle_scenarios"
FILES = sorted(SCENARIOS.glob("*.toml"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_file_is_a_scenario_of_its_name(path: Path) -> None:
    scenario = read_scenario(path)
    assert scenario.name == path.stem
    assert len(scenario.vehicles) * len(scenario.vehicles[0].wheelsets) == 12
    assert (scenario.class_on_file is not None) <= path.stem.startswith(("wrong_", "demo_"))


def test_the_coach_of_the_bench_is_the_shipped_one() -> None:
    scenario, coach = read_scenario(SCENARIOS / "coach_known.toml"), shipped_class("coach")
    assert asdict(scenario.parameters) == pytest.approx(asdict(coach.parameters), rel=1e-3)
    assert scenario.bogie == coach.bogie


def test_the_class_file_of_the_soft_bogies_is_theirs() -> None:
    scenario = read_scenario(SCENARIOS / "soft_known.toml")
    on_file = read_vehicle_class(SCENARIOS / "classes" / "soft.toml")
    assert (on_file.parameters, on_file.bogie) == (scenario.parameters, scenario.bogie)


def test_on_file_are_another_radius_and_another_wheelbase(tmp_path: Path) -> None:
    small = read_scenario(SCENARIOS / "wrong_radius_420_as_460.toml")
    assert {wheelset.nominal_radius for plan in small.vehicles for wheelset in plan.wheelsets} == {0.42}
    assert '"nominal_radius_mm": 460.0' in prepare(small, tmp_path / "radius").read_text()
    short = read_scenario(SCENARIOS / "wrong_wheelbase_2_5_as_1_8.toml")
    assert short.class_on_file is not None
    assert short.class_on_file.axle_offsets(short.vehicles[0].axle_offsets) == (0.35, 2.15, 19.35, 21.15)
