"""What a published number is: a value with its interval, count, status and reason."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.reasons import Reason
from estimation.values.units import NORMAL_95


class Status(StrEnum):
    """What a published number is worth."""

    UNESTIMATED = "unestimated"
    ESTIMATED = "estimated"
    INVALID = "invalid"
    MODEL_MISMATCH = "model_mismatch"  # the data do not follow the equations of the vehicle's class


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its uncertainty; never published without.

    ``value`` and ``std`` are None exactly when ``status`` is not ``estimated``; then ``reason`` gives the cause.
    ``low`` and ``high`` are the ends of the 95 % interval, ``count`` the effective number of windows behind it.
    """

    value: float | None
    std: float | None
    low: float | None
    high: float | None
    count: float
    status: Status
    reason: Reason | None = None

    @staticmethod
    def unknown(reason: Reason, count: float = 0.0, status: Status = Status.UNESTIMATED) -> Estimate:
        """Return the estimate of a number that is not known, with the reason."""
        return Estimate(None, None, None, None, count, status, reason)

    def scaled(self, factor: float) -> Estimate:
        """Return the same in a unit of which ``factor`` make one, which is above 0."""
        value, std, low, high = (None if x is None else x * factor for x in (self.value, self.std, self.low, self.high))
        return Estimate(value, std, low, high, self.count, self.status, self.reason)


@dataclass(frozen=True, slots=True)
class Forecast:
    """Where a limit is reached: quantiles over the trend's uncertainty; None means not within the horizon."""

    p10: float | None
    p50: float | None
    p90: float | None


def leave_one_out(groups: FloatArray, present: BoolArray) -> FloatArray:
    """Return sums (1 + g, ...) of groups (n, ...): over all (row 0), then without each of the g ``present`` ones."""
    total = groups.sum(axis=0)
    return np.concatenate([total[None], total[None] - groups[present]])


def jackknife_std(replicates: FloatArray) -> FloatArray:
    """Return the delete-a-group standard deviation of replicates (1 + g, ...); row 0, of all data, takes no part."""
    g = len(replicates) - 1
    if g < 2:  # noqa: PLR2004 - one group has no spread
        return np.full(replicates.shape[1:], np.nan)
    left_out = replicates[1:]
    spread = ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)
    return np.asarray(np.sqrt((g - 1) / g * spread), dtype=np.float64)


def normal_equivalent(jackknife: FloatArray, groups: int) -> FloatArray:
    """Return the std of a normal distribution with the same 95 % interval as Student's t."""
    if groups < 2:  # noqa: PLR2004 - one group has no spread
        return jackknife
    return np.asarray(jackknife * (_student_95(groups) / NORMAL_95))


def with_interval(
    value: float, sampled: float, systematic: float = 0.0, groups: int | None = None, count: float = 1.0
) -> Estimate:
    """Return a number with its 95 % interval; every published interval is made here.

    Args:
        systematic: Its standard deviation that more data of the same kind do not lessen.
        groups: Groups behind ``sampled``, two or more: Student's t widens its part; None for a normal distribution.
    """
    factor = NORMAL_95 if groups is None else _student_95(groups)
    half = float(np.hypot(factor * sampled, NORMAL_95 * systematic))
    std = float(np.hypot(sampled, systematic))
    return Estimate(float(value), std, float(value) - half, float(value) + half, count, Status.ESTIMATED)


def parts_of(estimate: Estimate, groups: int) -> tuple[float, float]:
    """Return what :func:`with_interval` made an interval from: the sampled and the systematic standard deviation."""
    if estimate.std is None or estimate.low is None or estimate.high is None:
        return float("nan"), float("nan")
    half, student = 0.5 * (estimate.high - estimate.low), _student_95(groups)
    sampled = (half**2 - (NORMAL_95 * estimate.std) ** 2) / (student**2 - NORMAL_95**2)
    within = min(max(sampled, 0.0), estimate.std**2)
    return float(np.sqrt(within)), float(np.sqrt(estimate.std**2 - within))


def _student_95(groups: int) -> float:
    from scipy.special import stdtrit  # noqa: PLC0415 - commands that compute nothing start without it

    return float(stdtrit(groups - 1, 0.975))


def log10_chance(statistic: float, degrees: float) -> float:
    """Return the decimal logarithm of the chance that a chi-square variable exceeds a value; -inf beyond about 1400."""
    with np.errstate(divide="ignore"):
        from scipy.special import chdtrc  # noqa: PLC0415 - the same

        return float(np.log10(chdtrc(degrees, statistic)))


def standardised(estimated: Estimate, measured: Estimate) -> float | None:
    """Return estimate less measurement over the standard deviation of both; None where either is unknown."""
    if None in (estimated.value, estimated.std, measured.value, measured.std):
        return None
    std = math.hypot(estimated.std or 0.0, measured.std or 0.0)
    return ((estimated.value or 0.0) - (measured.value or 0.0)) / std if std > 0.0 else None
