"""From a window to its motion: every number of the signal parameters, and what refuses a window, in its order."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from paper_class import WINDOWS
from plain_windows import DT, GOOD, SPEED, layout, plain_track, plain_window

from estimation.errors import ParameterError
from estimation.motion.integration import SignalParameters, WindowParameters, segments
from estimation.motion.window_motion import NO_ALIGNMENT, motion, window_motion
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction, GaugeShift, TrackAlignment, TrackFindings
from estimation.values.windows import Motion, Window
from estimation.vehicle.vehicle_class import SensorChannel

SIGNALS = SignalParameters()
PARAMETERS = WINDOWS
N = 1500
T = DT * np.arange(N)
WAVE = 10.0  # m


def moved(window: Window, track: TrackAlignment | None = None) -> Motion:
    found = motion(window, track or plain_track(), SIGNALS)
    assert isinstance(found, Motion)
    return found


def missing(*gaps: tuple[int, int]) -> BoolArray:
    valid = np.ones(N, dtype=bool)
    for start, length in gaps:
        valid[start : start + length] = False
    return valid


@pytest.mark.parametrize(("gap", "parts"), [(3, 1), (4, 2)])
def test_three_missing_samples_are_bridged(gap: int, parts: int) -> None:
    assert len(segments(missing((700, gap)), plain_window(), SIGNALS)) == parts


@pytest.mark.parametrize(("length", "parts"), [(500, 1), (499, 0)])
def test_a_segment_lasts_ten_seconds(length: int, parts: int) -> None:
    assert len(segments(np.arange(N) < length, plain_window(), SIGNALS)) == parts


def test_a_second_is_trimmed_at_each_end_and_bridged_samples_are_not_used() -> None:
    valid = missing((700, 3))
    np.testing.assert_array_equal(moved(plain_window(valid=valid)).valid, valid & (T >= 1.0) & (T < 29.0))


def test_a_modelled_gap_costs_half_a_second_on_both_sides() -> None:
    expected = missing((700 - 25, 10 + 50)) & (T >= 1.0) & (T < 29.0)
    np.testing.assert_array_equal(moved(plain_window(valid=missing((700, 10)))).valid, expected)


@pytest.mark.parametrize(("gap", "ends"), [(12, False), (13, True)])
def test_a_gap_of_a_quarter_of_a_second_does_not_end_a_segment(gap: int, *, ends: bool) -> None:
    valid = missing((700, gap))
    assert moved(plain_window(valid=valid)).valid[700 - 40] == (not ends)


@pytest.mark.parametrize(("used", "refused"), [(0.1002, False), (0.0998, True)])
def test_a_tenth_of_the_samples_must_be_left(used: float, *, refused: bool) -> None:
    """Of a window of 100 s; two more seconds are trimmed."""
    seconds = 110.0
    n = round(seconds / DT)
    valid = np.arange(n) < round(used * n) + 100
    found = motion(plain_window(seconds, valid=valid), plain_track(3000.0), SIGNALS)
    assert isinstance(found, Reason) == refused
    assert isinstance(found, Motion) or found.code is ReasonCode.TOO_FEW_USABLE


def test_samples_below_eight_metres_per_second_are_left_out() -> None:
    window = plain_window(speed=np.where(T < 15.0, 7.99, 8.0))
    np.testing.assert_array_equal(moved(window).valid, (T >= 16.0) & (T < 29.0))


def test_blocks_last_twenty_seconds_of_the_clock() -> None:
    found = moved(plain_window(start_ns=30 * 10**9))
    np.testing.assert_array_equal(found.block, np.where(T < 10.0, 1, 2))


def wavy(wavelength: float, amplitude: float = 1e-3) -> tuple[Window, FloatArray]:
    """Return a long window of a lateral displacement with one wavelength, and the displacement."""
    t = DT * np.arange(2 * N)
    omega = 2 * np.pi * SPEED / wavelength
    y = amplitude * np.sin(omega * t)
    return plain_window(60.0, lateral_acceleration=-(omega**2) * y), y


def test_half_is_left_of_a_wavelength_of_forty_metres() -> None:
    for wavelength, left in ((40.0, 0.5), (10.0, 1.0)):
        window, y = wavy(wavelength)
        found = moved(window, plain_track(1300.0))
        inner = slice(750, -750)
        assert found.displacement[inner].std() / y[inner].std() == pytest.approx(left, abs=0.02), wavelength


def test_the_suspension_deflection_is_that_of_the_mass_against_the_wheelset() -> None:
    window, y = wavy(WAVE)
    found = moved(replace(window, mass_lateral_acceleration=3.0 * window.lateral_acceleration), plain_track(1300.0))
    inner = slice(750, -750)
    np.testing.assert_allclose(found.suspension_deflection[inner], 2.0 * y[inner], atol=0.05e-3)
    rate = 2 * np.pi * SPEED / WAVE * 1e-3
    assert found.suspension_deflection_rate[inner].std() == pytest.approx(2.0 * rate / np.sqrt(2.0), rel=0.02)


def test_a_motion_has_the_stiffness_ratio_of_its_vehicle_and_no_speed_where_it_stands() -> None:
    assert moved(plain_window()).band_limited
    for findings, ratio in (
        (None, 1.0),
        (TrackFindings({"V1": 1.3}, 0.0, {}), 1.3),
        (TrackFindings({"V2": 1.3}, 0.0, {}), 1.0),
    ):
        assert moved(plain_window(), plain_track(findings=findings)).stiffness_ratio == ratio
    speed = np.where(T < 5.0, 0.0, np.where(T < 10.0, 3.0, SPEED))
    np.testing.assert_array_equal(moved(plain_window(speed=speed)).speed, np.where(speed > 0.0, speed, np.nan))


@pytest.mark.parametrize(("used", "said"), [(1.0, ""), (0.5, "; lost: 50% missing, clipped or invalid")])
def test_an_interrupted_window_is_refused_with_what_was_lost(used: float, said: str) -> None:
    n = round(9.0 / DT)
    found = motion(plain_window(9.0, valid=np.arange(n) < used * n), plain_track(), SIGNALS)
    assert found == Reason(ReasonCode.INTERRUPTED, f"no uninterrupted run of 10 s{said}")


def test_a_curve_shows_in_a_motion_without_layout_from_a_tenth_on() -> None:
    for change, refused in ((0.0999, False), (0.1001, True)):
        step = np.where(T < 15.0, 0.0, change)
        found = motion(plain_window(lateral_acceleration=step, mass_lateral_acceleration=step), plain_track(), SIGNALS)
        assert isinstance(found, Reason) == refused


@pytest.mark.parametrize("name", [item.name for item in fields(SignalParameters)])
def test_no_parameter_may_be_negative_and_only_the_cut_off_must_be_positive(name: str) -> None:
    with pytest.raises(ParameterError) as negative:
        SignalParameters(**{name: -1})
    assert negative.value.field == name
    if name == "cutoff_wavelength":
        with pytest.raises(ParameterError):
            SignalParameters(**{name: 0.0})
    else:
        assert getattr(SignalParameters(**{name: 0}), name) == 0


def test_the_source_of_a_table_names_every_parameter() -> None:
    for item in fields(SignalParameters):
        assert f" {item.name}={getattr(SIGNALS, item.name)}" in SIGNALS.source
    assert SIGNALS.source.startswith("band-limited ")


def running(psi_sign: float = 1.0) -> Window:
    """Return a window of a wheelset that rolls where it points: y' = V psi."""
    omega = 2 * np.pi * SPEED / WAVE
    y = 1e-3 * np.sin(omega * T)
    yaw = 1e-3 * omega * np.cos(omega * T) / SPEED
    return plain_window(lateral_acceleration=-(omega**2) * y, yaw_acceleration=-psi_sign * omega**2 * yaw)


def refusal(window: Window, track: TrackAlignment | None = None, misplaced: Reason | None = None) -> Reason:
    found = window_motion(window, track, PARAMETERS, misplaced=misplaced)
    assert isinstance(found, Reason)
    return found


MISPLACED = Reason(ReasonCode.POSITION_UNCERTAIN, "somewhere else")


def test_what_refuses_a_window_in_its_order() -> None:
    """From the worst window on every cure brings up the next reason."""
    back = np.concatenate([20.0 * T[:750], 20.0 * T[749::-1]])
    jumps = SPEED * T + np.where(T > 15.0, 5.0, 0.0)
    worst = replace(running(-1.0), quality=replace(GOOD, coverage=0.0), speed=np.zeros(N), distance=back)
    unknown, track = plain_track(alignment=np.full(1001, np.nan)), plain_track()
    assert refusal(worst, track, MISPLACED).code is ReasonCode.TOO_FEW_SAMPLES
    stands = replace(worst, quality=GOOD)
    assert refusal(stands, None, MISPLACED) == NO_ALIGNMENT
    assert refusal(stands, unknown, MISPLACED) == NO_ALIGNMENT
    assert refusal(stands, track, MISPLACED) == MISPLACED
    assert refusal(stands, track).code is ReasonCode.NOT_MOVING
    runs = replace(stands, speed=np.full(N, SPEED))
    assert refusal(runs, track).code is ReasonCode.BOTH_DIRECTIONS
    forward = replace(runs, distance=jumps)
    assert refusal(forward, track).code is ReasonCode.POSITION_JUMP
    placed = replace(forward, distance=SPEED * T)
    assert refusal(placed, track).code is ReasonCode.AXES_REVERSED
    assert isinstance(window_motion(running(), track, PARAMETERS), Motion)
    partly = plain_track(alignment=np.where(np.arange(1001) < 500, 0.0, np.nan))
    assert isinstance(window_motion(running(), partly, PARAMETERS), Motion)


def wavy_track(**changes: object) -> TrackAlignment:
    s = np.arange(1001.0)
    return plain_track(alignment=1e-3 * np.sin(2 * np.pi * s / WAVE), **changes)


INNER = slice(250, -250)


@pytest.mark.parametrize(("way", "mounted_reversed"), [(1, False), (1, True), (-1, False), (-1, True)])
def test_the_track_is_seen_from_the_wheelset(way: int, *, mounted_reversed: bool) -> None:
    """A wheelset at rest on a track that waves: y - d is the wave, with the sign of its own left side."""
    distance = SPEED * T if way > 0 else 600.0 - SPEED * T
    found = window_motion(plain_window(distance=distance), wavy_track(), PARAMETERS, mounted_reversed=mounted_reversed)
    assert isinstance(found, Motion)
    sign = way * (-1 if mounted_reversed else 1)
    expected = -sign * 1e-3 * np.sin(2 * np.pi * distance / WAVE)
    np.testing.assert_allclose(found.displacement[INNER], expected[INNER], atol=0.02e-3)


def test_a_mirrored_wheelset_moves_the_other_way() -> None:
    plain, mirrored = (
        window_motion(running(), plain_track(), PARAMETERS, mounted_reversed=reverse) for reverse in (False, True)
    )
    assert isinstance(plain, Motion)
    assert isinstance(mirrored, Motion)
    assert plain.displacement[INNER].std() > 0.5e-3
    for name in ("displacement", "yaw", "lateral_velocity"):
        np.testing.assert_array_equal(getattr(mirrored, name), -getattr(plain, name))


def test_a_corrected_position_is_where_the_alignment_is_looked_up() -> None:
    found = window_motion(plain_window(), wavy_track(), PARAMETERS, Correction(offset=WAVE / 4))
    assert isinstance(found, Motion)
    expected = -1e-3 * np.cos(2 * np.pi * SPEED * T / WAVE)
    np.testing.assert_allclose(found.displacement[INNER], expected[INNER], atol=0.02e-3)


def test_a_layout_leaves_out_its_curves() -> None:
    bent = layout((0.0, 0.0, 0.0), (429.9, 0.0, 0.0), (430.0, 1e-3, 0.0), (1000.0, 1e-3, 0.0))
    found = window_motion(plain_window(), plain_track(), PARAMETERS, layout=bent)
    assert isinstance(found, Motion)
    np.testing.assert_array_equal(found.valid, (T >= 1.0) & (T < 19.0 - 1e-9))


PER_GAUGE = 0.25


def gauge_track(per_difference: float = 0.0, ratio: float = 1.0) -> TrackAlignment:
    difference, gauge = np.linspace(-8e-3, 8e-3, 33), np.linspace(-4e-3, 4e-3, 17)
    table = GaugeShift(difference, gauge, per_difference * difference[:, None] + PER_GAUGE * gauge[None, :])
    return plain_track(
        gauge_deviation=2e-3 * np.sin(2 * np.pi * np.arange(1001.0) / WAVE),
        findings=TrackFindings({"V1": ratio}, 0.01, {"W1": table}),
    )


def test_what_the_gauge_does_to_a_wheelset_is_part_of_the_track() -> None:
    found = window_motion(plain_window(), gauge_track(), PARAMETERS)
    assert isinstance(found, Motion)
    inner = slice(350, -350)
    expected = -PER_GAUGE * 2e-3 * np.sin(2 * np.pi * SPEED * T / WAVE)
    np.testing.assert_allclose(found.displacement[inner], expected[inner], atol=0.03e-3)  # e is linear over a metre


def noise_at(
    speed: FloatArray, cutoff: float = SIGNALS.cutoff_wavelength, track: TrackAlignment | None = None
) -> float:
    """Return the std, m, of the displacement by a noisy lateral sensor in a window of these speeds."""
    sensors = replace(PARAMETERS.vehicle_class.sensors, lateral=SensorChannel(noise_density=1e-3))
    noisy = WindowParameters(
        replace(PARAMETERS.vehicle_class, sensors=sensors), replace(SIGNALS, cutoff_wavelength=cutoff)
    )
    window = plain_window(speed=speed, distance=DT * np.cumsum(speed))
    found = window_motion(window, track or plain_track(), noisy)
    assert isinstance(found, Motion)
    return float(np.sqrt(found.displacement_noise))


def test_a_motion_knows_how_far_the_sensors_are_off_at_its_speed_and_cut_off() -> None:
    slow, fast = np.full(N, 10.0), np.full(N, 20.0)
    usual = noise_at(fast)
    assert usual == pytest.approx(0.0414e-3, rel=0.01)
    assert noise_at(slow) == pytest.approx(2.0**1.5 * usual)
    assert noise_at(fast, cutoff=30.0) == pytest.approx(0.75**1.5 * usual)
    assert noise_at(fast, track=plain_track(cutoff_wavelength=30.0)) == pytest.approx(0.75**1.5 * usual)


def test_the_noise_of_a_window_is_the_mean_over_its_samples_and_not_that_at_its_mean_speed() -> None:
    speed = np.where(np.arange(N) < N / 2, 10.0, 20.0)
    assert noise_at(speed) ** 2 == pytest.approx(4.5 * noise_at(np.full(N, 20.0)) ** 2, rel=0.01)
    stood = np.where(np.arange(N) > 0.8 * N, 2.0, 20.0)  # too slow to count
    assert noise_at(stood) == pytest.approx(noise_at(np.full(N, 20.0)))
