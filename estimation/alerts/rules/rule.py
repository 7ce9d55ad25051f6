"""What an alert rule is: limits and delays that the operator sets, and what they make of the facts of a wheelset."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from typing import Annotated, ClassVar

from annotated_types import Interval

from estimation.alerts.identity import IdentityEvent
from estimation.trend.trend import TrendParameters
from estimation.values.alerts import Alert, Finding
from estimation.values.fields import JsonValue, Served
from estimation.values.geometry import GeometryRecord, IntervalConicities, interval_conicities
from estimation.values.opinions import GearDamper
from estimation.values.quantities import Estimate, Forecast
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.trend import StepSurroundings, SuspensionShown, TrendRecord
from estimation.values.windows import WindowRecord, WindowState

SECOND_NS = 1_000_000_000
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
        "value": number_evidence(value.value),
        "std": number_evidence(value.std, 3),
        "interval_95": None if value.low is None else [number_evidence(value.low), number_evidence(value.high)],
        "n_windows": number_evidence(value.count),
        "status": str(value.status),
        "reason": text_of(value.reason),
        "reason_code": code_of(value.reason),
    }


def unknown_evidence(reason: Reason | None) -> dict[str, JsonValue]:
    """Return why a rule cannot decide, as sentence and code; both None where it can."""
    return {"unknown_because": text_of(reason), "unknown_because_code": code_of(reason)}


def forecast_evidence(value: Forecast, digits: int = 3) -> dict[str, JsonValue]:
    """Return the quantiles of a forecast."""
    return {name: number_evidence(getattr(value, name), digits) for name in ("p10", "p50", "p90")}


def date_evidence(value: Forecast) -> dict[str, JsonValue]:
    """Return the quantiles of a date in whole seconds, ns UTC; None beyond what 64 bits hold."""
    return {name: _whole_second(getattr(value, name)) for name in ("p10", "p50", "p90")}


def _whole_second(t_ns: float | None) -> int | None:
    if t_ns is None or not abs(t_ns) < MOST_NS:
        return None
    return round(t_ns / SECOND_NS) * SECOND_NS


# ranges of what a rules file may set; a number without one is from 0 to 1e9
Probability = Annotated[float, Interval(ge=0.5, le=0.9999)]
Share = Annotated[float, Interval(ge=0.0, le=1.0)]
Days = Annotated[float, Interval(ge=0.01, le=3650.0)]
Evaluations = Annotated[int, Interval(ge=1, le=1000)]
WindowCount = Annotated[int, Interval(ge=1, le=1_000_000)]
Kilometres = Annotated[float, Interval(ge=0.0, le=100_000.0)]


@dataclass(frozen=True, slots=True)
class AlertDelays:
    """How long something must be so before an alert follows it.

    An evaluation is one in vehicle time: after a window, or after an interval of mileage for what rests on geometries.
    How often the job ran does not count. Only where nothing is kept of earlier data (geometries without intervals) runs
    count, each with newer data than the last one.

    A delay in kilometres stands in place of that in evaluations: from the first finding that breaches (or is beyond the
    clear limit) to the last, none between them saying otherwise, the wheelset has run as far. 0 counts evaluations.
    """

    on_evaluations: Evaluations = 1
    off_evaluations: Evaluations = 2
    acknowledgement_days: Days = 90.0  # after which an acknowledgement ends by itself
    on_delay_km: Kilometres = 0.0
    off_delay_km: Kilometres = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelsetFacts:
    """What is stored of one wheelset, as the rules need it."""

    wheelset: WheelsetRecord
    vehicle: VehicleRecord | None  # that it is mounted in
    geometry: GeometryRecord | None  # current
    trend: TrendRecord | None  # latest
    windows: Sequence[WindowRecord]  # of the mounting in service, the newest that any rule looks at
    intervals: Sequence[GeometryRecord] = ()  # that hold, of the profile in this mounting, oldest first: the newest
    conicities: Sequence[IntervalConicities] = ()  # of all of them; empty where ``intervals`` are all
    open_alerts: Sequence[Alert] = ()
    identity: IdentityEvent | None = None  # since the last identity change
    suspension: SuspensionShown | None = None  # of its vehicle, where its alert stands at this wheelset
    step_surroundings: StepSurroundings = field(default_factory=StepSurroundings)  # of the step of its trend
    damper: GearDamper | None = None  # of the running gear whose first axle it is at
    trend_parameters: TrendParameters = field(default_factory=TrendParameters)  # of the trend
    rejected_recordings: Mapping[str, int] = field(default_factory=dict)  # of its vehicle, by code, as the one before
    limit_rule: AlertRule | None = None  # that of the conicity limit, of the same book
    profiles_measured_km: float | None = None  # mileage at which its profiles were last measured, since reprofiling
    sensors_changed_ns: int | None = None  # when the sensors of its axle were last exchanged or calibrated
    hunted: frozenset[int] = frozenset()  # starts of windows in which a wheelset of its vehicle hunts
    not_assessable_reason: Reason | None = None  # why the data do not show how the wheelset is now

    @property
    def all_conicities(self) -> Sequence[IntervalConicities]:
        """Those of all intervals that hold, of the profile in this mounting, oldest first."""
        return self.conicities or [interval_conicities(record) for record in self.intervals]

    @property
    def last_usable_ns(self) -> int | None:
        """End of the newest data that were estimated or wait for it."""
        ends = [w.start_ns + w.length_ns for w in self.windows if w.state is not WindowState.REFUSED]
        if self.geometry is not None:
            ends.append(self.geometry.to_ns)
        return max(ends, default=None)

    @property
    def current_trend(self) -> TrendRecord | None:
        """The latest trend, where it is of the profile that the current geometry is of."""
        if self.trend is None or self.geometry is None or self.trend.baseline != self.geometry.baseline:
            return None
        return self.trend


@dataclass(frozen=True, slots=True)
class AlertRule(ABC):
    """An alert rule; its fields are what the operator sets."""

    kind: ClassVar[str]  # its name in rules files and of its alerts, at most 32 letters
    limit_unit: ClassVar[str]  # of its alerts
    of_wear: ClassVar[bool] = False  # judges the profile: its alerts end with a reprofiling; may not be assessable
    of_sensors: ClassVar[bool] = False  # judges the sensors: its alerts end where they are exchanged or calibrated
    hides_wear: ClassVar[Reason | None] = None  # why the profile cannot be judged while it is breached
    advice: ClassVar[str] = ""  # what to do, in the words of the worklist; empty where the worklist has its own
    counts_km: ClassVar[bool] = False  # its findings have a mileage, so that its delays may be in kilometres
    relations: ClassVar[Sequence[tuple[str, str, str]]] = ()  # (field, "<=" or ">=", the field that limits it)
    evidence: ClassVar[type[Evidence] | None] = None  # what its alerts keep and the API answers

    enabled: bool = True
    delays: AlertDelays = field(default_factory=AlertDelays)

    @abstractmethod
    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:
        """Return what the rule finds, at our time in ns UTC; None where it does not apply."""


def measured_until(windows: Sequence[WindowRecord], facts: WheelsetFacts) -> int:
    """Return the end of the last window, ns UTC; the begin of the mounting where there is none."""
    mounting = facts.wheelset.mounting
    ends = (window.start_ns + window.length_ns for window in windows)
    return max(ends, default=0 if mounting is None else mounting.from_ns)


def too_few_windows(windows: int, needed: int) -> Reason | None:
    """Return that there are fewer windows than a rule needs; None where there are enough."""
    if windows >= needed:
        return None
    return Reason(ReasonCode.TOO_FEW_WINDOWS, f"{windows} windows, {needed} needed")


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
