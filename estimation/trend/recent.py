"""The wear curve of the newest points: as far back as one curve agrees with the last of them.

A smooth curve through a long life lies below the last points where wear accelerates late: it takes them for outliers,
or cannot bend as fast. Level, slope and forecast are about now. So where the last points together lie off the curve by
more than they scatter, the older half of the points is left out and the curve fitted again, until it agrees with the
last ones or few are left. A single point does not count for more than an outlier may.
"""

from __future__ import annotations

import numpy as np

from estimation.trend.wear_curve import WearCurve, fit_wear_curve
from estimation.values.arrays import FloatArray

TOGETHER = (3, 6, 12)  # last points that are judged together
JUDGED_SHARE = 3  # at most one in so many of the points
FEWEST = 6  # points that are left
DISAGREES = 2.5  # standard deviations of the mean of the last points off the curve
MOST_OFF = 3.0  # scatters that one point counts for
LEAST_SCATTER = 0.1  # of the stated standard deviation
NORMAL_MAD = 1.4826


def fit_recent(x: FloatArray, value: FloatArray, std: FloatArray) -> WearCurve:
    """Fit the curve to the newest points that it agrees with.

    Raises:
        ValueError: As there.
    """
    scatter = _scatter(value, std)
    first = 0
    while True:
        curve = fit_wear_curve(x[first:], value[first:], std[first:])
        left = len(x) - first
        later = first + min(left // 2, left - FEWEST)
        if later <= first or not x[-1] > x[later] or _agrees(curve, x[first:], value[first:], scatter[first:]):
            return curve
        first = later


def _agrees(curve: WearCurve, x: FloatArray, value: FloatArray, scatter: FloatArray) -> bool:
    """Return whether the last points lie about the curve, seen from its level and slope at the last one."""
    level, slope = float(curve.weight @ curve.level), float(curve.weight @ curve.slope)
    off = np.clip((value - level - slope * (x - x[-1])) / scatter, -MOST_OFF, MOST_OFF)
    judged = [count for count in TOGETHER if JUDGED_SHARE * count <= len(x)]
    return all(abs(float(np.mean(off[-count:]))) * np.sqrt(count) <= DISAGREES for count in judged)


def _scatter(value: FloatArray, std: FloatArray) -> FloatArray:
    """Return how far each point (k,) scatters about its neighbours: what all points have in common is not in it."""
    if len(value) < FEWEST:
        return std
    steps = np.diff(value) / np.hypot(std[1:], std[:-1])
    share = NORMAL_MAD * float(np.median(np.abs(steps - np.median(steps))))
    return std * min(1.0, max(LEAST_SCATTER, share))
