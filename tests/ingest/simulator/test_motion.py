"""The compiled stepping loop against general-purpose integrators and textbook results."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from analytic_contact import HALF, RADIUS, AnalyticTable, cones, smooth_pair
from linear_wheelset import growth_rate
from same_values import same_values
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline, RegularGridInterpolator
from scipy.optimize import brentq

from estimation.errors import ParameterError
from estimation.values.arrays import FloatArray
from estimation.vehicle.regressors import (
    ContactState,
    WheelsetState,
    lateral_acceleration,
    mass_lateral_acceleration,
    yaw_acceleration,
)
from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.simulator.motion import STEP, WheelsetMotion
from ingest.simulator.running_gear import PreparedTable, RunningGear, simulate_gear
from ingest.simulator.track import TrackRecipe, TrackTruth, make_track

PAPER = VehicleParameters()
ODD = VehicleParameters(spin_creep_coefficient=31.0, yaw_damping=700.0)
ROUGH = TrackRecipe(length=300.0, alignment_std=0.0015, gauge_std=0.001, gauge_offset=0.0005)


@pytest.fixture(scope="module")
def rough_track() -> TrackTruth:
    return make_track(ROUGH, np.random.SeedSequence(3))


def straight(length: float = 4000.0) -> TrackTruth:
    s = np.arange(0.0, length, 1.0)
    return TrackTruth(s, np.zeros(len(s)), np.zeros(len(s)))


def equations(motion: WheelsetMotion) -> tuple[WheelsetState, ContactState]:
    state = WheelsetState(
        motion.lateral_displacement,
        motion.lateral_velocity,
        motion.yaw,
        motion.yaw_rate,
        motion.mass_lateral_displacement,
        motion.mass_lateral_velocity,
    )
    contact = ContactState(
        motion.rolling_radius_left,
        motion.rolling_radius_right,
        motion.contact_angle_left,
        motion.contact_angle_right,
        motion.roll,
        motion.roll_rate,
    )
    return state, contact


def test_accelerations_are_those_of_the_equations(rough_track: TrackTruth) -> None:
    speed = np.linspace(12.0, 28.0, 8000)
    motion = simulate_gear(RunningGear(ODD), [smooth_pair()], rough_track, speed, 20.0)[0]
    state, contact = equations(motion)
    for have, want in (
        (motion.lateral_acceleration, lateral_acceleration(ODD, speed, state, contact)),
        (motion.yaw_acceleration, yaw_acceleration(ODD, speed, state, contact)),
        (motion.mass_lateral_acceleration, mass_lateral_acceleration(ODD, state)),
    ):
        np.testing.assert_allclose(have, want, rtol=0.0, atol=1e-11 * np.abs(want).max())


Rates = Callable[[float, FloatArray], list[float]]


def slow_rates(p: VehicleParameters, table: AnalyticTable, track: TrackTruth, speed: FloatArray, start: float) -> Rates:
    """Return the time derivative of y, y', psi, psi', ym, ym' by scipy's interpolators and the equations of motion."""
    grid = (table.lateral_displacement, table.gauge_deviation)
    names = ("rolling_radius_left", "rolling_radius_right", "contact_angle_left", "contact_angle_right", "roll")
    values = [getattr(table, name) for name in names]
    values += [np.gradient(table.roll, *(axis[1] - axis[0] for axis in grid))[i] for i in (0, 1)]
    look_up = RegularGridInterpolator(grid, np.stack(values, axis=-1))
    d = CubicSpline(track.s, track.alignment, bc_type="natural")
    e = CubicSpline(track.s, track.gauge_deviation, bc_type="natural")
    V = CubicSpline(STEP * np.arange(len(speed)), speed)
    s = V.antiderivative()

    def rates(t: float, state: FloatArray) -> list[float]:
        at, v = start + s(t), float(V(t))
        *four, phi, phi_x, phi_e = look_up([state[0] - d(at), e(at)])[0]
        roll_rate = phi_x * (state[1] - v * d(at, 1)) + phi_e * v * e(at, 1)
        now, contact = WheelsetState(*state), ContactState(*four, phi, roll_rate)
        return [
            state[1],
            float(lateral_acceleration(p, v, now, contact)),
            state[3],
            float(yaw_acceleration(p, v, now, contact)),
            state[5],
            float(mass_lateral_acceleration(p, now)),
        ]

    return rates


STATES = (
    "lateral_displacement",
    "lateral_velocity",
    "yaw",
    "yaw_rate",
    "mass_lateral_displacement",
    "mass_lateral_velocity",
)
AWAY = np.array([1e-3, 0.01, 5e-4, -0.02, -1e-3, 0.005])


def of_one_wheelset(state: FloatArray) -> FloatArray:
    """Return the state of a running gear (11,) with y, y', psi, psi', ym, ym' (6,): u is 0, nothing else is there."""
    return np.concatenate([state[:4], [0.0], state[4:], np.zeros(4)])


@pytest.mark.parametrize(("slow", "fast"), [(14.0, 26.0), (2.0, 3.0)])
def test_motion_is_that_of_a_general_integrator(rough_track: TrackTruth, slow: float, fast: float) -> None:
    speed, times = np.linspace(slow, fast, 401), STEP * np.arange(401)
    initial = of_one_wheelset(AWAY)
    motion = simulate_gear(RunningGear(ODD), [smooth_pair()], rough_track, speed, 30.0, initial=initial)[0]
    rates = slow_rates(ODD, smooth_pair(), rough_track, speed, 30.0)
    expected = solve_ivp(rates, (0.0, times[-1]), AWAY, "DOP853", times, rtol=1e-7, atol=1e-10).y
    for name, want in zip(STATES, expected, strict=True):
        have = getattr(motion, name)
        # the start is a jump that decays in 2 ms, two steps; behind it the loop must follow closely
        np.testing.assert_allclose(have[50:], want[50:], rtol=0.0, atol=2e-4 * np.abs(want[50:]).max(), err_msg=name)


def test_motion_is_the_classical_runge_kutta_method_on_the_equations(rough_track: TrackTruth) -> None:
    speed = np.linspace(40.0, 44.0, 401)  # so fast that no step is divided
    initial = of_one_wheelset(AWAY)
    motion = simulate_gear(RunningGear(ODD), [smooth_pair()], rough_track, speed, 30.0, initial=initial)[0]
    rates, state = slow_rates(ODD, smooth_pair(), rough_track, speed, 30.0), AWAY
    for i in range(400):
        have = np.array([getattr(motion, name)[i] for name in STATES])
        np.testing.assert_allclose(have, state, rtol=1e-9, atol=1e-14)
        t, k = STEP * i, np.zeros((5, 6))
        for stage, share in enumerate((0.0, 0.5, 0.5, 1.0)):
            k[stage + 1] = rates(t + share * STEP, state + share * STEP * k[stage])
        state = state + STEP / 6.0 * np.array([0.0, 1.0, 2.0, 2.0, 1.0]) @ k


def critical_speed(conicity: float) -> float:
    return float(brentq(lambda V: growth_rate(SOFT, V, conicity, 0.0, 0.0), 3.0, 200.0))


SOFT = VehicleParameters(yaw_stiffness=5e5)


@pytest.mark.parametrize("conicity", [0.1, 0.25])
def test_oscillations_die_below_the_critical_speed_and_grow_above(conicity: float) -> None:
    critical = critical_speed(conicity)
    for share, grows in ((0.9, False), (1.1, True)):
        V = share * critical
        initial = of_one_wheelset(np.array([1e-5, 0.0, 0.0, 0.0, 0.0, 0.0]))
        motion = simulate_gear(
            RunningGear(SOFT), [cones(conicity)], straight(), np.full(12_000, V), 0.0, initial=initial
        )[0]
        early = np.abs(motion.lateral_displacement[4000:6000]).max()
        late = np.abs(motion.lateral_displacement[10_000:]).max()
        assert (late > early) == grows
        measured = math.log(late / early) / 6.0
        assert measured == pytest.approx(growth_rate(SOFT, V, conicity, 0.0, 0.0), rel=0.05, abs=0.05)


@pytest.mark.parametrize("conicity", [0.05, 0.2])
def test_a_free_wheelset_at_low_speed_has_klingels_wavelength(conicity: float) -> None:
    free = VehicleParameters(
        yaw_stiffness=1e-6, lateral_stiffness=1e-6, lateral_damping=0.0, load=1e-6, lateral_spin_creep_coefficient=0.0
    )
    initial = of_one_wheelset(np.array([1e-4, 0.0, 0.0, 0.0, 0.0, 0.0]))
    motion = simulate_gear(
        RunningGear(free), [cones(conicity)], straight(), np.full(30_000, 3.0), 0.0, initial=initial
    )[0]
    y, s = motion.lateral_displacement, motion.distance
    down = np.flatnonzero((y[:-1] > 0.0) & (y[1:] <= 0.0))
    crossing = s[down] + (s[down + 1] - s[down]) * y[down] / (y[down] - y[down + 1])
    wavelength = np.diff(crossing).mean()
    assert wavelength == pytest.approx(2.0 * math.pi * math.sqrt(RADIUS * HALF / conicity), rel=2e-3)


def test_rates_are_the_derivatives_of_what_they_are_rates_of(rough_track: TrackTruth) -> None:
    motion = simulate_gear(RunningGear(PAPER), [smooth_pair()], rough_track, np.full(9000, 22.0), 20.0)[0]
    for value, rate in (
        ("lateral_displacement", "lateral_velocity"),
        ("lateral_velocity", "lateral_acceleration"),
        ("yaw", "yaw_rate"),
        ("yaw_rate", "yaw_acceleration"),
        ("roll", "roll_rate"),
        ("roll_rate", "roll_acceleration"),
        ("mass_lateral_velocity", "mass_lateral_acceleration"),
    ):
        given, slope = getattr(motion, value)[500:], getattr(motion, rate)[500:]
        integral = given[0] + STEP * np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]))])
        np.testing.assert_allclose(integral, given, rtol=0.0, atol=2e-3 * np.abs(given - given.mean()).max())


def test_gauge_variation_alone_moves_an_unsymmetric_wheelset() -> None:
    still = make_track(TrackRecipe(length=300.0, alignment_std=0.0, gauge_std=0.0), np.random.SeedSequence(1))
    gauge = make_track(TrackRecipe(length=300.0, alignment_std=0.0, gauge_std=0.001), np.random.SeedSequence(1))
    speed = np.full(8000, 20.0)
    moved = [
        simulate_gear(RunningGear(PAPER), [smooth_pair()], track, speed, 0.0)[0].lateral_displacement
        for track in (still, gauge)
    ]
    assert moved[1][4000:].std() > 20.0 * moved[0][4000:].std()


def test_the_same_run_twice_gives_the_same_bits(rough_track: TrackTruth) -> None:
    speed = np.linspace(10.0, 20.0, 3000)
    runs = [
        simulate_gear(RunningGear(PAPER), [PreparedTable.of(smooth_pair())], rough_track, speed, 5.0)[0]
        for _ in range(2)
    ]
    assert same_values(runs[0], runs[1])


def test_leaving_the_contact_table_is_counted() -> None:
    initial = of_one_wheelset(np.array([9e-3, 0.0, 0.0, 0.0, 9e-3, 0.0]))
    motion = simulate_gear(
        RunningGear(PAPER), [smooth_pair()], straight(100.0), np.full(1000, 20.0), 0.0, initial=initial
    )[0]
    x = motion.relative_displacement
    assert motion.outside == np.count_nonzero(np.abs(x) > 8e-3) > 0


@pytest.mark.parametrize(
    ("speed", "start", "field"),
    [(-0.2, 0.0, "speed"), (math.nan, 0.0, "speed"), (20.0, -1.0, "start"), (20.0, 90.0, "start")],
)
def test_impossible_runs_are_refused(speed: float, start: float, field: str) -> None:
    with pytest.raises(ParameterError) as refused:
        simulate_gear(RunningGear(PAPER), [cones(0.1)], straight(100.0), np.full(1000, speed), start)[0]
    assert refused.value.field == field
