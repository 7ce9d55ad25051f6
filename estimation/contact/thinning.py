"""Fewer points of a profile that was measured more densely than its curve needs."""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import FloatArray, IntArray

MOST_POINTS = 4000  # one in 0.05 mm of a wheel's arc: the spacing at which smoothed profiles are given


def thinned(points: FloatArray) -> IntArray:
    """Return the indices of at most `MOST_POINTS` points, evenly spaced along the arc; all where there are no more.

    Points are chosen, not averaged: each keeps the noise of the instrument, its place in the file, and whether it is
    an outlier. The arc is that of the running mean of the points, which noise lengthens little.

    Args:
        points: (n, 2) mm, in their order along the curve.
    """
    n = len(points)
    if n <= MOST_POINTS:
        return np.arange(n)
    width = 2 * (n // MOST_POINTS) + 1
    total = np.cumsum(np.pad(points, ((width, width - 1), (0, 0)), mode="edge"), axis=0)
    mean = (total[width:] - total[:-width]) / width
    arc = np.cumsum(np.hypot(*np.diff(mean, axis=0, prepend=mean[:1]).T))[-n:]
    share = (arc - arc[0]) / max(float(arc[-1] - arc[0]), np.finfo(np.float64).tiny)
    cell = np.minimum((share * MOST_POINTS).astype(np.int64), MOST_POINTS - 1)
    return np.unique(cell, return_index=True)[1].astype(np.int64)
