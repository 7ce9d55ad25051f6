"""What a published number is: a value with its interval, count, status and reason."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from estimation.values.reasons import Reason


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


@dataclass(frozen=True, slots=True)
class Forecast:
    """Where a limit is reached: quantiles over the trend's uncertainty; None means not within the horizon."""

    p10: float | None
    p50: float | None
    p90: float | None
