"""What the worklist says of a wheelset: how it is now, how long it lasts, and how urgent that is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from estimation.values.alerts import Condition, Severity
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason
from estimation.values.registry import WheelsetRecord


class Urgency(StrEnum):
    """How soon somebody has to look at a wheelset, the most urgent first; ``meaning`` is what puts it there."""

    meaning: str

    def __new__(cls, code: str, meaning: str = "") -> Self:
        """Return the member of a code with its meaning."""
        member = str.__new__(cls, code)
        member._value_ = code
        member.meaning = meaning
        return member

    OVER_LIMIT = "over_limit", "The conicity limit is exceeded, or was when that could be assessed last."
    CRITICAL_ALERT = "critical_alert", "A critical alert of another kind is open, hunting for one."
    DUE = "due", "The limit may be reached within 30,000 km (p10), or the alert on its forecast is open."
    WARNING_ALERT = "warning_alert", "A warning of another kind is open."
    UNKNOWN = "unknown", "No number of it can be trusted; the reason says why."
    NOT_DUE = "not_due", "The limit is further away, and no alert is open."
    NOT_MOUNTED = "not_mounted", "It runs under no vehicle."

    @property
    def rank(self) -> int:
        """Place in the order of urgency, from 1."""
        return list(Urgency).index(self) + 1


class BogiePlace(StrEnum):
    """Which of the two wheelsets of a bogie, in the order of the axle numbers."""

    LEADING = "leading"
    TRAILING = "trailing"


@dataclass(frozen=True, slots=True)
class AxlePosition:
    """Where a wheelset is under its vehicle; without bogies, or where the class is not on file, the axle alone."""

    bogie: int | None = None  # from 1, in the order of the axle numbers
    place: BogiePlace | None = None


@dataclass(frozen=True, slots=True)
class OpenAlert:
    """An alert of a wheelset that is not closed."""

    alert_id: int
    kind: str
    severity: Severity
    condition: Condition
    opened_ns: int
    acknowledged: bool
    shelved_until_ns: int | None


@dataclass(frozen=True, slots=True)
class MileageNow:
    """How far a wheelset has run since it was new, by the last reading that is believed."""

    mileage_km: float
    at_ns: int


@dataclass(frozen=True, slots=True)
class WorklistState:
    """How a wheelset is now.

    Attributes:
        status, conicity: Of the conicity at 3 mm of the current profile.
        limit, probability_over_limit: Conicity limit that the trend is held against, and the probability that it is
            exceeded at its last point.
        distance_to_limit_km: Quantiles of the distance still to run from ``mileage``: those of the trend less
            ``since_trend_km``.
        mileage, last_data_ns: Last reading of the mileage, and end of the newest data that are estimated or wait for
            it.
        urgency, reasons: How urgent it is, and why, the most important reason first.
    """

    status: Status
    conicity: Estimate
    measured_until_ns: int | None  # end of the newest data behind it; None where there are none
    slope_per_1000_km: Estimate  # of the trend since the last reprofiling
    limit: float | None
    probability_over_limit: float | None
    distance_to_limit_km: Forecast
    since_trend_km: float | None  # run since the last point of the trend
    date_of_limit_ns: Forecast  # quantiles of the date
    forecast_reason: Reason | None  # why a quantile is missing; None where none is
    mileage: MileageNow | None
    last_data_ns: int | None
    alerts: tuple[OpenAlert, ...]  # open alerts, the worst first
    urgency: Urgency
    reasons: tuple[Reason, ...]


@dataclass(frozen=True, slots=True)
class WorklistRow:
    """One row of the worklist: a wheelset, where it runs, and how it is."""

    wheelset: WheelsetRecord
    vehicle_class: str | None  # of the vehicle that it runs under
    position: AxlePosition | None  # None where it is not mounted
    state: WorklistState
