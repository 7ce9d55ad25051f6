"""Signals against an uneven distance, smoothed and sampled on an even grid in one pass over them."""

from __future__ import annotations

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray


@compiled(nogil=True)
def sample_smoothed(
    signals: FloatArray, at: FloatArray, first: int, count: int, finer: int, step: float, weights: FloatArray
) -> FloatArray:
    """Return signals (m, count) at every ``finer``-th point of a fine grid, smoothed on that grid.

    Between samples signals are straight, beyond their ends as at these.

    Args:
        signals: (m, n) in any unit.
        at: (n,) m, increasing.
        first, step: Number of the fine grid point of the first result, and spacing of that grid, m.
        weights: (2 r + 1,) of the smoothing, symmetric.
    """
    m, n = signals.shape
    taps = len(weights)
    points = finer * (count - 1) + taps
    found = np.empty((m, count))
    fine = np.empty((m, points))
    below = 0
    for k in range(points):
        x = (first - taps // 2 + k) * step
        while below < n - 2 and at[below + 1] <= x:
            below += 1
        if x <= at[0]:
            fine[:, k] = signals[:, 0]
        elif x >= at[n - 1]:
            fine[:, k] = signals[:, n - 1]
        else:
            share = (x - at[below]) / (at[below + 1] - at[below])
            for a in range(m):
                fine[a, k] = signals[a, below] + share * (signals[a, below + 1] - signals[a, below])
    for a in range(m):
        row = fine[a]
        for j in range(count):
            start = finer * j
            even, odd = 0.0, 0.0  # two sums: each addition need not wait for the one before
            for w in range(0, taps - 1, 2):
                even += weights[w] * row[start + w]
                odd += weights[w + 1] * row[start + w + 1]
            found[a, j] = even + odd + weights[taps - 1] * row[start + taps - 1]
    return found
