"""A stationary filter over the samples of a window, and its smoother back, compiled."""

from __future__ import annotations

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import BoolArray, FloatArray, IntArray


@compiled(nogil=True)
def filter_forward(
    transition: FloatArray,
    measured: FloatArray,
    gain: FloatArray,
    measurements: FloatArray,
    known: BoolArray,
    varying: IntArray,
    excess: FloatArray,
    predicted: FloatArray,
    filtered: FloatArray,
    innovations: FloatArray,
) -> None:
    """Write states before (s, n) and after (s, n) each sample, and innovations (s, m); begin at zero.

    Args:
        transition, measured, gain: (n, n), (n, m) and (m, n): columns of the matrices of the filter.
        measurements: (s, m).
        known: (s,) samples that were measured; over the others the state runs on, and the innovation is zero.
        varying: (a,) states by which the last a measurements vary from sample to sample.
        excess: (s,) what is added to their rows there, of a scaled state.
        predicted, filtered, innovations: Written: (s, n), (s, n) and (s, m).
    """
    samples, n = predicted.shape
    first = measurements.shape[1] - len(varying)
    state, correction = np.zeros(n), np.zeros(n)
    for i in range(samples):
        predicted[i] = state
        filtered[i] = state
        innovations[i] = 0.0
        if known[i]:
            add_product(measured, state, innovations[i])
            for j in range(measurements.shape[1]):
                innovations[i, j] = measurements[i, j] - innovations[i, j]
            for a in range(len(varying)):
                innovations[i, first + a] -= excess[i] * state[varying[a]]
            correction[:] = 0.0
            add_product(gain, innovations[i], correction)
            for k in range(n):
                filtered[i, k] += correction[k]
        state[:] = 0.0
        add_product(transition, filtered[i], state)


@compiled(nogil=True)
def add_product(columns: FloatArray, vector: FloatArray, product: FloatArray) -> None:
    """Add the product (n,) of a matrix and a vector (m,); every sum goes in the order of its terms.

    Args:
        columns: (m, n) columns of the matrix: n sums are formed side by side.
        vector: (m,).
        product: (n,) changed.
    """
    for j in range(len(vector)):
        for k in range(len(product)):
            product[k] += columns[j, k] * vector[j]


@compiled(nogil=True)
def smooth_back(back: FloatArray, predicted: FloatArray, filtered: FloatArray) -> None:
    """Change filtered states (s, n) to what all samples together give.

    Args:
        back: (n, n) columns of the matrix of the smoother.
        predicted: (s, n) states before each sample.
        filtered: (s, n) states after each sample; changed.
    """
    samples, n = filtered.shape
    gained = np.zeros(n)
    for i in range(samples - 2, -1, -1):
        for k in range(n):
            gained[k] = filtered[i + 1, k] - predicted[i + 1, k]
        add_product(back, gained, filtered[i])
