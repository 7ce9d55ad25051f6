"""What counts as straight, and what shows that a window is not: just inside of every limit, and just outside."""

from __future__ import annotations

import numpy as np
import pytest
from plain_windows import DT, SPEED, layout, plain_window

from estimation.motion.checks import (
    cant_deficiency_acceleration_range,
    detect_uncompensated_acceleration,
    moving_samples,
    straight,
    straight_part,
    usable_samples,
)
from estimation.motion.integration import SignalParameters
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackLayout
from estimation.values.windows import Window

SIGNALS = SignalParameters()
LIMITS = SIGNALS
N = 1500
EVERY = np.ones(N, dtype=bool)
T = DT * np.arange(N)


def is_straight(distance: float, laid: TrackLayout) -> bool:
    return bool(straight(np.array([distance]), laid, LIMITS)[0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("curvature", "cant"), [(1e-4, 0.0), (0.0, 0.04)])
def test_straight_ends_thirty_metres_from_a_radius_of_twenty_kilometres_or_two_centimetres_of_cant(
    curvature: float, cant: float, sign: float
) -> None:
    """Both are reached at 500 m; the layout is looked at every metre, so that 501 m is the first to be more."""
    rises = layout((0.0, 0.0, 0.0), (1000.0, sign * curvature, sign * cant))
    assert is_straight(470.9, rises)
    assert not is_straight(471.0, rises)
    falls = layout((0.0, sign * curvature, sign * cant), (1000.0, 0.0, 0.0))
    assert is_straight(529.1, falls)
    assert not is_straight(529.0, falls)


def test_a_curve_shorter_than_a_metre_counts() -> None:
    short = layout((0.0, 0.0, 0.0), (500.2, 0.0, 0.0), (500.4, 1e-3, 0.0), (500.6, 0.0, 0.0), (1000.0, 0.0, 0.0))
    assert not is_straight(500.0, short)
    assert is_straight(460.0, short)


def test_only_places_on_the_layout_are_straight() -> None:
    plain = layout((100.0, 0.0, 0.0), (900.0, 0.0, 0.0))
    found = straight(np.array([99.9, 100.0, 500.0, 900.0, 900.1, np.nan]), plain, LIMITS)
    np.testing.assert_array_equal(found, [False, True, True, True, False, False])


def leaning(lateral: FloatArray, mass: FloatArray | None = None) -> Window:
    return plain_window(lateral_acceleration=lateral, mass_lateral_acceleration=lateral if mass is None else mass)


@pytest.mark.parametrize(("change", "refused"), [(0.0999, False), (0.1001, True)])
def test_a_curve_shows_when_the_slow_acceleration_changes_by_a_tenth(change: float, *, refused: bool) -> None:
    window = leaning(np.where(T < 15.0, 3.0, 3.0 + change))
    reason = detect_uncompensated_acceleration(window, EVERY, SIGNALS.max_cant_deficiency_change)
    assert (reason is not None) == refused
    assert reason is None or reason.code is ReasonCode.CURVE_DETECTED
    found = straight_part(window, None, SIGNALS)
    assert isinstance(found, Reason) if refused else found is window


def change_of(window: Window, usable: BoolArray = EVERY) -> float:
    return cant_deficiency_acceleration_range(window, usable)


def test_the_slow_acceleration_is_the_mean_over_five_seconds_of_wheelset_and_mass() -> None:
    second = np.where((T >= 11.0) & (T < 12.0), 1.0, 0.0)
    zero = np.zeros(N)
    assert change_of(leaning(second)) == pytest.approx(1.0 / 5.0)
    assert change_of(leaning(second, zero)) == pytest.approx(0.5 / 5.0)
    assert change_of(leaning(zero, second)) == pytest.approx(0.5 / 5.0)
    assert change_of(leaning(np.where(T >= 25.0, 1.0, zero))) == pytest.approx(1.0)


def test_a_rest_of_less_than_five_seconds_is_no_mean() -> None:
    t = DT * np.arange(N + 200)
    late = np.where(t >= 30.0, 1.0, 0.0)
    window = plain_window(34.0, lateral_acceleration=late, mass_lateral_acceleration=late)
    assert change_of(window, np.ones(N + 200, dtype=bool)) == 0.0


@pytest.mark.parametrize(("missing", "counts"), [(125, True), (126, False)])
def test_a_mean_needs_half_of_its_samples(missing: int, *, counts: bool) -> None:
    """The samples that are missing would deviate by a hundred: they are no part of the mean."""
    lateral = np.where((T >= 10.0) & (T < 15.0), 1.0, 0.0)
    usable = EVERY.copy()
    usable[500 : 500 + missing] = False
    lateral[500 : 500 + missing] = 100.0
    assert change_of(leaning(lateral), usable) == pytest.approx(1.0 if counts else 0.0)
    assert change_of(leaning(lateral), ~EVERY) == 0.0


def test_only_running_and_valid_samples_show_a_curve() -> None:
    change = np.where(T >= 15.0, 1.0, 0.0)
    slow = plain_window(
        lateral_acceleration=change, mass_lateral_acceleration=change, speed=np.where(T >= 15.0, 7.99, 8.0)
    )
    assert straight_part(slow, None, SIGNALS) is slow
    invalid = plain_window(lateral_acceleration=change, mass_lateral_acceleration=change, valid=T < 15.0)
    assert straight_part(invalid, None, SIGNALS) is invalid
    fast = plain_window(
        lateral_acceleration=change, mass_lateral_acceleration=change, speed=np.where(T >= 15.0, 8.0, 8.1)
    )
    assert isinstance(straight_part(fast, None, SIGNALS), Reason)


def test_the_straight_part_of_a_window_is_what_its_layout_leaves_of_it() -> None:
    window = plain_window(valid=T > 1.0)  # it runs from 0 to 600 m
    bent = layout((0.0, 0.0, 0.0), (299.9, 0.0, 0.0), (300.0, 1e-3, 0.0), (1000.0, 1e-3, 0.0))
    found = straight_part(window, bent, SIGNALS)
    assert isinstance(found, Window)
    np.testing.assert_array_equal(found.valid, window.valid & straight(window.distance, bent, LIMITS))
    assert found.valid.mean() == pytest.approx((270.0 - 20.0) / 600.0, abs=0.01)
    everywhere = layout((0.0, 1e-3, 0.0), (1000.0, 1e-3, 0.0))
    refused = straight_part(window, everywhere, SIGNALS)
    assert isinstance(refused, Reason)
    assert refused.code is ReasonCode.IN_CURVES
    nothing = straight_part(plain_window(valid=~EVERY), everywhere, SIGNALS)
    assert isinstance(nothing, Window)  # what is not valid is not lost in a curve


def test_moving_samples_are_valid_placed_and_fast() -> None:
    window = plain_window(
        speed=np.where(T < 10.0, 7.99, np.where(T < 20.0, 8.0, np.nan)),
        valid=T >= 5.0,
        distance=np.where(T < 15.0, SPEED * T, np.nan),
    )
    np.testing.assert_array_equal(moving_samples(window, SIGNALS), (T >= 10.0) & (T < 15.0))
    quick = plain_window(valid=T >= 5.0, distance=np.where(T < 15.0, SPEED * T, np.nan))
    np.testing.assert_array_equal(moving_samples(quick, SIGNALS), (T >= 5.0) & (T < 15.0))


def test_every_lost_sample_is_counted_once_by_its_first_cause() -> None:
    window = plain_window(valid=T >= 3.0, speed=np.where((T >= 9.0) & (T < 18.0), 7.99, 8.0))
    known = T >= 6.0
    bent = layout((0.0, 0.0, 0.0), (509.9, 0.0, 0.0), (510.0, 1e-3, 0.0), (1000.0, 1e-3, 0.0))  # from 480 m, 24 s
    found = usable_samples(window, known, bent, SIGNALS)
    assert list(found.lost) == [
        "missing, clipped or invalid",
        "off the known part of the section",
        "slower than 8 m/s",
        "in curves",
    ]
    assert list(found.lost.values()) == pytest.approx([0.1, 0.1, 0.3, 0.2], abs=0.002)
    left = ((T >= 6.0) & (T < 9.0)) | (T >= 18.0)
    np.testing.assert_array_equal(found.samples, left & straight(window.distance, bent, LIMITS))
    assert found.causes == (
        "30% slower than 8 m/s, 20% in curves, 10% missing, clipped or invalid, 10% off the known part of the section"
    )
    assert not found.samples.flags.writeable


def test_without_a_layout_nothing_is_lost_in_curves_and_causes_without_loss_are_not_named() -> None:
    found = usable_samples(plain_window(), EVERY, None, SIGNALS)
    assert "in curves" not in found.lost
    assert found.samples.all()
    assert found.causes == ""
