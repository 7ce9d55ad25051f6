"""A cubic spline through an alignment, piece by piece: windows of one place share a piece."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray, frozen_array

FEWEST_POINTS = 4  # of a spline
POINTS = 512  # of the alignment between the places at which pieces begin and end
SPLINE_MARGIN = 20  # points beyond the places that are looked up, so that the spline's ends do not matter
PIECES = 32  # that are kept, some 100 kB each


@dataclass(frozen=True, slots=True, eq=False)
class SampledCurve:
    """A curve on a uniform grid; two of them are equal if they are the same object, which makes them keys of caches."""

    s: FloatArray  # (n,) m, increasing
    values: FloatArray  # (n,) NaN where not known


def at_places(curve: SampledCurve, places: FloatArray) -> FloatArray:
    """Return the values (n,) at places (n,); NaN off the curve, and beside a point of it that is not known.

    Parameters
    ----------
    curve
        On a uniform grid.
    places
        (n,) m; NaN where not known.
    """
    found = np.full(len(places), np.nan)
    low, high = extent(places, float(curve.s[0]), float(curve.s[-1]))
    if low > high:
        return found
    first = max(int(np.searchsorted(curve.s, low)) - SPLINE_MARGIN, 0) // POINTS * POINTS
    last = -(-(int(np.searchsorted(curve.s, high)) + SPLINE_MARGIN) // POINTS) * POINTS
    s, coefficients = _piece(curve, first, last)
    if len(coefficients):
        evaluate(frozen_array(places, (len(places),), name="places"), s, coefficients, found)
    return found


@lru_cache(maxsize=PIECES)
def _piece(curve: SampledCurve, first: int, last: int) -> tuple[FloatArray, FloatArray]:
    """Return grid (m,) and coefficients (m - 1, 4) between its points, highest power first, NaN where not known."""
    s, values = curve.s[first:last], curve.values[first:last]
    known = np.flatnonzero(np.isfinite(values))
    coefficients = np.zeros((0, 4))
    if len(known) >= FEWEST_POINTS:
        spline = CubicSpline(s[known], values[known])
        coefficients = np.full((len(s) - 1, 4), np.nan)
        beside = np.flatnonzero(np.diff(known) == 1)
        coefficients[known[beside]] = spline.c[:, beside].T
    return frozen_array(s, (len(s),), name="s"), frozen_array(coefficients, (None, 4), name="coefficients")


@compiled(nogil=True)
def extent(places: FloatArray, first: float, last: float) -> tuple[float, float]:
    """Return the lowest and the highest of the places in ``[first, last]``; the first is larger where there is none.

    Parameters
    ----------
    places
        (n,) m; what is no number is left out.
    first, last
        m, ends of the range.
    """
    low, high = np.inf, -np.inf
    for place in places:
        if first <= place <= last:
            low, high = min(low, place), max(high, place)
    return low, high


@compiled(nogil=True)
def evaluate(places: FloatArray, s: FloatArray, coefficients: FloatArray, found: FloatArray) -> None:
    """Write the spline at places on the grid (m,); a place on a point of it belongs to the interval before.

    Parameters
    ----------
    places
        (n,) m.
    s, coefficients
        (m,) m and (m - 1, 4), of the spline in each interval.
    found
        (n,), written where the place is on the grid.
    """
    last, per_step = len(coefficients) - 1, (len(s) - 1) / (s[-1] - s[0])
    for i in range(len(places)):
        at = places[i]
        if s[0] <= at <= s[-1]:
            j = min(int((at - s[0]) * per_step), last)
            while j > 0 and at <= s[j]:
                j -= 1
            while j < last and at > s[j + 1]:
                j += 1
            t = at - s[j]
            a, b, c, d = coefficients[j]
            found[i] = ((a * t + b) * t + c) * t + d
