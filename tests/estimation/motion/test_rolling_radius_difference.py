"""The rolling radius difference of a pass holds long wavelengths that the yaw sensor alone has lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.signal import butter, sosfilt
from smooth_wheelset import mems_windows, run
from whole_runs import whole_runs
from window_passes import window_passes

from estimation.filters import high_pass, local_cubic_kernel
from estimation.motion.rolling_radius_difference import MotionSignals, _sampled, _shortest
from estimation.track.passes import Pass
from estimation.values.arrays import FloatArray
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import VehicleParameters

VEHICLE = VehicleParameters()


def _pass(window: Window) -> Pass:
    (found,) = window_passes(window, VEHICLE)
    return found


def _by_yaw_sensor(window: Window, at: FloatArray) -> FloatArray:
    """Return R (n,) by Eq. 2 from the yaw sensor and nothing else, its terms beyond creep and yaw spring left out."""
    p, dt = VEHICLE, window.sample_interval_s
    rate = cumulative_trapezoid(window.yaw_acceleration, dx=dt, initial=0.0)
    yaw = cumulative_trapezoid(rate, dx=dt, initial=0.0)
    stiffness_term = p.yaw_inertia * window.yaw_acceleration + p.yaw_stiffness * yaw
    creep = 2 * p.half_contact_distance**2 * p.longitudinal_creep_coefficient / window.speed * rate
    per_moment = -p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient)
    return np.asarray(np.interp(at, window.distance, per_moment * (stiffness_term + creep)))


def _rms_between(values: FloatArray, step: float, short: float, long: float) -> float:
    """Return the rms of the wavelengths from ``short`` to ``long``, away from the ends."""
    weights, reach = local_cubic_kernel(short, step), local_cubic_kernel(long, step)
    band = high_pass(values, reach) - high_pass(values, weights)
    margin = len(reach) // 2
    return float(np.sqrt((band[margin:-margin] ** 2).mean()))


@pytest.mark.parametrize(("cone", "speed"), [(0.05, 17.0), (0.10, 20.0), (0.16, 23.0)])
def test_long_waves_of_the_radius_difference_come_out_far_better_than_from_the_yaw_sensor(
    cone: float, speed: float
) -> None:
    motion = run(120, seed=1, cone=cone, speed=speed)
    (window,) = whole_runs(mems_windows(motion, seed=3))
    found = _pass(window)
    step = float(found.at[1] - found.at[0])
    true = np.interp(found.at, motion.distance, motion.rolling_radius_left - motion.rolling_radius_right)
    alone = _rms_between(_by_yaw_sensor(window, found.at) - true, step, 20.0, 100.0)
    ours = _rms_between(found.difference - true, step, 20.0, 100.0)
    assert ours < alone / 5
    assert ours < 0.15 * _rms_between(true, step, 20.0, 100.0)


def test_short_waves_are_left_to_the_yaw_sensor() -> None:
    motion = run(120, seed=1, cone=0.10, speed=20.0)
    (window,) = whole_runs(mems_windows(motion, seed=3))
    found = _pass(window)
    step = float(found.at[1] - found.at[0])
    alone = _by_yaw_sensor(window, found.at)
    apart = _rms_between(found.difference - alone, step, 1.5, 7.0)
    assert apart < 0.05 * _rms_between(alone, step, 1.5, 7.0)


def test_vibration_of_the_axle_box_does_not_look_like_waves_of_the_track() -> None:
    (window,) = whole_runs(mems_windows(run(120, seed=1, cone=0.10, speed=20.0), seed=3))
    rate = 1 / window.sample_interval_s
    shake = sosfilt(butter(4, (20, 100), "bandpass", fs=rate, output="sos"), _white(window, 4))
    shaken = replace(
        window,
        lateral_acceleration=window.lateral_acceleration + 5.0 / shake[0].std() * shake[0],
        yaw_acceleration=window.yaw_acceleration + 2.5 / shake[1].std() * shake[1],
    )
    still, found = _pass(window), _pass(shaken)
    grid = np.arange(np.ceil(still.at[0]), still.at[-1])
    for name in ("displacement", "difference"):
        one, other = (np.interp(grid, item.at, getattr(item, name)) for item in (found, still))
        assert _rms_between(one - other, 1.0, 2.0, 20.0) < 0.015e-3, name


def test_short_waves_stay_where_the_axle_box_does_not_vibrate() -> None:
    """They are those of contact jumps; the limit is between what quiet and what vibrating axle boxes have."""
    at = np.arange(0.0, 300.0, 0.08)
    jumps = 0.2e-3 * np.sign(np.sin(2 * np.pi * at / 12.0))

    def of_rolling_yaw(size: float) -> FloatArray:
        zero, shaken = np.zeros(len(at)), size * np.sqrt(2.0) * np.sin(2 * np.pi * at / 1.2)
        signals = MotionSignals(at, zero + 20.0, zero, jumps, zero, shaken, zero)
        run = np.arange(8.0, 292.0, 0.25)
        shortest = _shortest(signals, run)
        return _sampled(jumps[None], at, run, shortest)[0]

    quiet, vibrating = of_rolling_yaw(0.07e-3), of_rolling_yaw(0.1e-3)
    assert np.abs(np.diff(quiet)).max() > 1.5 * np.abs(np.diff(vibrating)).max()


def _white(window: Window, seed: int) -> FloatArray:
    return np.random.default_rng(seed).standard_normal((2, len(window.valid)))


def test_windows_that_follow_each_other_give_the_pass_of_one_long_window() -> None:
    motion = run(120, seed=1, cone=0.10, speed=20.0)
    (whole,) = mems_windows(motion, seed=3, length_s=120)
    (together,) = whole_runs(mems_windows(motion, seed=3, length_s=30))
    np.testing.assert_array_equal(together.lateral_acceleration, whole.lateral_acceleration)
    one, other = _pass(whole), _pass(together)
    for name in ("at", "displacement", "difference", "stiffness_term"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_windows_are_joined_only_without_a_gap_between_them() -> None:
    cut = mems_windows(run(120, seed=1, cone=0.10, speed=20.0), seed=3, length_s=30)
    assert [w.length_ns for w in whole_runs([cut[0], cut[1], cut[3]])] == [60_000_000_000, 30_000_000_000]
    elsewhere = replace(cut[1], track_section="S2")
    other_axle = replace(cut[1], axle=2)
    for second in (elsewhere, other_axle):
        assert [w.length_ns for w in whole_runs([cut[0], second])] == [30_000_000_000] * 2
    assert list(whole_runs([])) == []
