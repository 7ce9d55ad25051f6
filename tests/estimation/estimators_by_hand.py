"""Filters as plain matrices, slow and short: what the compiled ones must equal."""

from __future__ import annotations

from itertools import product

import numpy as np

from estimation.estimators import filter_kernels as kernels
from estimation.estimators.block_filters import Inputs


def extended_filter(
    inputs: Inputs, noise: float, lever: float, mean: np.ndarray, P: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return mean, covariance and mean squared innovation of psi of an extended Kalman filter with full Jacobians."""
    size, squares = len(mean), []
    for i, dt in enumerate(inputs.step_s):
        if dt == 0.0:
            keep = np.diag([0.0, 0.0, *np.ones(size - 2)])
            mean = np.array([inputs.displacement[i], inputs.yaw[i], *mean[2:]])
            P = keep @ P @ keep + np.diag([kernels.RENEWED[0] ** 2, kernels.RENEWED[1] ** 2, *np.zeros(size - 2)])
            continue
        V = 0.5 * (inputs.speed[i] + inputs.speed[i - 1])
        powers = (1e3 * mean[0]) ** np.arange(size - 2)
        slopes = 1e3 * np.arange(1, size - 2) * powers[:-1]
        turn = np.eye(size)
        turn[1, 0] = -dt * V / lever * (slopes @ mean[3:])
        turn[1, 2:] = -dt * V / lever * powers
        known = 0.5 * dt * (inputs.known_rate[i] + inputs.known_rate[i - 1])
        lateral = 0.5 * (inputs.lateral_rate[i] + inputs.lateral_rate[i - 1])
        mean = mean.copy()
        mean[1] += -dt * V / lever * (powers @ mean[2:]) + known
        mean[0] += dt * (V * mean[1] + lateral)
        run = np.eye(size)
        run[0, 1] = dt * V
        after_turn = turn @ P @ turn.T
        after_turn[1, 1] += kernels.YAW_RATE * dt
        P = run @ after_turn @ run.T
        P[0, 0] += kernels.ALIGNMENT * V * dt
        for part, measured, variance in ((1, inputs.yaw[i], kernels.YAW**2), (0, inputs.displacement[i], noise**2)):
            H = np.eye(size)[part]
            S = float(H @ P @ H) + variance
            if part == 1:
                squares.append((measured - mean[1]) ** 2 / S)
            K = P @ H / S
            mean = mean + K * (measured - mean[part])
            P = (np.eye(size) - np.outer(K, H)) @ P
    return mean, P, float(np.mean(squares))


def smoothed_by_enumeration(likelihood: np.ndarray, prior: np.ndarray, transition: np.ndarray) -> np.ndarray:
    """Return the posterior (k, s) of a Markov chain from the probability of every path."""
    k, size = likelihood.shape
    found = np.zeros((k, size))
    for path in product(range(size), repeat=k):
        p = prior[path[0]] * likelihood[0, path[0]]
        for step in range(1, k):
            p *= transition[path[step - 1], path[step]] * likelihood[step, path[step]]
        for step in range(k):
            found[step, path[step]] += p
    return found / found.sum(axis=1, keepdims=True)
