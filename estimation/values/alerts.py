"""Alerts and the worklist: what a rule finds, what an alert is, and how urgent a wheelset is.

Identity of an open alert is (fleet, wheelset serial, kind); that of a fleet alert, which stands for many of them, is
(fleet, kind), that of one about a track section (fleet, section, kind).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum, StrEnum
from typing import Annotated

from estimation.values.fields import JsonValue, Served
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import MeaningEnum, Reason, ReasonCode, code_of, text_of
from estimation.values.registry import WheelsetRecord
from estimation.values.units import SECOND_NS


class AlertScope(StrEnum):
    """What an alert is about."""

    WHEELSET = "wheelset"
    FLEET = "fleet"
    TRACK_SECTION = "track_section"


class Severity(StrEnum):
    """How urgent, the least first."""

    INFO = "info"
    WARNING = "warning"
    CRITICAL = "critical"


class Condition(StrEnum):
    """What is true of the wheelset now, whatever people did about it."""

    PENDING = "pending"  # seen, on-delay not over
    ACTIVE = "active"
    CLEARED = "cleared"
    UNKNOWN = "unknown"  # no longer assessable; never to be read as healthy


class CloseReason(MeaningEnum):
    """Why an alert was closed; ``sentence`` is what people read."""

    CLEARED = "cleared"
    NOT_CONFIRMED = "not confirmed within the on-delay"
    MEMBERS_CLOSED = "all members closed"
    REPROFILED = "reprofiled"
    OUT_OF_SERVICE = "taken out of service"
    WHEELSET_EXCHANGED = "wheelset exchanged"
    SENSOR_CHANGED = "sensor exchanged or calibrated"
    MOUNTING_CORRECTED = "mounting corrected"
    RULE_DISABLED = "rule switched off"

    @property
    def sentence(self) -> str:
        """What people read."""
        return self.meaning


class AlertEventKind(StrEnum):
    """What happened to an alert: the kinds of entries of the feed."""

    RAISED = "raised"
    UPDATED = "updated"
    ACKNOWLEDGED = "acknowledged"
    SHELVED = "shelved"
    UNSHELVED = "unshelved"
    CLEARED = "cleared"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """The result of one rule for one wheelset at one time; ``breached`` is None where the data do not decide.

    ``stands`` is whether an alert stands by all data in vehicle time; where None, evaluations are counted. ``since_ns``
    is when it was raised by them. ``mileage_km`` is that of the data, for delays in kilometres.
    """

    wheelset: str
    kind: str  # of the rule
    breached: bool | None
    cleared: bool | None  # beyond the clear limit (apart from the raise limit)
    severity: Severity = Severity.WARNING
    probability: float | None = None
    evidence: Mapping[str, JsonValue]  # numbers, intervals, windows, limits
    action: str  # suggested action code
    raise_limit: float | None = None
    clear_limit: float | None = None
    measured_ns: int
    stands: bool | None = None
    since_ns: int | None = None
    mileage_km: float | None = None


@dataclass(frozen=True, slots=True)
class Alert:
    """One alert; ``alert_id`` 0 until stored. ``version`` counts changes (its ETag).

    ``wheelset`` is None for an alert of a fleet or a section. ``fleet_alert_id`` names the fleet alert that this one is
    a member of, which it stays for good. ``rules_version`` names the rules that it was raised with; None where none was
    kept.
    """

    alert_id: Annotated[int, Served(name="id", example=17)]
    fleet: Annotated[str, Served(example="demo")]
    wheelset: Annotated[str | None, Served("Null for an alert of a fleet or a section.", example="WS-0001")]
    kind: str  # of the rule behind it
    severity: Severity
    condition: Condition
    opened_ns: int
    last_seen_ns: int
    occurrence_count: int
    probability: Annotated[float | None, Served(name="probability_1")]
    evidence: Mapping[str, JsonValue]
    action: Annotated[str, Served("Suggested action, from a code list.", example="reprofile")]
    raise_limit: Annotated[float | None, Served("As it was when the alert fired, in the unit of `limit_unit`.")]
    clear_limit: Annotated[float | None, Served("As it was when the alert fired, in the unit of `limit_unit`.")]
    cleared_ns: int | None = None
    closed_ns: int | None = None
    close_reason: Annotated[CloseReason | None, Served(name="close_reason_code")] = None
    acknowledged_by: str | None = None
    acknowledged_ns: int | None = None
    shelved_until_ns: Annotated[int | None, Served(name="shelved_until")] = None
    shelved_reason: str | None = None
    external_refs: tuple[str, ...] = ()
    fleet_alert_id: Annotated[int | None, Served("The fleet alert that this one is a member of.")] = None
    rules_version: Annotated[str | None, Served("The rules that it was raised by.")] = None
    version: int = 1
    track_section: Annotated[str | None, Served("Code of the section that it is about; null for all others.")] = None

    @property
    def scope(self) -> Annotated[AlertScope, Served("Whether it is about a wheelset, the fleet or a track section.")]:
        """Whether it is about a wheelset, a track section or the fleet."""
        if self.track_section is not None:
            return AlertScope.TRACK_SECTION
        return AlertScope.FLEET if self.wheelset is None else AlertScope.WHEELSET


@dataclass(frozen=True, slots=True)
class AlertEvent:
    """One line of the feed; ``sequence`` is commit-ordered and 0 until stored."""

    sequence: int
    kind: Annotated[AlertEventKind, Served(name="event")]
    alert: Alert  # as it was right after the event
    recorded_ns: int
    actor: Annotated[str, Served("Who caused it: a person, a maintenance system, or `treadwatch` itself.")] = (
        "treadwatch"
    )
    note: str = ""


@dataclass(frozen=True, slots=True)
class Transition:
    """What a finding does to an alert: the alert afterwards, and the events to record."""

    alert: Alert
    events: tuple[AlertEventKind, ...] = field(default=())


class Urgency(MeaningEnum):
    """How soon somebody has to look at a wheelset, the most urgent first; ``meaning`` is what puts it there."""

    OVER_LIMIT = "The conicity limit is exceeded (probability of 0.9 or more), or was when that could be assessed last."
    PROBABLY_OVER = "The limit is exceeded with a probability of 0.5 or more, or was when that could be assessed last."
    CRITICAL_ALERT = "A critical alert of another kind is open, hunting for one."
    DUE = "The limit may be reached within 30,000 km (p10), or the alert on its forecast is open."
    WATCH = "A warning of another kind is open, or the alert on the limit is not cleared yet."
    UNKNOWN = "No number of it can be trusted; the reason says why."
    FINE = "The limit is further away, or the whole interval of its conicity is below 80 % of it; no warning is open."
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
    acknowledged: Annotated[bool, Served("Whether somebody has acknowledged it.")]
    shelved_until_ns: Annotated[int | None, Served(name="shelved_until")]


@dataclass(frozen=True, slots=True)
class MileageNow:
    """How far a wheelset has run since it was new, by the last reading that is believed."""

    mileage_km: float
    at_ns: int


NO_FORECAST = Forecast(None, None, None)


@dataclass(frozen=True, slots=True)
class LimitNow:
    """What is believed of a wheelset and its conicity limit as of its newest believed mileage."""

    conicity: Annotated[Estimate, Served("Equivalent conicity at 3 mm of the current profile.", "conicity_1")]
    slope_per_1000_km: Annotated[Estimate, Served("Of the trend since the last reprofiling.", "slope_1_per_1000_km")]
    limit: Annotated[float | None, Served("Conicity limit by class and speed of its vehicle.", "limit_1")]
    probability_over_limit: Annotated[
        float | None,
        Served("That the limit is exceeded at `mileage_km`; null means unknown.", "probability_over_limit_1"),
    ]
    distance_to_limit_km: Forecast
    since_trend_km: Annotated[float | None, Served("Run since the last point of the trend.")]
    date_of_limit_ns: Forecast  # quantiles of the date
    forecast_reason: Reason | None  # why a quantile is missing; None where none is
    mileage: MileageNow | None


OVER = frozenset({Urgency.OVER_LIMIT, Urgency.PROBABLY_OVER})
FAR_KM = 1e9  # stands for a distance that is not known, behind all that are
BAND_KM = 1e10  # from one class of urgency to the next


@dataclass(frozen=True, slots=True)
class WorklistState(LimitNow):
    """How a wheelset is now."""

    status: Annotated[Status, Served("Of the conicity now.")]
    measured_until_ns: Annotated[int | None, Served("End of the newest data behind the conicity.", "measured_until")]
    last_data_ns: Annotated[int | None, Served("End of the newest data that are estimated or wait for it.")]
    alerts: Annotated[tuple[OpenAlert, ...], Served("Open alerts, the worst first.")]
    urgency: Urgency
    reasons: tuple[Reason, ...]  # why, the most important one first

    @property
    def urgency_key(self) -> float:
        """What orders wheelsets by urgency, the most urgent first."""
        # within a class the limit that may be reached first (p10) comes first; over it, the most certain one
        within = FAR_KM if self.distance_to_limit_km.p10 is None else self.distance_to_limit_km.p10
        if self.urgency in OVER:
            within = 1.0 - (self.probability_over_limit or 0.0)
        return self.urgency.rank * BAND_KM + min(within, FAR_KM)

    @property
    def distance_key(self) -> float | None:
        """What orders wheelsets by the median of their distance to the limit; None where it is not known.

        A median beyond the horizon comes behind all others, those first whose limit may be reached within it (p10).
        """
        p10, p50 = self.distance_to_limit_km.p10, self.distance_to_limit_km.p50
        if p50 is not None:
            return p50
        if p10 is not None:
            return FAR_KM + p10
        beyond = self.forecast_reason is not None and self.forecast_reason.code is ReasonCode.BEYOND_HORIZON
        return 2.0 * FAR_KM if beyond else None


@dataclass(frozen=True, slots=True)
class WorklistRow:
    """One row of the worklist: a wheelset, where it runs, and how it is."""

    wheelset: WheelsetRecord
    vehicle_class: str | None  # of the vehicle that it runs under
    position: AxlePosition | None  # None where it is not mounted
    state: WorklistState


SHOWN_DIGITS = 6  # of what other faces show as well: more than any of them prints, so that all round alike
MOST_NS = 2.0**63 - SECOND_NS  # so that the rounded time is within 64 bits


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What led to a finding; fields are described for the reader of the API."""

    def stored(self) -> dict[str, JsonValue]:
        """Return the fields as an alert keeps them: JSON under their own names."""
        kept: dict[str, JsonValue] = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name == "unknown":
                kept |= unknown_evidence(value)
            elif isinstance(value, Forecast) and item.name.endswith("_ns"):
                kept[item.name] = date_evidence(value)
            else:
                kept[item.name] = _stored(value)
        return kept


@dataclass(frozen=True, slots=True, kw_only=True)
class DecidingEvidence(Evidence):
    """Evidence of a rule that the data may leave undecided."""

    unknown: Annotated[Reason | None, Served("Why the data decide nothing at present; null where they do.")] = None


def _stored(value: object) -> JsonValue:
    if isinstance(value, Estimate | Forecast):
        return dict(estimate_evidence(value) if isinstance(value, Estimate) else forecast_evidence(value))
    if isinstance(value, Enum):
        return str(value.value)
    if is_dataclass(value):
        return {item.name: _stored(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, tuple | list):
        return [_stored(item) for item in value]
    if isinstance(value, Mapping):
        return {str(name): _stored(value[name]) for name in sorted(value)}
    return value  # type: ignore[return-value]  # a number, a text or None


def number_evidence(value: float | None, digits: int = 4) -> float | None:
    """Return the value with some significant digits; None where unknown or not finite."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{digits}g}")


def estimate_evidence(value: Estimate) -> dict[str, JsonValue]:
    """Return an estimate with its interval and status, as the API writes it."""
    return {
        "value": number_evidence(value.value, SHOWN_DIGITS),
        "std": number_evidence(value.std, SHOWN_DIGITS),
        "interval_95": None
        if value.low is None
        else [number_evidence(e, SHOWN_DIGITS) for e in (value.low, value.high)],
        "n_windows": number_evidence(value.count, SHOWN_DIGITS),
        "status": str(value.status),
        "reason": text_of(value.reason),
        "reason_code": code_of(value.reason),
    }


def unknown_evidence(reason: Reason | None) -> dict[str, JsonValue]:
    """Return why a rule cannot decide, as sentence and code; both None where it can."""
    return {"unknown_because": text_of(reason), "unknown_because_code": code_of(reason)}


def forecast_evidence(value: Forecast, digits: int = SHOWN_DIGITS) -> dict[str, JsonValue]:
    """Return the quantiles of a forecast."""
    return {name: number_evidence(getattr(value, name), digits) for name in ("p10", "p50", "p90")}


def date_evidence(value: Forecast) -> dict[str, JsonValue]:
    """Return the quantiles of a date in whole seconds, ns UTC; None beyond what 64 bits hold."""
    return {name: _whole_second(getattr(value, name)) for name in ("p10", "p50", "p90")}


def _whole_second(t_ns: float | None) -> int | None:
    if t_ns is None or not abs(t_ns) < MOST_NS:
        return None
    return round(t_ns / SECOND_NS) * SECOND_NS


def restated(alert: Alert, *, breached: bool | None, cleared: bool | None, stands: bool | None = None) -> Finding:
    """Return a finding that says what an open alert says already."""
    return Finding(
        wheelset=alert.wheelset or "",
        kind=alert.kind,
        breached=breached,
        cleared=cleared,
        severity=alert.severity,
        evidence={name: value for name, value in alert.evidence.items() if name != "delays"},
        action=alert.action,
        raise_limit=alert.raise_limit,
        clear_limit=alert.clear_limit,
        measured_ns=alert.last_seen_ns,
        stands=stands,
    )
