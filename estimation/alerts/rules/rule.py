"""What an alert rule is: limits and delays that the operator sets, and what they make of the facts of a wheelset."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

from annotated_types import Interval

from estimation.alerts.identity import IdentityEvent
from estimation.values.alerts import Alert, Finding
from estimation.values.geometry import GeometryRecord
from estimation.values.reasons import Reason
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.trend import TrendRecord
from estimation.values.windows import WindowRecord, WindowState

# ranges of what a rules file may set; a number without one is from 0 to 1e9
Probability = Annotated[float, Interval(ge=0.5, le=0.9999)]
Share = Annotated[float, Interval(ge=0.0, le=1.0)]
Days = Annotated[float, Interval(ge=0.01, le=3650.0)]
Evaluations = Annotated[int, Interval(ge=1, le=1000)]
WindowCount = Annotated[int, Interval(ge=1, le=1_000_000)]


@dataclass(frozen=True, slots=True)
class AlertDelays:
    """How long something must be so before an alert follows it.

    An evaluation counts only when newer data than the last one are behind it, so that repeating a job never raises or
    clears anything.
    """

    on_evaluations: Evaluations = 1
    off_evaluations: Evaluations = 2
    acknowledgement_days: Days = 90.0  # after which an acknowledgement ends by itself


@dataclass(frozen=True, slots=True)
class WheelsetFacts:
    """What is stored of one wheelset, as the rules need it."""

    wheelset: WheelsetRecord
    vehicle: VehicleRecord | None  # that it is mounted in
    geometry: GeometryRecord | None  # current
    trend: TrendRecord | None  # latest
    windows: Sequence[WindowRecord]  # the latest of the mounting in service
    open_alerts: Sequence[Alert] = ()
    identity: IdentityEvent | None = None  # since the last identity change
    not_assessable_reason: Reason | None = None  # why the data do not show how the wheelset is now

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

    Attributes
    ----------
    kind
        Name of the rule in rules files and of its alerts, at most 32 letters.
    limit_unit
        Unit of the limits of its alerts.
    of_wear
        It judges the profile: its alerts end with a reprofiling, and it is asked with ``not_assessable_reason``.
    hides_wear
        Why the profile cannot be judged while this rule is breached; empty where it can.
    relations
        Fields of which one limits another, each as (field, "<=" or ">=", field).
    enabled, delays
        Whether it is evaluated; how long before an alert follows.
    """

    kind: ClassVar[str]
    limit_unit: ClassVar[str]
    of_wear: ClassVar[bool] = False
    hides_wear: ClassVar[Reason | None] = None
    relations: ClassVar[Sequence[tuple[str, str, str]]] = ()

    enabled: bool = True
    delays: AlertDelays = field(default_factory=AlertDelays)

    @abstractmethod
    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:
        """Return what the rule finds; None where it does not apply.

        Parameters
        ----------
        facts
            Of a wheelset in service.
        now_ns
            Our time, nanoseconds UTC since the Unix epoch.
        """
