"""A cubic spline through an alignment, piece by piece: windows of one place share a piece."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray, frozen_array

FEWEST_POINTS = 4  # of a spline
POINTS = 512  # of the alignment in a piece
SPLINE_MARGIN = 20  # points beyond a piece, so that the ends of its spline do not matter
PIECES = 256  # that are kept, 16 kB each


@dataclass(frozen=True, slots=True, eq=False)
class SampledCurve:
    """A curve on a uniform grid; two of them are equal if they are the same object, which makes them keys of caches."""

    s: FloatArray  # (n,) m, increasing
    values: FloatArray  # (n,) NaN where not known


def at_places(curve: SampledCurve, places: FloatArray) -> FloatArray:
    """Return the values (n,) at places (n,); NaN off the curve, and beside a point of it that is not known.

    Args:
        places: (n,) m; NaN where not known.
    """
    found = np.full(len(places), np.nan)
    low, high = extent(places, float(curve.s[0]), float(curve.s[-1]))
    if low > high:
        return found
    last_point = len(curve.s) - 1
    first = min(max(int(np.searchsorted(curve.s, low)) - 1, 0), last_point - 1) // POINTS
    last = max(min(int(np.searchsorted(curve.s, high)), last_point) - 1, 0) // POINTS
    pieces = [_piece(curve, number) for number in range(first, last + 1)]
    coefficients = pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
    s = curve.s[first * POINTS : first * POINTS + len(coefficients) + 1]
    if len(coefficients):
        places, coefficients = (frozen_array(one, one.shape, name="places") for one in (places, coefficients))
        evaluate(places, s, coefficients, found)
    return found


@lru_cache(maxsize=PIECES)
def _piece(curve: SampledCurve, number: int) -> FloatArray:
    """Return the coefficients (m, 4) of the spline between the points of a piece, highest power first.

    NaN where one of both points is not known.
    """
    begin, end = number * POINTS, min((number + 1) * POINTS, len(curve.s) - 1)
    first = max(begin - SPLINE_MARGIN, 0)
    values = curve.values[first : end + 1 + SPLINE_MARGIN]
    known = first + np.flatnonzero(np.isfinite(values))
    coefficients = np.full((max(end - begin, 0), 4), np.nan)
    if len(known) >= FEWEST_POINTS:
        spline = CubicSpline(curve.s[known], curve.values[known])
        beside = np.flatnonzero((np.diff(known) == 1) & (known[:-1] >= begin) & (known[:-1] < end))
        coefficients[known[beside] - begin] = spline.c[:, beside].T
    return frozen_array(coefficients, (None, 4), name="coefficients")


@compiled(nogil=True)
def extent(places: FloatArray, first: float, last: float) -> tuple[float, float]:
    """Return the lowest and the highest of the places in ``[first, last]``; the first is larger where there is none.

    Args:
        places: (n,) m; NaN where not known.
        first, last: Ends, m.
    """
    low, high = np.inf, -np.inf
    for place in places:
        if first <= place <= last:
            low, high = min(low, place), max(high, place)
    return low, high


@compiled(nogil=True)
def evaluate(places: FloatArray, s: FloatArray, coefficients: FloatArray, found: FloatArray) -> None:
    """Write the spline at places on the grid (m,); a place on a point of it belongs to the interval before.

    Args:
        places: (n,) m; NaN where not known.
        s, coefficients: (m,) m, uniform, and (m - 1, 4) between its points.
        found: (n,); what is off the grid stays as it is.
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
