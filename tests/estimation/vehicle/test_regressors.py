"""What a motion knows of its vehicle goes into the equations where physics puts it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from bogie_run import COACH, SOFT, WHEELBASE, ideal_in_bogie, motions, wheelset
from oracles.regression import both_equations
from smooth_wheelset import SmoothTable, ideal, run, track

from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.quantities import Status
from estimation.values.track import AlignmentSource, GaugeShift, TrackAlignment, TrackFindings
from estimation.values.windows import Motion
from estimation.vehicle.regressors import YAW_TARGETS, regression
from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.simulator.motion import WheelsetMotion
from ingest.simulator.running_gear import RunningGear, simulate_gear

ASSUMED = VehicleParameters()
STIFFER = 1.25  # times as stiff in yaw as assumed
WHEEL = GaugeShift(np.linspace(-5e-3, 5e-3, 3), np.linspace(-4e-3, 4e-3, 2), np.zeros((3, 2)))


@cache
def stiff_run() -> WheelsetMotion:
    """Return a run of a vehicle that is stiffer in yaw than its registry says."""
    truth = replace(ASSUMED, yaw_stiffness=STIFFER * ASSUMED.yaw_stiffness)
    return simulate_gear(RunningGear(truth), [SmoothTable(0.12)], track(1), np.full(40_000, 20.0), 10.0)[0]


def difference_left(motion: Motion, m: WheelsetMotion) -> float:
    """Return the error of rL - rR by the yaw equation, contact angles given, over its std."""
    equation = regression(motion, ASSUMED)
    angles, c = equation.yaw.T
    by_equation = (equation.yaw_targets[:, 0] - (m.contact_angle_left + m.contact_angle_right) * angles) / c
    true = m.rolling_radius_left - m.rolling_radius_right
    return float((by_equation - true).std() / true.std())


def test_the_stiffness_ratio_learnt_of_a_vehicle_puts_its_radius_difference_right() -> None:
    """The true equations made the motion; only the inertia, small beside the yaw spring, is scaled along."""
    motion = ideal(stiff_run())
    wrong = difference_left(motion, stiff_run())
    right = difference_left(replace(motion, stiffness_ratio=STIFFER), stiff_run())
    assert wrong > 0.05
    assert right < 0.15 * wrong
    assert difference_left(replace(motion, stiffness_ratio=1 / STIFFER), stiff_run()) > 1.5 * wrong


def test_the_stiffness_ratio_goes_with_one_over_the_creep_coefficient() -> None:
    """Softer creep and stiffer springs answer alike: the ratio means both."""
    motion = ideal(run(20))
    softer = replace(ASSUMED, longitudinal_creep_coefficient=ASSUMED.longitudinal_creep_coefficient / STIFFER)
    ours, theirs = both_equations(replace(motion, stiffness_ratio=STIFFER), ASSUMED), both_equations(motion, softer)
    for name in ("lateral", "lateral_targets", "yaw", "yaw_targets"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-12)


@pytest.mark.parametrize("ratio", [1.0, 1.2])
def test_sensitivity_to_longitudinal_creep_is_the_derivative_of_the_radius_difference(ratio: float) -> None:
    motion = replace(ideal(run(20)), stiffness_ratio=ratio)
    base = regression(motion, ASSUMED)
    step = 1e-6
    changed = replace(ASSUMED, longitudinal_creep_coefficient=ASSUMED.longitudinal_creep_coefficient * (1 + step))
    moved = regression(motion, changed)
    value, other = (one.yaw_targets[:, 0] / one.yaw[:, 1] for one in (base, moved))
    expected = base.yaw_targets[:, YAW_TARGETS.index("longitudinal_creep")] / base.yaw[:, 1]
    np.testing.assert_allclose((other - value) / step, expected, rtol=1e-3, atol=1e-8)


def track_of(std: float | None, scale_std: float = 0.0) -> TrackAlignment:
    zero = np.zeros(2)
    found = None if std is None else TrackFindings({"V1": 1.1}, std, {})
    return TrackAlignment(
        "S",
        1,
        np.arange(2.0),
        zero,
        zero,
        zero,
        zero,
        zero.astype(np.int64),
        Status.ESTIMATED,
        scale_std=scale_std,
        findings=found,
    )


def test_a_geometry_is_as_sure_of_the_ratio_as_the_least_sure_of_its_alignments() -> None:
    assumed = ParameterUncertainty()
    both = assumed.on([track_of(0.01, 0.007), track_of(0.03, 0.002)])
    assert (both.ratio, both.displacement) == (0.03, 0.007)
    assert (both.creep, both.stiffness, both.mass) == (assumed.creep, assumed.stiffness, assumed.mass)
    for mixed in ([track_of(0.01), track_of(None)], [track_of(None)], []):
        assert assumed.on(mixed).ratio is None, "one without findings leaves all open"
    assert assumed.on([]) == assumed


@pytest.mark.parametrize(
    ("change", "share"),
    [
        ({}, 0.5),  # nothing is known of what it does
        ({"findings": TrackFindings({"V1": 1.1}, 0.01, {})}, 0.5),
        ({"findings": TrackFindings({"V1": 1.1}, 0.01, {"W2": WHEEL})}, 0.5),
        ({"findings": TrackFindings({"V1": 1.1}, 0.01, {"W1": WHEEL})}, 0.22),
        (
            {
                "findings": TrackFindings({"V1": 1.1}, 0.01, {"W1": WHEEL}),
                "gauge_known": False,
                "source": AlignmentSource.FLEET,
            },
            0.32,
        ),
    ],
)
def test_contact_jumps_are_as_far_off_as_the_gauge_is_left_in(change: dict[str, Any], share: float) -> None:
    gauge = np.array([1e-3, -1e-3])
    on = replace(track_of(None), gauge_deviation=gauge, **change)
    assert ParameterUncertainty().on([on], "W1").jump_position_std == pytest.approx(share * 1e-3)
    assert ParameterUncertainty().on([replace(on, gauge_deviation=gauge + 5e-3)], "W1").jump_position_std < 0.6e-3
    assert ParameterUncertainty().on([replace(on, gauge_deviation=np.full(2, 1e-3))], "W1").jump_position_std == 0.0


def test_a_recording_has_taught_nothing_of_a_wheelset_that_it_has_not_met() -> None:
    surveyed = replace(track_of(0.01), findings=TrackFindings({"V1": 1.1}, 0.01, {"W1": WHEEL}))
    assert ParameterUncertainty().on([surveyed], "W1").ratio == 0.01
    assert ParameterUncertainty().on([surveyed], "W2").ratio is None
    assert ParameterUncertainty().on([replace(surveyed, source=AlignmentSource.FLEET)], "W2").ratio == 0.01


def test_a_learnt_ratio_stands_for_creep_and_yaw_stiffness_in_the_yaw_equation_alone() -> None:
    assumed = ParameterUncertainty(creep=0.1, stiffness=0.05, mass=0.025)
    learnt = assumed.on([track_of(0.01)])
    assert dict(zip(YAW_TARGETS[1:], assumed.yaw(), strict=True)) == {
        "longitudinal_creep": 0.1,
        "yaw_stiffness": 0.05,
        "yaw_inertia": 0.025,
        "spin_creep": 0.1,
        "saturation": math.hypot(3.3, 1.2),
        "noise": 0.0,
        "displacement_noise": 0.0,
    }
    assert dict(zip(YAW_TARGETS[1:], learnt.yaw(), strict=True)) == {
        "longitudinal_creep": 0.0,
        "yaw_stiffness": 0.01,
        "yaw_inertia": 0.025,
        "spin_creep": 0.1,
        "saturation": math.hypot(3.3, 1.2),
        "noise": 0.0,
        "displacement_noise": 0.0,
    }
    np.testing.assert_array_equal(learnt.lateral(), assumed.lateral())


@pytest.mark.parametrize("yaw_stiffness", [SOFT, COACH])
@pytest.mark.parametrize("axle", [0, 1])
def test_the_equations_hold_in_a_bogie_on_the_true_geometry(yaw_stiffness: float, axle: int) -> None:
    """The spring is tied to the frame, sample by sample; without the frame's yaw the moment is another."""
    m, p = motions(yaw_stiffness)[axle], wheelset(yaw_stiffness)
    motion = ideal_in_bogie(m)
    equation = both_equations(motion, p, wheelbase=WHEELBASE)
    R, A = m.rolling_radius_left - m.rolling_radius_right, m.contact_angle_left + m.contact_angle_right
    S, D = m.rolling_radius_left + m.rolling_radius_right, m.contact_angle_left - m.contact_angle_right
    z1, z2 = equation.lateral_targets[:, 0], equation.yaw_targets[:, 0]
    angles = p.half_contact_distance * p.load / 2 * m.yaw
    inner = slice(2000, -10)  # the first steps of the fastest creep modes are coarse
    left = (z2 - A * angles - R * equation.yaw[:, -1])[inner]
    assert np.abs(left).max() < 2e-3 * np.abs(z2[inner]).max()
    assert np.abs((z1 - S * equation.lateral[:, 0] - D * equation.lateral[:, 1])[inner]).max() < 1e-3 * np.abs(z1).max()
    blind = replace(motion, frame_yaw=None, frame_yaw_rate=None, frame_displacement=None)
    alone = regression(blind, p).yaw_targets[:, 0] - A * angles - R * equation.yaw[:, -1]
    assert np.abs(alone[inner]).max() > 0.1 * np.abs(z2[inner]).max()
    rolling = (m.lateral_velocity + p.nominal_radius * m.roll_rate) / m.speed
    np.testing.assert_allclose(equation.yaw[:, 0], p.yaw_stiffness * rolling, atol=1e-9 * p.yaw_stiffness)
    np.testing.assert_allclose(equation.yaw[:, 1], p.yaw_stiffness * m.mass_lateral_displacement / WHEELBASE)


def test_the_derivative_by_friction_is_that_of_the_creep_law() -> None:
    """Vermeulen and Johnson: the linear creep that a force needs, at friction so large that it bounds little."""
    motion = ideal(run(20))
    target = regression(motion, ASSUMED).yaw_targets[:, YAW_TARGETS.index("saturation")]
    p, inverse = ASSUMED, 1e-4  # 1/mu
    moment = p.yaw_inertia * motion.yaw_acceleration + p.yaw_stiffness * motion.yaw + p.yaw_damping * motion.yaw_rate
    lateral = p.wheelset_mass * motion.lateral_acceleration + p.load * motion.roll
    lateral -= p.lateral_stiffness * motion.suspension_deflection
    lateral -= p.lateral_damping * motion.suspension_deflection_rate
    force = np.hypot(moment / (2.0 * p.half_contact_distance), 0.5 * lateral)  # of one wheel
    per_bound = inverse / (0.5 * p.axle_load)
    linear = force.copy()
    for _ in range(20):
        u = linear * per_bound
        linear = force / (1.0 - u / 3.0 + u**2 / 27.0)
    found = moment * (linear / np.maximum(force, 1e-12) - 1.0) / inverse
    np.testing.assert_allclose(found, target, rtol=1e-3, atol=1e-3 * np.abs(target).max())


def test_the_noise_targets_are_variances_by_the_sensors_at_the_speed_of_the_sample() -> None:
    motion = replace(ideal(run(20, swing=3.0)), displacement_noise=5.0)
    equation = regression(motion, ASSUMED, difference_noise=7.0)
    targets = dict(zip(YAW_TARGETS, (equation.yaw_targets / equation.yaw[:, 1:]).T, strict=True))
    np.testing.assert_allclose(targets["noise"], 7.0 / motion.speed**3)
    np.testing.assert_allclose(targets["displacement_noise"], 5.0)
    assert not regression(replace(motion, displacement_noise=0.0), ASSUMED).yaw_targets[:, -2:].any()
