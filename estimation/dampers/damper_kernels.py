"""The filters of all particles over the samples of a window, and the products of their innovations, compiled."""

from __future__ import annotations

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import BoolArray, FloatArray, IntArray


@compiled(nogil=True)
def add_products(
    transition: FloatArray,
    by_input: FloatArray,
    measured: FloatArray,
    gain: FloatArray,
    source: IntArray,
    below: FloatArray,
    above: FloatArray,
    counted: BoolArray,
    products: FloatArray,
) -> None:
    """Add the products of the innovations over a segment, its filters beginning at zero.

    Parameters
    ----------
    transition, by_input, measured, gain
        (q, v, n, n), (q, v, 2, n), (q, v, n) and (q, v, n) of the filters.
    source
        (v,) which row of the accelerations each variant takes.
    below, above
        (k, s) accelerations of the wheelsets and of what is above them, m/s2.
    counted
        (s,) samples whose innovations are summed.
    products
        (q - 1, v + 1, v + 1) of the innovations of a particle's variants, and of the next particle's first; added to.
    """
    q, v, n = measured.shape
    state, innovations, signals, corrected = np.zeros((q, v, n)), np.zeros((q, v)), np.zeros(v + 1), np.zeros(n)
    for i in range(below.shape[1] - 1):
        for particle in range(q):
            for variant in range(v):
                row = source[variant]
                innovations[particle, variant] = step(
                    transition[particle, variant],
                    by_input[particle, variant],
                    measured[particle, variant],
                    gain[particle, variant],
                    below[row, i],
                    below[row, i + 1],
                    above[row, i],
                    state[particle, variant],
                    corrected,
                )
        if counted[i]:
            add_outer(innovations, signals, products)


@compiled(nogil=True)
def step(
    transition: FloatArray,
    by_input: FloatArray,
    measured: FloatArray,
    gain: FloatArray,
    now: float,
    then: float,
    above: float,
    state: FloatArray,
    corrected: FloatArray,
) -> float:
    """Take a filter on by a sample; return its innovation.

    Parameters
    ----------
    transition, by_input, measured, gain
        (n, n), (2, n), (n,) and (n,) of the filter.
    now, then, above
        Accelerations of the wheelsets at this sample and at the next, and of what is above at this one, m/s2.
    state
        (n,) changed.
    corrected
        (n,) work space.
    """
    n = len(state)
    innovation = above
    for k in range(n):
        innovation -= measured[k] * state[k]
    for k in range(n):
        corrected[k] = state[k] + gain[k] * innovation
    for k in range(n):
        total = by_input[0, k] * now + by_input[1, k] * then
        for j in range(n):
            total += transition[k, j] * corrected[j]
        state[k] = total
    return innovation


@compiled(nogil=True)
def add_outer(innovations: FloatArray, signals: FloatArray, products: FloatArray) -> None:
    """Add the products of the innovations of a sample to the lower half of every particle's.

    Parameters
    ----------
    innovations
        (q, v) of the variants of every particle, m/s2.
    signals
        (v + 1,) work space.
    products
        (q - 1, v + 1, v + 1) added to.
    """
    q, v = innovations.shape
    for particle in range(q - 1):
        for variant in range(v):
            signals[variant] = innovations[particle, variant]
        signals[v] = innovations[particle + 1, 0]
        for a in range(v + 1):
            for b in range(a + 1):
                products[particle, a, b] += signals[a] * signals[b]
