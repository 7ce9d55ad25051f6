"""What an alert rule is: limits and delays that the operator sets, and what they make of the facts of a wheelset."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

from annotated_types import Interval

from estimation.alerts.identity import IdentityEvent
from estimation.alerts.rules.evidence import Evidence
from estimation.alerts.step_causes import StepSurroundings
from estimation.trend.trend import TrendParameters
from estimation.values.alerts import Alert, Finding
from estimation.values.geometry import GeometryRecord, IntervalConicities, interval_conicities
from estimation.values.opinions import GearDamper
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.trend import SuspensionShown, TrendRecord
from estimation.values.windows import WindowRecord, WindowState

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
    """An alert rule; its fields are what the operator sets.

    Attributes:
        kind: Name of the rule in rules files and of its alerts, at most 32 letters.
        limit_unit: Unit of the limits of its alerts.
        of_wear: It judges the profile: its alerts end with a reprofiling, and it is asked with
            ``not_assessable_reason``.
        of_sensors: It judges the sensors: its alerts end where they are exchanged or calibrated.
        hides_wear: Why the profile cannot be judged while this rule is breached; empty where it can.
        advice: What is the matter and what to do, in the words of the worklist; empty where the rule has words of its
            own.
        counts_km: Its findings have a mileage, so that its delays may be in kilometres.
        relations: Fields of which one limits another, each as (field, "<=" or ">=", field).
        evidence: What its findings rest on: what its alerts keep, and what the API answers; None where that is told by
            what it is alone.
        enabled, delays: Whether it is evaluated; how long before an alert follows.
    """

    kind: ClassVar[str]
    limit_unit: ClassVar[str]
    of_wear: ClassVar[bool] = False
    of_sensors: ClassVar[bool] = False
    hides_wear: ClassVar[Reason | None] = None
    advice: ClassVar[str] = ""
    counts_km: ClassVar[bool] = False
    relations: ClassVar[Sequence[tuple[str, str, str]]] = ()
    evidence: ClassVar[type[Evidence] | None] = None

    enabled: bool = True
    delays: AlertDelays = field(default_factory=AlertDelays)

    @abstractmethod
    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:
        """Return what the rule finds; None where it does not apply.

        Args:
            now_ns: Our time, nanoseconds UTC since the Unix epoch.
        """


def newest_windows(windows: Sequence[WindowRecord], count: int) -> list[WindowRecord]:
    """Return the newest windows, oldest first.

    Args:
        windows: In any order.
        count: How many at most.
    """
    return sorted(windows, key=lambda window: window.start_ns)[-count:]


def measured_until(windows: Sequence[WindowRecord], otherwise_ns: int) -> int:
    """Return the end of the last window, ns UTC.

    Args:
        windows: In any order.
    """
    return max((window.start_ns + window.length_ns for window in windows), default=otherwise_ns)


def too_few_windows(windows: int, needed: int) -> Reason | None:
    """Return that there are fewer windows than a rule needs; None where there are enough.

    Args:
        windows, needed: How many there are, and the least number.
    """
    if windows >= needed:
        return None
    return Reason(ReasonCode.TOO_FEW_WINDOWS, f"{windows} windows, {needed} needed")
