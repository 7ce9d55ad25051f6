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
        (q - 1, v + 1, v + 1) of innovations, of their changes, and of the difference to the next particle; added to.
    """
    q, v, n = measured.shape
    state, innovations, signals = np.zeros((q, v, n)), np.zeros((q, v)), np.zeros(v + 1)
    corrected = np.zeros(n)
    for i in range(below.shape[1] - 1):
        for particle in range(q):
            for variant in range(v):
                x, C, K = state[particle, variant], measured[particle, variant], gain[particle, variant]
                F, G = transition[particle, variant], by_input[particle, variant]
                row = source[variant]
                innovation = above[row, i]
                for k in range(n):
                    innovation -= C[k] * x[k]
                innovations[particle, variant] = innovation
                for k in range(n):
                    corrected[k] = x[k] + K[k] * innovation
                for k in range(n):
                    total = G[0, k] * below[row, i] + G[1, k] * below[row, i + 1]
                    for j in range(n):
                        total += F[k, j] * corrected[j]
                    x[k] = total
        if not counted[i]:
            continue
        for particle in range(q - 1):
            own = innovations[particle]
            signals[0] = own[0]
            for variant in range(1, v):
                signals[variant] = own[variant] - own[0]
            signals[v] = innovations[particle + 1, 0] - own[0]
            for a in range(v + 1):
                for b in range(a + 1):
                    products[particle, a, b] += signals[a] * signals[b]
