"""Standard deviations and intervals from groups of blocks of data."""

from __future__ import annotations

import numpy as np
from scipy import stats

from estimation.values.arrays import FloatArray
from estimation.values.quantities import Estimate, Status


def jackknife_std(replicates: FloatArray) -> FloatArray:
    """Return the delete-a-group standard deviation along axis 0.

    Parameters
    ----------
    replicates
        (1 + g, ...) the number from all data (row 0, takes no part), then with each of the g groups left out.
    """
    g = len(replicates) - 1
    if g < 2:  # noqa: PLR2004 - one group has no spread
        return np.full(replicates.shape[1:], np.nan)
    left_out = replicates[1:]
    spread = ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)
    return np.asarray(np.sqrt((g - 1) / g * spread), dtype=np.float64)


def normal_equivalent(jackknife: FloatArray, groups: int) -> FloatArray:
    """Return the std of a normal distribution with the same 95 % interval as Student's t for ``groups`` groups."""
    if groups < 2:  # noqa: PLR2004 - one group has no spread
        return jackknife
    return np.asarray(jackknife * (stats.t.ppf(0.975, groups - 1) / stats.norm.ppf(0.975)))


def with_interval(value: float, jackknife: float, systematic: float, groups: int, count: float) -> Estimate:
    """Return the estimate with its 95 % interval: Student's t for the g groups, normal for what is systematic."""
    student = float(stats.t.ppf(0.975, groups - 1)) * jackknife
    normal = float(stats.norm.ppf(0.975)) * systematic
    half = float(np.hypot(student, normal))
    std = float(np.hypot(jackknife, systematic))
    return Estimate(float(value), std, float(value) - half, float(value) + half, count, Status.ESTIMATED)
