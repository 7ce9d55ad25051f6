"""Where along a segment it is known what the gauge does, and at which rolling radius difference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_windows import DT, SPEED, plain_track, plain_window

from estimation.filters import local_cubic_kernel, remove_wander
from estimation.motion.integration import SignalParameters, integrate
from estimation.motion.rolling_radius_difference import fuse, motion_signals
from estimation.motion.window_motion import gauge_shift
from estimation.values.arrays import FloatArray
from estimation.values.track import GaugeShift, TrackAlignment, TrackFindings
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import VehicleParameters

SIGNALS, VEHICLE = SignalParameters(), VehicleParameters()
N = 1500
T = DT * np.arange(N)
WAVE = 5.0  # m: what the yaw sensor measures by itself
STEP, CROSSOVER = 0.25, 15.0  # m, of the fusion of the sensors
ENDS = STEP * (len(local_cubic_kernel(CROSSOVER, STEP)) // 2)  # m that its filter reaches
OMEGA = 2 * np.pi * SPEED / WAVE
YAW = 0.2e-3 * np.sin(OMEGA * T)


def track(per_difference: float = 0.0, per_gauge: float = 0.0, **ratio: float) -> TrackAlignment:
    difference, gauge = np.linspace(-8e-3, 8e-3, 33), np.linspace(-4e-3, 4e-3, 17)
    table = GaugeShift(difference, gauge, per_difference * difference[:, None] + per_gauge * gauge[None, :])
    return plain_track(gauge_deviation=np.full(1001, 1e-3), findings=TrackFindings(ratio, 0.01, {"W1": table}))


def shift(place: TrackAlignment, window: Window | None = None) -> FloatArray:
    found = gauge_shift(window or plain_window(), place, VEHICLE, SIGNALS)
    assert found is not None
    return found


def test_a_shift_is_known_where_the_filters_of_the_segment_see_both_sides() -> None:
    found = shift(track(per_gauge=0.25))
    run = SPEED * T
    last = np.floor(run[-1] / STEP) * STEP
    expected = (run >= ENDS) & (run <= last - ENDS)
    np.testing.assert_array_equal(np.isfinite(found), expected)
    np.testing.assert_allclose(found[expected], 0.25e-3, atol=1e-9)


def test_samples_that_are_not_used_and_segments_too_short_for_the_filters_have_no_shift() -> None:
    valid = np.ones(N, dtype=bool)
    valid[700:703] = False
    found = shift(track(per_gauge=0.25), plain_window(valid=valid))
    assert np.isnan(found[700:703]).all()
    assert np.isfinite(found[[699, 703]]).all()
    slow = plain_window(speed=np.full(N, 8.0) * np.where(T < 15.0, 1.0, 0.99))
    found = shift(track(per_gauge=0.25), slow)
    assert np.isfinite(found[(T > 5.0) & (T < 10.0)]).all()
    assert np.isnan(found[T >= 15.0]).all()
    off = plain_window(distance=SPEED * T + 700.0)  # the section ends at 1000 m, after 15 s
    assert np.isnan(shift(track(per_gauge=0.25), off)[T > 15.0 - ENDS / SPEED + 0.1]).all()


def test_two_segments_each_have_their_own() -> None:
    """One too short for the filters comes first; it keeps nothing from the other."""
    window = plain_window(speed=np.full(N, 8.0), valid=(T < 10.0) | (T > 11.0))
    short = replace(SIGNALS, shortest_segment_s=1.0)
    valid = (T < 1.5) | (T > 2.0)
    found = gauge_shift(replace(window, valid=valid), track(per_gauge=0.25), VEHICLE, short)
    assert found is not None
    assert np.isnan(found[T < 2.0]).all()
    assert np.isfinite(found[(T > 2.0 + ENDS / 8.0 + 0.1) & (T < 28.0)]).any()


def difference_by_yaw(ratio: float = 1.0) -> FloatArray:
    """Return rL - rR by Eq. 2 of a wheelset that only yaws."""
    p = VEHICLE
    per_moment = -p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient)
    rate, acceleration = OMEGA * 0.2e-3 * np.cos(OMEGA * T), -(OMEGA**2) * YAW
    stiffness = p.yaw_inertia * acceleration + p.yaw_stiffness * YAW
    creep = 2 * p.half_contact_distance**2 * p.longitudinal_creep_coefficient / SPEED * rate
    spin = 2 * p.lateral_spin_creep_coefficient * YAW
    return per_moment * (ratio * stiffness + creep + spin)


@pytest.mark.parametrize("ratio", [1.0, 2.0, 4.0])
def test_the_shift_is_that_of_the_radius_difference_with_the_stiffness_of_the_vehicle(ratio: float) -> None:
    window = plain_window(yaw_acceleration=-(OMEGA**2) * YAW)
    found = shift(track(per_difference=0.3, V1=ratio), window)
    expected = 0.3 * difference_by_yaw(ratio)
    inner = slice(400, -400)
    np.testing.assert_allclose(found[inner], expected[inner], atol=0.1 * np.abs(expected).max())
    other = shift(track(per_difference=0.3, V2=ratio), window)
    one = shift(track(per_difference=0.3, V1=1.0), window)
    np.testing.assert_array_equal(other, one)
    more = 0.3 * (difference_by_yaw(ratio) - difference_by_yaw(1.0))
    np.testing.assert_allclose((found - one)[inner], more[inner], atol=0.15 * np.abs(more).max())


def test_the_radius_difference_has_lost_what_is_longer_than_a_hundred_and_twenty_metres() -> None:
    omega = 2 * np.pi * SPEED / 120.0
    yaw = 1e-3 * np.sin(omega * T)
    window = plain_window(
        lateral_acceleration=SPEED * omega * np.cos(omega * T) * 1e-3, yaw_acceleration=-(omega**2) * yaw
    )
    found = shift(track(per_difference=0.3), window)
    (segment,) = integrate(window, window.valid, SIGNALS).segments
    fused = fuse(motion_signals(segment, VEHICLE), VEHICLE)
    certain = (fused.run >= ENDS) & (fused.run <= fused.run[-1] - ENDS)
    (left,) = remove_wander(np.where(certain, fused.difference, 0.0)[None, :], fused.run, certain, 120.0)
    known = np.isfinite(found)
    np.testing.assert_allclose(found[known], 0.3 * np.interp(SPEED * T[known], fused.run, left), atol=1e-7)
    assert found[known].std() > 1e-5


def test_only_wheelsets_that_the_section_knows_have_a_shift() -> None:
    assert gauge_shift(plain_window(), plain_track(), VEHICLE, SIGNALS) is None
    assert gauge_shift(plain_window(wheelset="W2"), track(), VEHICLE, SIGNALS) is None
