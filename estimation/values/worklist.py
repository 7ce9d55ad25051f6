"""What the worklist says of a wheelset: how it is now, how long it lasts, and how urgent that is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from estimation.values.alerts import Condition, Severity
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import MeaningEnum, Reason
from estimation.values.registry import WheelsetRecord
from estimation.values.served import Served


class Urgency(MeaningEnum):
    """How soon somebody has to look at a wheelset, the most urgent first; ``meaning`` is what puts it there."""

    OVER_LIMIT = "The conicity limit is exceeded, or was when that could be assessed last."
    CRITICAL_ALERT = "A critical alert of another kind is open, hunting for one."
    DUE = "The limit may be reached within 30,000 km (p10), or the alert on its forecast is open."
    WARNING_ALERT = "A warning of another kind is open."
    UNKNOWN = "No number of it can be trusted; the reason says why."
    NOT_DUE = "The limit is further away, and no alert is open."
    NOT_MOUNTED = "It runs under no vehicle."

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

    bogie: Annotated[int | None, Served("Number of the bogie, from 1 in the order of the axles.", example=1)] = None
    place: Annotated[BogiePlace | None, Served("Which of the bogie's two, in the order of the axle numbers.")] = None


@dataclass(frozen=True, slots=True)
class OpenAlert:
    """An alert of a wheelset that is not closed."""

    alert_id: Annotated[int, Served("Number of the alert.", "id", example=1)]
    kind: str
    severity: Severity
    condition: Condition
    opened_ns: int
    acknowledged: bool
    shelved_until_ns: Annotated[int | None, Served(name="shelved_until")]


@dataclass(frozen=True, slots=True)
class MileageNow:
    """How far a wheelset has run since it was new, by the last reading that is believed."""

    mileage_km: float
    at_ns: int


@dataclass(frozen=True, slots=True)
class WorklistState:
    """How a wheelset is now."""

    status: Annotated[Status, Served("Of the conicity now.")]
    conicity: Annotated[Estimate, Served("Equivalent conicity at 3 mm of the current profile.", "conicity_1")]
    measured_until_ns: Annotated[int | None, Served("End of the newest data behind the conicity.", "measured_until")]
    slope_per_1000_km: Annotated[Estimate, Served("Of the trend since the last reprofiling.", "slope_1_per_1000_km")]
    limit: Annotated[float | None, Served("Conicity limit that the trend is held against.", "limit_1")]
    probability_over_limit: Annotated[
        float | None, Served("That the limit is exceeded; null means unknown.", "probability_over_limit_1")
    ]
    distance_to_limit_km: Forecast
    since_trend_km: Annotated[float | None, Served("Run since the last point of the trend.")]
    date_of_limit_ns: Forecast  # quantiles of the date
    forecast_reason: Reason | None  # why a quantile is missing; None where none is
    mileage: MileageNow | None
    last_data_ns: Annotated[int | None, Served("End of the newest data that are estimated or wait for it.")]
    alerts: Annotated[tuple[OpenAlert, ...], Served("Open alerts, the worst first.")]
    urgency: Urgency
    reasons: tuple[Reason, ...]  # why, the most important one first


@dataclass(frozen=True, slots=True)
class WorklistRow:
    """One row of the worklist: a wheelset, where it runs, and how it is."""

    wheelset: WheelsetRecord
    vehicle_class: str | None  # of the vehicle that it runs under
    position: AxlePosition | None  # None where it is not mounted
    state: WorklistState
