"""The linear equations of a running gear against Newton's third law and the equations of one wheelset."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.adhesion.stationary_filter import AXLE, gear_equations
from estimation.vehicle.regressors import (
    WheelsetState,
    lateral_suspension_force,
    mass_lateral_acceleration,
    yaw_suspension_moment,
)
from estimation.vehicle.vehicle_class import BogieParameters, VehicleParameters

P = VehicleParameters(yaw_damping=3e3, load=90e3)
BOGIE = BogieParameters(2.5, 2600.0, 3000.0, 16e3, 0.32e6, 64e3, 0.3e6, 5e3)


def test_a_single_wheelset_is_that_of_equations_1_to_5() -> None:
    gear = gear_equations(P, None)
    rng = np.random.default_rng(3)
    y, v, psi, turning, ym, vm = state = rng.standard_normal(6)
    force, moment = 700.0, -1900.0
    rates = gear.rates @ state + gear.inputs @ [force, moment]
    as_one = WheelsetState(y, v, psi, turning, ym, vm)
    assert rates[1] == pytest.approx((force + lateral_suspension_force(P, as_one)) / P.wheelset_mass)
    assert rates[3] == pytest.approx((moment + yaw_suspension_moment(P, as_one)) / P.yaw_inertia)
    assert rates[5] == pytest.approx(mass_lateral_acceleration(P, as_one))
    assert rates[[0, 2, 4]] == pytest.approx([v, turning, vm])


def test_only_what_acts_from_outside_changes_momentum_and_its_moment() -> None:
    gear = gear_equations(P, BOGIE)
    state = np.random.default_rng(4).standard_normal(len(gear.rates))
    forces = np.array([500.0, 1500.0, -900.0, 2500.0])
    a = gear.rates @ state + gear.inputs @ forces
    lateral = P.wheelset_mass * (a[1] + a[5]) + BOGIE.frame_mass * a[9] + BOGIE.body_mass * a[13]
    assert lateral == pytest.approx(forces[0] + forces[2])
    half = 0.5 * BOGIE.wheelbase
    spin = P.yaw_inertia * (a[3] + a[7]) + BOGIE.frame_yaw_inertia * a[11]
    orbital = half * P.wheelset_mass * (a[1] - a[5])
    secondary = -BOGIE.secondary_yaw_stiffness * state[10] - BOGIE.secondary_yaw_damping * state[11]
    assert spin + orbital == pytest.approx(forces[1] + forces[3] + half * (forces[0] - forces[2]) + secondary)


def test_sensors_above_are_on_the_frame_over_the_axles() -> None:
    gear = gear_equations(P, BOGIE)
    state = np.random.default_rng(5).standard_normal(len(gear.rates))
    rates = gear.rates @ state
    front, rear = (gear.measured @ state)[4:]
    assert front - rear == pytest.approx(BOGIE.wheelbase * rates[11])
    assert 0.5 * (front + rear) == pytest.approx(rates[9])
    assert (gear.measured @ state)[:4] == pytest.approx(rates[[1, 3, AXLE + 1, AXLE + 3]])
