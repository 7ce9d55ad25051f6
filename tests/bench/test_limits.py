"""Alerts at the limit: the bench's wheelsets cover what they say, and the rules judge them as they should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.limits import Worn, judged, limit_at, worn_wheelsets
from bench.worn_family import AMPLITUDES, DISPLACEMENT, amplitude_reached

HIGH = Worn("flat", np.full(len(AMPLITUDES), 0.5), 1.75e-3, 160.0 / 3.6, 3)


def test_wheelsets_are_beyond_or_below_and_cover_less_than_3_mm() -> None:
    worn = worn_wheelsets(4, 20, 5)
    assert len(worn) >= 10
    assert all(1.49e-3 < one.covered < 2.26e-3 and abs(one.above) >= 0.03 for one in worn)


def test_a_steep_curve_holds_a_wheelset_in_the_middle() -> None:
    curves = np.outer([0.1, 0.5], 2.0 * DISPLACEMENT)
    flat, steep = amplitude_reached(curves, np.full(2, 0.7e-3), np.full(2, 0.3), 1)
    assert 0.5e-3 < steep < 0.9 * flat


def test_a_wheelset_far_over_its_limit_is_found_where_it_moves_1_75_mm_and_a_good_one_is_left_alone() -> None:
    over = judged(HIGH)
    assert (over.over, over.measure) == (True, False)
    good = judged(replace(HIGH, conicity=np.full(len(AMPLITUDES), 0.08)))
    assert (good.over, good.measure) == (False, False)
    assert limit_at(HIGH.speed) == 0.534 - 160.0 / 900.0
