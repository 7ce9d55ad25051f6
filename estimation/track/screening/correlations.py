"""Sums of products of two signals at every lag within a reach: the few that are wanted, without a Fourier transform."""

from __future__ import annotations

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray


@compiled(nogil=True)
def cross_products(first: FloatArray, second: FloatArray, reach: int) -> FloatArray:
    """Return the sums (2 reach + 1, p, q) over i of first(i) second(i + lag), for lags from -reach to reach.

    Args:
        first, second: (p, n) and (q, n) in any unit.
    """
    p, n = first.shape
    q = second.shape[0]
    found = np.zeros((p, q, 2 * reach + 1))
    for a in range(p):
        for b in range(q):
            sums, other = found[a, b], second[b]
            for i in range(n):
                value = first[a, i]
                start = i - reach
                for k in range(max(0, -start), min(2 * reach + 1, n - start)):
                    sums[k] += value * other[start + k]
    return np.ascontiguousarray(found.transpose(2, 0, 1))


@compiled(nogil=True)
def own_products(signals: FloatArray, reach: int) -> FloatArray:
    """Return the sums (m, reach + 1) over i of signal(i) signal(i + lag), for lags from 0 to reach.

    Args:
        signals: (m, n) in any unit.
    """
    m, n = signals.shape
    found = np.zeros((m, reach + 1))
    for a in range(m):
        sums, own = found[a], signals[a]
        for i in range(n):
            value = own[i]
            for k in range(min(reach + 1, n - i)):
                sums[k] += value * own[i + k]
    return found
