"""The filters of all particles over the samples of a window, and the products of their innovations, compiled."""

from __future__ import annotations

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import BoolArray, FloatArray, IntArray


@compiled(nogil=True)
def add_innovation_products(
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

    Args:
        transition, by_input, measured, gain: (q, v, n, n), (q, v, 2, n), (q, v, n) and (q, v, n) of the filters.
        source: (v,) which row of the accelerations each variant takes.
        below, above: (k, s) accelerations of the wheelsets and of what is above them, m/s2.
        counted: (s,) samples whose innovations are summed.
        products: (q - 1, v + 1, v + 1) of the innovations of a particle's variants, and of the next particle's first;
            added to.
    """
    q, v, n = measured.shape
    size = q * v
    # filters side by side: every sum of each goes in the order of its terms
    of_states, of_inputs = np.zeros((n, n, size)), np.zeros((2, n, size))
    weights, gains = np.zeros((n, size)), np.zeros((n, size))
    for particle in range(q):
        for variant in range(v):
            one = particle * v + variant
            for k in range(n):
                weights[k, one], gains[k, one] = measured[particle, variant, k], gain[particle, variant, k]
                for row in range(2):
                    of_inputs[row, k, one] = by_input[particle, variant, row, k]
                for j in range(n):
                    of_states[k, j, one] = transition[particle, variant, k, j]
    state, corrected = np.zeros((n, size)), np.zeros((n, size))
    now, then, innovation = np.zeros(size), np.zeros(size), np.zeros(size)
    signals = np.zeros(v + 1)
    for i in range(below.shape[1] - 1):
        for particle in range(q):
            for variant in range(v):
                one, row = particle * v + variant, source[variant]
                now[one], then[one], innovation[one] = below[row, i], below[row, i + 1], above[row, i]
        step(of_states, of_inputs, weights, gains, now, then, innovation, state, corrected)
        if counted[i]:
            add_outer(innovation.reshape(q, v), signals, products)


@compiled(nogil=True)
def step(
    of_states: FloatArray,
    of_inputs: FloatArray,
    weights: FloatArray,
    gains: FloatArray,
    now: FloatArray,
    then: FloatArray,
    innovation: FloatArray,
    state: FloatArray,
    corrected: FloatArray,
) -> None:
    """Take f filters on by a sample.

    Args:
        of_states, of_inputs, weights, gains: (n, n, f), (2, n, f), (n, f) and (n, f): transition, inputs, measurement
            and gain of the filters.
        now, then: (f,) accelerations of the wheelsets at this sample and at the next, m/s2.
        innovation: (f,) accelerations of what is above at this one, m/s2; changed to the innovations.
        state: (n, f) changed.
        corrected: (n, f) work space.
    """
    n, f = state.shape
    for k in range(n):
        for one in range(f):
            innovation[one] -= weights[k, one] * state[k, one]
    for k in range(n):
        for one in range(f):
            corrected[k, one] = state[k, one] + gains[k, one] * innovation[one]
    for k in range(n):
        for one in range(f):
            state[k, one] = of_inputs[0, k, one] * now[one] + of_inputs[1, k, one] * then[one]
        for j in range(n):
            for one in range(f):
                state[k, one] += of_states[k, j, one] * corrected[j, one]


@compiled(nogil=True)
def add_outer(innovations: FloatArray, signals: FloatArray, products: FloatArray) -> None:
    """Add the products of the innovations of a sample to the lower half of every particle's.

    Args:
        innovations: (q, v) of the variants of every particle, m/s2.
        signals: (v + 1,) work space.
        products: (q - 1, v + 1, v + 1) added to.
    """
    q, v = innovations.shape
    for particle in range(q - 1):
        for variant in range(v):
            signals[variant] = innovations[particle, variant]
        signals[v] = innovations[particle + 1, 0]
        for a in range(v + 1):
            for b in range(a + 1):
                products[particle, a, b] += signals[a] * signals[b]
