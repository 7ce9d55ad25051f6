"""At which amplitude a step is looked for: one that the very newest intervals cover, never one that is extrapolated."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.trend.trend import TrendParameters, newest_step
from estimation.values.geometry import IntervalConicities, KnownConicity
from estimation.values.units import DAY_NS

KM = 33_000.0


def interval(number: int, conicity: float, largest_mm: float) -> IntervalConicities:
    """Return an interval whose conicity falls with the amplitude, known up to the largest one (mm)."""
    rng = np.random.default_rng(number)
    amplitudes = np.arange(2.0, largest_mm + 0.1, 0.25)
    known = tuple(
        KnownConicity(1e-3 * a, conicity - 0.04 * (a - 2.0) + 0.001 * float(rng.standard_normal()), 0.04, 0.001)
        for a in amplitudes
    )
    start = round(number * 80 * DAY_NS)
    return IntervalConicities(
        0, number, KM * number, start, start + round(DAY_NS), 3, f"digest {number}", "9", known, None
    )


def life(fall: float, largest_mm: list[float]) -> list[IntervalConicities]:
    """Return ten intervals of a wheelset that wears, and falls before the seventh."""
    return [interval(n, 0.27 + 0.014 * n - (fall if n >= 6 else 0.0), mm) for n, mm in enumerate(largest_mm)]


def test_a_step_does_not_wait_until_the_newest_intervals_cover_what_they_did() -> None:
    found = newest_step(life(0.13, [3.0] * 8 + [2.5, 2.25]), TrendParameters())
    assert found is not None
    assert found.amplitude == pytest.approx(2.25e-3)
    assert (found.before, found.behind) == (6, 4)
    assert found.size.value == pytest.approx(-0.13, abs=0.02)


def test_the_largest_amplitude_is_taken_where_all_cover_it_and_none_beyond_the_limits_own() -> None:
    found = newest_step(life(0.13, [3.5] * 10), TrendParameters())
    assert found is not None
    assert found.amplitude == pytest.approx(3e-3)


def test_nothing_is_found_where_nothing_fell_or_no_amplitude_is_common() -> None:
    assert newest_step(life(0.0, [3.0] * 8 + [2.5, 2.25]), TrendParameters()) is None
    assert newest_step([interval(n, 0.3, 1.5) for n in range(10)], TrendParameters()) is None
