"""The simulated bogie against a direct integration of its equations of motion, and against its own equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bogie_case import DT, GEAR
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from smooth_wheelset import track

from estimation.bogie.curves import Curves, nodes
from estimation.bogie.equations import PARAMETERS, moving_rows, saturation, terms
from estimation.bogie.signals import BogieRun
from estimation.bogie.simulation import Gear, Simulated, simulate
from estimation.vehicle.linear_model import LinearContact
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.regressors import (
    ContactState,
    WheelsetState,
    lateral_acceleration,
    lateral_suspension_force,
    yaw_acceleration,
    yaw_suspension_moment,
)

SPEED, SECONDS, DIRECT_SECONDS = 20.0, 6.0, 1.5
CURVES = Curves(np.stack([2 * 0.12 * nodes() + 1500.0 * nodes() ** 3, 2 * 0.16 * nodes() + 8.0 * nodes() ** 2]))


def _run(seconds: float = SECONDS) -> BogieRun:
    n, of = round(seconds / DT), track(3)
    at = 100.0 + SPEED * DT * np.arange(n)
    spline, nothing = CubicSpline(of.s, of.alignment), np.zeros((3, 2, n))
    return BogieRun(
        interval_s=DT, speed=np.full(n, SPEED), lateral=nothing, yaw=nothing, roll=nothing[:2],
        frame_lateral=nothing[0], frame_yaw=nothing[:, 0], relative=nothing[0], stretch=1.0, swapped=False,
        ahead=np.stack([spline(at), spline(at - GEAR.bogie.wheelbase)]),
        place=np.stack([at, at - GEAR.bogie.wheelbase]),
    )  # fmt: skip


def _contact(row: int, x: float, rate: float) -> tuple[ContactState, float]:
    p, step = GEAR.vehicle, 1e-7
    height = p.nominal_radius + VEHICLE.rail_head_radius
    half = p.half_contact_distance

    def difference(x: float) -> float:
        found = 0.0
        for _ in range(30):  # the curve is over the displacement with the roll that follows from it
            found = float(np.interp(x + height * found / (2 * half), nodes(), CURVES.values[row]))
        return found

    value = difference(x)
    rise = (difference(x + step) - difference(x - step)) / (2 * step)
    angle = LinearContact().angle_per_difference * value / 2
    state = ContactState(
        rolling_radius_left=p.nominal_radius + value / 2,
        rolling_radius_right=p.nominal_radius - value / 2,
        contact_angle_left=LinearContact().angle_sum / 2 + angle,
        contact_angle_right=LinearContact().angle_sum / 2 - angle,
        roll=value / (2 * half),
        roll_rate=rise * rate / (2 * half),
    )
    return state, value


def _rates(t: float, state: np.ndarray, splines: list[CubicSpline]) -> np.ndarray:
    p, b = GEAR.vehicle, GEAR.bogie
    q, v = state[:7], state[7:]
    rates, force, moment = np.zeros(7), b.secondary_lateral_stiffness * (q[6] - q[4]), 0.0
    force += b.secondary_lateral_damping * (v[6] - v[4])
    rates[6] = -force / b.body_mass
    moment -= b.secondary_yaw_stiffness * q[5]
    for row, arm in enumerate((b.wheelbase / 2, -b.wheelbase / 2)):
        y, psi, at = q[2 * row], q[2 * row + 1], 2 * row
        contact, _ = _contact(row, y - float(splines[row](t)), v[at] - float(splines[row](t, 1)))
        own = WheelsetState(y, v[at], psi, v[at + 1], q[4] + arm * q[5], v[4] + arm * v[5])
        tied = replace(own, yaw=psi - q[5], yaw_rate=v[at + 1] - v[5])
        turned = yaw_suspension_moment(p, tied)
        rates[at] = lateral_acceleration(p, SPEED, own, contact)
        more = turned - yaw_suspension_moment(p, own)
        rates[at + 1] = yaw_acceleration(p, SPEED, own, contact) + more / p.yaw_inertia
        pressed = lateral_suspension_force(p, own)
        force, moment = force - pressed, moment - turned - arm * pressed
    rates[4], rates[5] = force / b.frame_mass, moment / b.frame_yaw_inertia
    return np.concatenate([v, rates])


@pytest.mark.slow
def test_it_is_the_direct_integration_of_the_equations_of_motion() -> None:
    run = _run(DIRECT_SECONDS)
    found = simulate(GEAR, CURVES, run)
    assert found is not None
    t = DT * np.arange(len(run))
    splines = [CubicSpline(t, row) for row in run.ahead]
    start = np.zeros(14)
    start[[0, 2, 4]] = run.ahead[0, 0], run.ahead[1, 0], run.ahead[:, 0].mean()
    direct = solve_ivp(_rates, (0.0, t[-1]), start, t_eval=t, args=(splines,), method="LSODA", rtol=1e-6, atol=1e-9)
    for row in range(2):
        x = direct.y[2 * row] - run.ahead[row]
        ours = found.lateral[0, row] - run.ahead[row]
        assert np.abs(ours - x).max() < 0.05 * x.std()
        assert np.abs(found.yaw[0, row] - direct.y[2 * row + 1]).max() < 0.05 * direct.y[2 * row + 1].std()


def _terms(gear: Gear, moved: Simulated, run: BogieRun) -> np.ndarray:
    saturated = np.stack([saturation(gear, moved, axle) for axle in range(2)])
    return terms(gear, moving_rows(moved, run.speed, gear.vehicle.nominal_radius), saturated)


def _residual(gear: Gear, moved: Simulated, run: BogieRun) -> tuple[np.ndarray, np.ndarray]:
    own = _terms(gear, moved, run)[:, 0]
    R = np.stack([np.interp(moved.relative[row], nodes(), CURVES.values[row]) for row in range(2)])
    return (own + np.concatenate([R, np.zeros((1, len(run)))]))[:, 100:-100], R[:, 100:-100]


@pytest.mark.parametrize("inverse_friction", [0.0, 3.0])
def test_its_motion_fulfils_the_equations_of_the_estimate(inverse_friction: float) -> None:
    gear, run = replace(GEAR, inverse_friction=inverse_friction), _run()
    moved = simulate(gear, CURVES, run)
    assert moved is not None
    residual, R = _residual(gear, moved, run)
    assert (residual[:2].std(axis=1) < 0.03 * R.std(axis=1)).all()
    assert residual[2].std() < 0.03 * R.std()


def test_saturation_that_is_left_out_shows_in_the_equations() -> None:
    gear, run = replace(GEAR, inverse_friction=3.0), _run()
    moved = simulate(gear, CURVES, run)
    assert moved is not None
    residual, R = _residual(replace(gear, inverse_friction=0.0), moved, run)
    assert residual[0].std() > 0.05 * R[0].std()


def test_the_column_of_friction_is_the_derivative_of_what_saturation_takes() -> None:
    run, step = _run(), 1e-4
    moved = simulate(replace(GEAR, inverse_friction=3.0), CURVES, run)
    assert moved is not None
    low, high = (saturation(replace(GEAR, inverse_friction=3.0 + side), moved, 0)[0] for side in (-step, step))
    derivative = saturation(replace(GEAR, inverse_friction=3.0), moved, 0)[1]
    assert np.allclose(derivative, (high - low) / (2 * step), rtol=1e-4, atol=1e-3 * np.abs(derivative).max())


def test_columns_are_derivatives_by_the_parameters_of_the_vehicle() -> None:
    run, step = _run(), 1e-3
    moved = simulate(GEAR, CURVES, run)
    assert moved is not None
    for name, field in (("yaw_stiffness", "yaw_stiffness"), ("lateral_stiffness", "lateral_stiffness")):
        value = getattr(GEAR.vehicle, field)
        changed = replace(GEAR, vehicle=replace(GEAR.vehicle, **{field: (1 + step) * value}))
        slope = (_terms(changed, moved, run)[:, 0] - _terms(GEAR, moved, run)[:, 0]) / step
        column = _terms(GEAR, moved, run)[:, 1 + PARAMETERS.index(name)]
        assert np.allclose(slope, column, rtol=1e-6, atol=1e-9 * np.abs(column).max())


def test_a_bogie_that_leaves_the_track_is_not_simulated_further() -> None:
    steep = Curves(np.tile(2 * 6.0 * nodes(), (2, 1)))
    assert simulate(GEAR, steep, _run()) is None
