"""Rows of the adhesion bench with quiet sensors: each is a scenario, and says what its file has wrong."""

from __future__ import annotations

import pytest

from bench.adhesion import SCENARIOS
from bench.adhesion_rows import QUIET, QUIET_OF, quiet_scenario
from ingest.simulator.scenario import Scenario

DRY = [name for name in QUIET if "leaves" not in name]


def scenario(name: str) -> Scenario:
    return quiet_scenario(SCENARIOS, QUIET[name])


@pytest.mark.parametrize("name", DRY)
def test_no_row_has_low_friction_that_does_not_say_so(name: str) -> None:
    creep = scenario(name).creep
    assert creep.friction == (0.2 if "wet" in name else 0.4)
    assert not creep.stretches


def test_a_row_changes_what_it_says_and_nothing_else() -> None:
    quiet, alone, smooth = scenario(QUIET_OF), scenario("quiet_alone"), scenario("quiet_smooth")
    assert (len(quiet.vehicles), len(alone.vehicles)) == (2, 1)
    assert alone.section == quiet.section
    assert smooth.sensors == quiet.sensors
    assert smooth.section != quiet.section
    assert len(scenario("quiet_leaves").creep.stretches) == 2
