"""Least squares with forgetting on sums: what a recursion with the factor W (Eq. 12-13 of the paper) must equal."""

from __future__ import annotations

import numpy as np
from oracles.moments import Moments, collect

from estimation.values.arrays import FloatArray


def one_cell(features: FloatArray, target: FloatArray, forgetting: float) -> Moments:
    """Return the moments of one cell: a sample weighs W^(samples after it)."""
    n = len(target)
    root = np.sqrt(forgetting ** np.arange(n - 1, -1, -1, dtype=np.float64))
    return collect(features * root[:, None], (target * root)[:, None], np.zeros(n, dtype=np.int64), 1)


def merge(first: Moments, second: Moments, forgetting: float) -> Moments:
    """Return the moments of ``first`` followed by ``second``; the weight counts samples."""
    fade = np.power(forgetting, second.weight)
    return Moments(
        first.regressors, first.targets, fade[:, None] * first.packed + second.packed, first.weight + second.weight
    )
