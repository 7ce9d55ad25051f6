"""Samples on rails of low friction are left out, and a window says so where too few are left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from bogie_run import SOFT, windows

from estimation.adhesion.friction import touched
from estimation.motion.checks import away_from_low_adhesion, refused_for_low_adhesion
from estimation.motion.parameters import MOTION
from estimation.values.opinions import FrictionSums, WindowAdhesion
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.sums import INVERSE
from estimation.values.track import Correction
from estimation.values.windows import Window


def kept(window: Window | Reason) -> Window:
    assert isinstance(window, Window)
    return window


def test_samples_within_a_stretch_and_its_margin_are_left_out() -> None:
    window = windows(SOFT, 1)[0]
    middle = float(window.distance[7000])
    left = kept(away_from_low_adhesion(window, [(middle, middle + 100.0)])).valid
    expected = (window.distance < middle - MOTION.low_friction_margin) | (
        window.distance > middle + 100.0 + MOTION.low_friction_margin
    )
    np.testing.assert_array_equal(left, window.valid & expected)
    assert away_from_low_adhesion(window, ()) is window


def test_the_true_positions_decide() -> None:
    window = windows(SOFT, 1)[0]
    middle = float(window.distance[7000])
    moved = kept(away_from_low_adhesion(window, [(middle, middle + 100.0)], Correction(30.0, 0.0, 0.0)))
    shifted = replace(window, distance=window.distance + 30.0)
    np.testing.assert_array_equal(moved.valid, kept(away_from_low_adhesion(shifted, [(middle, middle + 100.0)])).valid)
    np.testing.assert_array_equal(moved.distance, window.distance)


def test_a_window_on_low_friction_all_over_is_refused() -> None:
    window = windows(SOFT, 1)[0]
    found = away_from_low_adhesion(window, [(-1e4, 1e4)])
    assert isinstance(found, Reason)
    assert found.code is ReasonCode.LOW_ADHESION


def test_too_little_that_is_left_is_called_low_adhesion_where_that_took_a_quarter() -> None:
    window = windows(SOFT, 1)[0]
    few, other = Reason(ReasonCode.INTERRUPTED, "short"), Reason(ReasonCode.CURVE_DETECTED, "curve")
    half, most = window.valid.copy(), window.valid.copy()
    half[: int(0.26 * len(half))] = False
    most[: int(0.24 * len(most))] = False
    assert refused_for_low_adhesion(few, window, replace(window, valid=half)).code is ReasonCode.LOW_ADHESION
    assert refused_for_low_adhesion(few, window, replace(window, valid=most)) is few
    assert refused_for_low_adhesion(other, window, replace(window, valid=half)) is other


def test_stretches_that_a_window_was_on() -> None:
    none = Estimate.unknown(Reason(ReasonCode.NOT_FINITE, ""))
    sums = FrictionSums(np.array([4, 5, 6]), np.ones(3), np.zeros((3, 6)), np.zeros((3, 4, len(INVERSE))))
    one = WindowAdhesion("W", 0, "V", "S", "", Status.ESTIMATED, none, none, none, none, sums)
    stretches = [(0.0, 100.0), (180.0, 210.0), (360.0, 500.0), (400.0, 500.0)]
    assert touched(one, stretches) == ((180.0, 210.0), (360.0, 500.0))
    assert touched(replace(one, sums=None), stretches) == ()
