"""The equations of motion against a linear system worked out by hand, and parameters that cannot be."""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_wheelset import linear_system

from estimation.errors import ParameterError
from estimation.vehicle.regressors import (
    ContactState,
    WheelsetState,
    lateral_acceleration,
    mass_lateral_acceleration,
    yaw_acceleration,
)
from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.simulator.running_gear import creep_rate

ODD = VehicleParameters(spin_creep_coefficient=31.0, yaw_damping=700.0)
small = st.floats(-1e-2, 1e-2)


@given(st.lists(small, min_size=6, max_size=6), st.floats(2.0, 60.0))
def test_cones_give_the_linear_system_worked_out_by_hand(state: list[float], speed: float) -> None:
    conicity, angle_slope, roll_slope = 0.17, 9.0, 0.11
    y, v, psi, psi_rate, ym, vm = state
    contact = ContactState(
        rolling_radius_left=0.45 + conicity * y,
        rolling_radius_right=0.45 - conicity * y,
        contact_angle_left=conicity + angle_slope * y,
        contact_angle_right=conicity - angle_slope * y,
        roll=roll_slope * y,
        roll_rate=roll_slope * v,
    )
    at = WheelsetState(y, v, psi, psi_rate, ym, vm)
    matrix = linear_system(ODD, speed, conicity, angle_slope, roll_slope)
    expected = matrix @ np.array(state)
    scale = np.abs(matrix) @ np.abs(np.array(state))
    got = [
        lateral_acceleration(ODD, speed, at, contact),
        yaw_acceleration(ODD, speed, at, contact),
        mass_lateral_acceleration(ODD, at),
    ]
    # radii of half a metre lose 1e-16 m of their difference, which weighs l f11 / (r0 I) = 2e4 1/(m s2) in psi''
    np.testing.assert_allclose(got, expected[[1, 3, 5]], atol=1e-11 * max(scale.max(), 1.0))


def test_every_printed_term_pulls_the_way_the_axes_say() -> None:
    p = VehicleParameters()
    rest = WheelsetState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    larger_left = ContactState(0.451, 0.449, 0.1, 0.05, 0.0, 0.0)
    assert yaw_acceleration(p, 20.0, rest, larger_left) < 0.0  # the larger left radius steers back to the right
    without_spin = VehicleParameters(lateral_spin_creep_coefficient=0.0)
    assert lateral_acceleration(without_spin, 20.0, rest, larger_left) < 0.0  # gravity: the steeper side pushes away
    assert lateral_acceleration(p, 20.0, rest, larger_left) > 0.0  # spin creep, f23/r0, is stronger than gravity, W/2
    centred = ContactState(0.45, 0.45, 0.1, 0.1, 0.0, 0.0)
    turned_left = WheelsetState(0.0, 0.0, 1e-3, 0.0, 0.0, 0.0)
    assert lateral_acceleration(p, 20.0, turned_left, centred) > 0.0  # it rolls where it points
    lifted = ContactState(0.45, 0.45, 0.1, 0.1, 1e-3, 0.0)
    assert lateral_acceleration(p, 20.0, rest, lifted) < 0.0


def test_arrays_give_what_scalars_give() -> None:
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(12, 50)) * 1e-2
    speed = rng.uniform(5.0, 40.0, 50)
    state, contact = WheelsetState(*columns[:6]), ContactState(*(columns[6:] + 0.4))
    for equation in (lateral_acceleration, yaw_acceleration):
        one_by_one = [
            equation(ODD, speed[i], WheelsetState(*columns[:6, i]), ContactState(*(columns[6:, i] + 0.4)))
            for i in range(50)
        ]
        np.testing.assert_array_equal(equation(ODD, speed, state, contact), one_by_one)


def test_creep_rate_is_the_printed_stiffness_of_the_system() -> None:
    assert creep_rate(VehicleParameters()) / 20.0 == pytest.approx(590.2, rel=1e-3)  # yaw; lateral is 543
    assert creep_rate(VehicleParameters(yaw_inertia=7000.0)) / 20.0 == pytest.approx(543.2, rel=1e-3)


@pytest.mark.parametrize("name", [item.name for item in fields(VehicleParameters)])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_impossible_parameters_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ParameterError) as refused:
        VehicleParameters(**{name: value})
    assert refused.value.field == name


def test_a_massless_wheelset_is_refused() -> None:
    with pytest.raises(ParameterError, match="wheelset_mass"):
        VehicleParameters(wheelset_mass=0.0)
