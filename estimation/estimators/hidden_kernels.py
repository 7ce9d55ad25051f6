"""Compiled steps of the estimator with a hidden slow displacement: forward-backward smoothing on a grid.

Each run of samples is cut into chunks over which the hidden displacement is constant. From chunk to chunk it stays or
moves to a neighbouring value, so that it is distributed as its prior in the long run.
"""

from __future__ import annotations

import math

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray

FREEDOM = 6.0  # of Student's t, of the difference between R and the curve
LIKELY = 1e-3  # probability below which a value of the grid is left out of the sums


@compiled(nogil=True, error_model="numpy")
def weigh(
    displacement: FloatArray, difference: FloatArray, chunk: int, curve: FloatArray, first: float, width: float,
    grid: FloatArray, noise: float, share: float, likelihood: FloatArray,
) -> float:  # fmt: skip
    """Write the likelihood (k, s) of each value of the grid in each chunk, at most 1; return the logarithm left out.

    Args:
        displacement, difference: (n,) m, of a run; k chunks of it count.
        curve, first, width: (b,) m, R at the middles of cells, the lower edge of the first one and the width of all, m.
        grid: (s,) m, values of the hidden displacement.
        noise, share: Std of R, m, and how much one sample counts: neighbours have errors in common.
    """
    left_out = 0.0
    for k in range(len(likelihood)):
        most = -math.inf
        for s in range(len(grid)):
            total = 1.0  # product over the chunk: one logarithm for all
            for i in range(k * chunk, (k + 1) * chunk):
                place = (displacement[i] + grid[s] - first) / width - 0.5
                low = min(max(math.floor(place), 0), len(curve) - 2)
                part = min(max(place - low, 0.0), 1.0)
                apart = (difference[i] - curve[low] - part * (curve[low + 1] - curve[low])) / noise
                total *= 1.0 + apart * apart / FREEDOM
            likelihood[k, s] = -0.5 * share * (FREEDOM + 1.0) * math.log(total)
            most = max(most, likelihood[k, s])
        left_out += most
        for s in range(len(grid)):
            likelihood[k, s] = math.exp(likelihood[k, s] - most)
    return left_out


@compiled(nogil=True, error_model="numpy")
def smooth(likelihood: FloatArray, prior: FloatArray, move: float, posterior: FloatArray) -> float:
    """Write the probability (k, s) of each value in each chunk, given all chunks; return the logarithm of the evidence.

    Args:
        likelihood: (k, s) from :func:`weigh`.
        prior: (s,) probability of each value before any sample.
        move: Probability of a step to either neighbour that is as probable.
    """
    up, down = steps(prior, move)
    size = len(prior)
    evidence = 0.0
    state, following = prior.copy(), np.empty(size)
    for k in range(len(likelihood)):
        if k > 0:
            for s in range(size):
                following[s] = state[s] * (1.0 - up[s] - down[s])
                if s > 0:
                    following[s] += state[s - 1] * up[s - 1]
                if s + 1 < size:
                    following[s] += state[s + 1] * down[s + 1]
            state[:] = following
        state *= likelihood[k]
        total = state.sum()
        state /= total
        evidence += math.log(total)
        posterior[k] = state
    behind, ahead = np.ones(size), np.empty(size)
    for k in range(len(likelihood) - 2, -1, -1):
        behind *= likelihood[k + 1]
        for s in range(size):
            ahead[s] = behind[s] * (1.0 - up[s] - down[s])
            if s + 1 < size:
                ahead[s] += behind[s + 1] * up[s]
            if s > 0:
                ahead[s] += behind[s - 1] * down[s]
        behind[:] = ahead / ahead.sum()
        posterior[k] *= behind
        posterior[k] /= posterior[k].sum()
    return evidence


@compiled(nogil=True, error_model="numpy")
def steps(prior: FloatArray, move: float) -> tuple[FloatArray, FloatArray]:
    """Return the probabilities (s,) of a step up and of one down that keep the prior as it is."""
    up, down = np.zeros(len(prior)), np.zeros(len(prior))
    for s in range(len(prior) - 1):
        up[s] = move * min(1.0, prior[s + 1] / prior[s])
        down[s + 1] = move * min(1.0, prior[s] / prior[s + 1])
    return up, down


@compiled(nogil=True, error_model="numpy")
def add_expected(
    displacement: FloatArray, difference: FloatArray, chunk: int, posterior: FloatArray, grid: FloatArray,
    first: float, width: float, weight: float, sums: FloatArray, counts: FloatArray,
) -> None:  # fmt: skip
    """Add R and the number of samples to the cells in which they are expected.

    Args:
        posterior: (k, s) from :func:`smooth`.
        weight: Of every sample.
        sums, counts: (b,) m and number, added to.
    """
    for k in range(len(posterior)):
        for s in range(len(grid)):
            probability = posterior[k, s]
            if probability > LIKELY:
                for i in range(k * chunk, (k + 1) * chunk):
                    cell = math.floor((displacement[i] + grid[s] - first) / width)
                    if 0 <= cell < len(sums):
                        sums[cell] += weight * probability * difference[i]
                        counts[cell] += weight * probability
