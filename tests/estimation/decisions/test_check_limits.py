"""What a window is refused for on its own: standing, jumps of the position, axes, direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_windows import DT, SPEED, plain_track, plain_window

from estimation.motion.checks import (
    Jump,
    check_axis_signs,
    check_moving,
    direction,
    high_pass_running_mean,
    jumps_reason,
    position_jumps,
    without_jumps,
)
from estimation.motion.integration import IntegratedSegment, IntegratedWindow, SignalParameters, integrate
from estimation.motion.window_motion import to_wheelset_axes
from estimation.values.arrays import FloatArray
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.windows import Window

SIGNALS = SignalParameters()
N = 1500
SECOND = round(1.0 / DT)


def integrated(window: Window) -> IntegratedWindow:
    return integrate(window, np.asarray(window.valid & np.isfinite(window.distance)), SIGNALS)


@pytest.mark.parametrize(("speed", "code"), [(8.0, None), (7.99, ReasonCode.NOT_MOVING)])
def test_a_vehicle_runs_from_eight_metres_per_second(speed: float, code: ReasonCode | None) -> None:
    slow = np.full(N, 1.0)
    slow[700] = speed
    assert code_of(check_moving(plain_window(speed=slow), SIGNALS)) is code


def test_a_vehicle_runs_where_a_single_sample_has_speed_position_and_signals_together() -> None:
    first, second = np.arange(N) < 700, np.arange(N) >= 700
    nowhere = np.where(first, np.nan, 0.0)
    assert code_of(check_moving(plain_window(distance=np.full(N, np.nan)), SIGNALS)) is ReasonCode.POSITION_UNKNOWN
    assert code_of(check_moving(plain_window(valid=first, distance=nowhere), SIGNALS)) is ReasonCode.POSITION_UNKNOWN
    assert check_moving(plain_window(valid=second, distance=nowhere), SIGNALS) is None
    stands = plain_window(speed=np.where(first, SPEED, 0.0), distance=nowhere)
    reason = check_moving(stands, SIGNALS)
    assert reason is not None
    assert reason.code is ReasonCode.NOT_MOVING
    assert "at most 0.0 m/s" in reason.text


def stepped(metres: float, way: int = 1, at: int = 700) -> Window:
    """Return a window whose position jumps by some metres in the sense of running."""
    run = SPEED * DT * np.arange(N) + np.where(np.arange(N) >= at, metres, 0.0)
    return plain_window(distance=500.0 + way * run)


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("metres", "jumps"), [(1.49, 0), (1.51, 1), (-1.49, 0), (-1.51, 1)])
def test_a_jump_is_more_than_half_a_metre_and_a_twentieth_of_a_second_of_running(
    metres: float, jumps: int, way: int
) -> None:
    """At 20 m/s: 0.5 m + 0.05 x 20 m."""
    found = position_jumps(integrated(stepped(metres, way)))
    assert len(found) == jumps
    if jumps:
        assert (found[0].start, found[0].stop) == (699, 700)
        assert found[0].metres == pytest.approx(way * metres)


def test_a_jump_is_looked_for_over_one_second() -> None:
    """A speed that is wrong by 8 % for a second puts the position 1.6 m off, 1.44 m in 0.9 s; 1.5 m are a jump."""
    for seconds, jumps in ((1.0, 1), (0.9, 0)):
        wrong = np.clip(np.arange(N) - 700, 0, round(seconds / DT)) * DT * 0.08 * SPEED
        window = plain_window(distance=SPEED * DT * np.arange(N) + wrong)
        assert len(position_jumps(integrated(window))) == jumps, seconds


def test_a_position_whose_speed_is_wrong_all_along_is_in_doubt_from_end_to_end() -> None:
    (jump,) = position_jumps(integrated(plain_window(distance=1.2 * SPEED * DT * np.arange(N))))
    assert (jump.start, jump.stop) == (0, N - 1)
    assert jump.metres == pytest.approx(0.2 * SPEED * DT * (N - 1))


def test_jumps_keep_their_place_in_the_window_and_their_number() -> None:
    window = stepped(3.0)
    distance = window.distance + np.where(np.arange(N) >= 1100, -4.0, 0.0)
    valid = np.arange(N) >= 100
    found = position_jumps(integrated(replace(window, distance=distance, valid=valid)))
    assert [(jump.start, jump.stop) for jump in found] == [(699, 700), (1099, 1100)]
    reason = jumps_reason(found)
    assert code_of(reason) is ReasonCode.POSITION_JUMP
    assert "2 times" in str(reason)
    assert "4.0 m" in str(reason)
    assert "once" in str(jumps_reason(found[:1]))
    assert jumps_reason(()) is None


@pytest.mark.parametrize(("dt", "margin"), [(DT, 4), (1e-3, 20)])
def test_samples_around_a_jump_are_left_out(dt: float, margin: int) -> None:
    """Two hundredths of a second, and four samples at least: more than the gaps that are bridged."""
    window = replace(plain_window(), sample_interval_s=dt)
    left = without_jumps(window, [Jump(699, 700, 3.0), Jump(1, 2, 3.0)]).valid
    expected = np.ones(N, dtype=bool)
    expected[699 - margin : 700 + margin] = False
    expected[: 2 + margin] = False
    np.testing.assert_array_equal(left, expected)
    assert without_jumps(window, []) is window


def rolling(agreement: float, segments: int = 1) -> IntegratedWindow:
    """Return segments whose lateral velocity and speed times yaw have a correlation of ``agreement``."""
    t = np.arange(N) * DT
    yaw = np.sin(2 * np.pi * 2.0 * t)
    apart = np.cos(2 * np.pi * 2.0 * t)  # uncorrelated with it
    rate = agreement * yaw + np.sqrt(1.0 - agreement**2) * apart
    rows = np.zeros((4, N))
    rates, displacements = rows.copy(), rows.copy()
    rates[0], displacements[1] = rate, yaw / SPEED
    run = SPEED * t
    one = IntegratedSegment(slice(0, N), np.ones(N, dtype=bool), np.full(N, SPEED), run, rows, rates, displacements)
    return IntegratedWindow(plain_window(), (one,) * segments)


@pytest.mark.parametrize("segments", [1, 2])
@pytest.mark.parametrize(
    ("agreement", "code"),
    [
        (1.0, None),
        (0.27, None),
        (0.23, ReasonCode.SENSOR_TURNED),
        (0.0, ReasonCode.SENSOR_TURNED),
        (-0.28, ReasonCode.SENSOR_TURNED),
        (-0.31, ReasonCode.AXES_REVERSED),
        (-1.0, ReasonCode.AXES_REVERSED),
    ],
)
def test_axes_are_unrelated_below_a_quarter_and_reversed_below_minus_three_tenths(
    agreement: float, code: ReasonCode | None, segments: int
) -> None:
    reason = check_axis_signs(rolling(agreement, segments))
    assert code_of(reason) is code
    assert reason is None or f"correlation {agreement:.2f}" in reason.text


def test_vibration_does_not_part_lateral_velocity_and_yaw() -> None:
    """An axle box that vibrates at 30 Hz, with twice the lateral velocity of the motion."""
    (one,) = rolling(1.0).segments
    shaken = one.rates.copy()
    shaken[0] += 2.0 * np.abs(one.rates[0]).max() * np.sin(2 * np.pi * 30.0 * DT * np.arange(N))
    assert check_axis_signs(IntegratedWindow(plain_window(), (replace(one, rates=shaken),))) is None


def test_nothing_is_said_of_the_axes_of_a_wheelset_that_does_not_move() -> None:
    assert check_axis_signs(integrated(plain_window())) is None
    assert check_axis_signs(IntegratedWindow(plain_window(), ())) is None


def test_the_axes_are_judged_by_the_speed_of_each_sample() -> None:
    """Yaw alone is reversed where it is small: with the speed it is not."""
    good, bad = rolling(1.0).segments[0], rolling(-1.0).segments[0]
    slow = replace(bad, speed=0.1 * bad.speed, rates=0.1 * bad.rates)
    assert check_axis_signs(IntegratedWindow(plain_window(), (good, slow))) is None
    wrong = replace(good, speed=0.1 * good.speed, rates=0.1 * good.rates)
    assert code_of(check_axis_signs(IntegratedWindow(plain_window(), (bad, wrong)))) is ReasonCode.AXES_REVERSED


def test_a_short_segment_is_looked_at_from_end_to_end() -> None:
    """Half a second with a jump of 2 m: less than the second over which jumps are looked for."""
    window = stepped(2.0, at=12)
    short = replace(SIGNALS, shortest_segment_s=0.1)
    valid = np.arange(N) < 25
    (jump,) = position_jumps(integrate(window, valid, short))
    assert (jump.start, jump.stop) == (0, 24)
    assert jump.metres == pytest.approx(2.0)


def wandering(hertz: float) -> FloatArray:
    return 100.0 * np.sin(2 * np.pi * hertz * np.arange(N) * DT)


def test_what_wanders_more_slowly_than_seconds_says_nothing_of_the_axes() -> None:
    """A drift a hundred times as large as the motion, over half a minute, and of the opposite sign."""
    one = rolling(1.0).segments[0]
    rates, displacements = one.rates.copy(), one.displacements.copy()
    rates[0] += wandering(1 / 30.0)
    displacements[1] -= wandering(1 / 30.0) / SPEED
    drifting = replace(one, rates=rates, displacements=displacements)
    assert check_axis_signs(IntegratedWindow(plain_window(), (drifting,))) is None


@pytest.mark.parametrize("width", [4, 5])
def test_slow_wandering_is_what_a_mean_over_an_odd_number_of_samples_takes_out_twice(width: int) -> None:
    rest = np.random.default_rng(3).standard_normal(60)
    found = high_pass_running_mean(rest, width)
    for _once in ("first", "second"):
        padded = np.concatenate([np.zeros(2), rest, np.zeros(2)])
        rest = np.array([value - sum(padded[k : k + 5]) / 5.0 for k, value in enumerate(rest)])
    np.testing.assert_allclose(found, rest[width:-width], atol=1e-12)


def zigzag(forward: float) -> Window:
    """Return a window of which a share of the steps leads forward."""
    steps = np.where(np.arange(1000) < round(1000 * forward), 1.0, -1.0)
    return plain_window(20.02, distance=500.0 + np.concatenate([[0.0], np.cumsum(steps)]))


@pytest.mark.parametrize(
    ("forward", "way"), [(1.0, 1), (0.981, 1), (0.979, 0), (0.5, 0), (0.021, 0), (0.019, -1), (0.0, -1)]
)
def test_a_direction_needs_ninety_eight_of_a_hundred_steps(forward: float, way: int) -> None:
    assert direction(zigzag(forward)) == way


def test_steps_of_samples_that_are_not_known_or_do_not_move_do_not_count() -> None:
    back = np.concatenate([np.arange(200.0), np.full(1100, 199.0), 199.0 - np.arange(200.0)])
    assert direction(plain_window(distance=back)) == 0
    assert direction(plain_window(distance=back, valid=np.arange(N) < 1300)) == 1
    assert direction(plain_window(distance=np.where(np.arange(N) < 1300, back, np.nan))) == 1
    assert direction(plain_window(distance=np.where(np.arange(N) < 1200, np.nan, back))) == -1
    assert direction(plain_window(distance=np.full(N, 3.0))) == 1


@pytest.mark.parametrize(
    ("way", "mounted_reversed", "track_sign"), [(1, False, 1), (-1, False, -1), (1, True, -1), (-1, True, 1)]
)
def test_the_axes_of_a_wheelset(way: int, track_sign: int, *, mounted_reversed: bool) -> None:
    window = plain_window(lateral_acceleration=np.sin(np.arange(N)))
    track = plain_track(alignment=np.linspace(0.0, 1e-3, 1001))
    turned, seen = to_wheelset_axes(integrated(window), track, way, mounted_reversed=mounted_reversed)
    sign = -1 if mounted_reversed else 1
    np.testing.assert_array_equal(turned.window.lateral_acceleration, sign * window.lateral_acceleration)
    np.testing.assert_array_equal(seen.alignment, track_sign * track.alignment)
