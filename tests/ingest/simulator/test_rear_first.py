"""Push-pull trains: every second run is with the rear end first, with nodes and wheelsets where they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenario_text import SMALL

from estimation.values.arrays import FloatArray
from ingest.simulator.campaign import (
    TURNED,
    length_ahead,
    runs_rear_first,
    scenario_track,
    seen_from_ahead,
    vehicle_run,
)
from ingest.simulator.fleet import simulate_campaign
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import read_scenario


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    path = tmp_path_factory.mktemp("scenario") / "small.toml"
    path.write_text(SMALL)
    found = read_scenario(path)
    return replace(found, sessions=replace(found.sessions, push_pull=True))


def test_every_second_campaign_is_rear_first(scenario: Scenario) -> None:
    assert [runs_rear_first(scenario, campaign) for campaign in range(4)] == [False, True, False, True]


def test_each_axle_is_where_the_registry_has_it_ahead_of_a_reference_at_the_other_end(scenario: Scenario) -> None:
    vehicle, track = scenario.vehicles[0], scenario_track(scenario)
    plain = replace(scenario, sessions=replace(scenario.sessions, push_pull=False))
    run, forward = vehicle_run(scenario, track, vehicle, 1), vehicle_run(plain, track, vehicle, 1)
    _, turned = seen_from_ahead(scenario, vehicle)
    assert [wheelset.serial for wheelset in turned.wheelsets] == [item.serial for item in reversed(vehicle.wheelsets)]
    for offset, ahead in zip(vehicle.axle_offsets, reversed(turned.axle_offsets), strict=True):
        np.testing.assert_allclose(run.distance + offset, forward.distance - ahead)
    np.testing.assert_allclose(forward.distance - run.distance, length_ahead(vehicle))


def test_left_and_right_of_a_turned_wheelset_are_exchanged(scenario: Scenario) -> None:
    vehicle = scenario.vehicles[0]
    _, turned = seen_from_ahead(scenario, vehicle)
    for wheelset, seen in zip(vehicle.wheelsets, reversed(turned.wheelsets), strict=True):
        assert (seen.rate_left, seen.rate_right) == (wheelset.rate_right, wheelset.rate_left)
        assert (seen.initial_left, seen.initial_right) == (wheelset.initial_right, wheelset.initial_left)
        assert seen.diameter_difference == -wheelset.diameter_difference


def test_a_node_turned_half_round_about_the_vertical_measures_yaw_alone_as_it_is() -> None:
    values: FloatArray = np.ones((2, 4))
    assert (values * TURNED).tolist() == [[-1.0, 1.0, -1.0, -1.0]] * 2


def test_a_rear_first_run_has_frames_of_every_node(scenario: Scenario) -> None:
    batch, truths = simulate_campaign(scenario, scenario_track(scenario), scenario.vehicles[0], 1)
    assert [truth.axle for truth in truths] == [1, 2, 3]
    assert {0x181, 0x182} <= set(batch.arbitration_id.tolist())
