"""The equations of the suspension against those of the whole running gear, and against complex stiffnesses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sinusoids import BOGIE, SINGLE, SOFT, following

from estimation.adhesion.stationary_filter import AXLE, gear_equations
from estimation.dampers.suspension_equations import mass_std, suspension_equations, uncertain_parameters
from estimation.vehicle.vehicle_class import VehicleClass


def test_the_frame_accelerates_as_in_the_equations_of_the_whole_running_gear() -> None:
    share = 0.37
    bogie = replace(BOGIE, secondary_lateral_damping=share * BOGIE.secondary_lateral_damping)
    gear = gear_equations(SOFT.parameters, bogie)
    state = np.random.default_rng(1).standard_normal(len(gear.rates))
    above = 2 * AXLE
    y, v = state[[0, AXLE]].mean(), state[[1, AXLE + 1]].mean()
    frame, body = state[[above, above + 1]], state[[above + 4, above + 5]]
    deflections = np.array([frame[0] - y, frame[1] - v, body[0] - frame[0], body[1] - frame[1]])
    equations = suspension_equations(SOFT, share, {})
    nodes = gear.measured[-2:] @ state
    assert equations.measured @ deflections == pytest.approx(nodes.mean(), rel=1e-12)
    body_rate = (gear.rates @ state)[above + 5]
    assert (equations.rates @ deflections)[3] == pytest.approx(body_rate - nodes.mean(), rel=1e-12)


def test_each_ratio_has_the_stds_of_both() -> None:
    stds = {"frame_mass": 0.03, "body_mass": 0.04, "lateral_stiffness": 0.04, "secondary_lateral_stiffness": 0.03}
    found = uncertain_parameters(replace(SOFT, relative_std=stds))
    assert found["lateral_stiffness"] == pytest.approx(0.05)
    assert found["secondary_lateral_stiffness"] == pytest.approx(0.05)
    assert found["body_mass"] == pytest.approx(0.05)
    assert found["lateral_damping"] == pytest.approx(np.hypot(0.1, 0.03))


@pytest.mark.parametrize("vehicle_class", [SOFT, SINGLE])
def test_what_is_above_follows_by_the_complex_stiffness(vehicle_class: VehicleClass) -> None:
    omega = np.array([1.0, 4.0, 20.0, 60.0])
    factors = dict.fromkeys(uncertain_parameters(vehicle_class), 1.1)
    p, bogie = vehicle_class.parameters, vehicle_class.bogie
    changed = replace(vehicle_class, parameters=replace(p, lateral_stiffness=1.1 * p.lateral_stiffness))
    if bogie is not None:
        both = replace(changed.parameters, lateral_damping=1.1 * p.lateral_damping)
        spring = 1.1**2 * bogie.secondary_lateral_stiffness  # its own factor, and that of the body above it
        heavier = replace(bogie, body_mass=1.1 * bogie.body_mass, secondary_lateral_stiffness=spring)
        changed = replace(changed, parameters=both, bogie=heavier)
    equations = suspension_equations(vehicle_class, 0.4, factors)
    n = len(equations.rates)
    found = [
        equations.measured @ np.linalg.solve(1j * w * np.eye(n) - equations.rates, equations.by_input) for w in omega
    ]
    assert np.array(found) == pytest.approx(following(changed, 0.4, omega), rel=1e-9)


def test_the_std_of_the_mass_is_that_of_what_follows_the_wheelsets() -> None:
    stds = {"frame_mass": 0.07, "suspended_mass": 0.04}
    assert mass_std(replace(SOFT, relative_std=stds)) == 0.07
    assert mass_std(replace(SINGLE, relative_std=stds)) == 0.04
