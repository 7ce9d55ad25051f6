"""Alerts as values: what a rule finds, what an alert is, what happens to it.

Identity of an open alert is (fleet, wheelset serial, kind); that of a fleet alert, which stands for many of them, is
(fleet, kind), that of one about a track section (fleet, section, kind). Facts are kept apart instead of one status
word.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from estimation.values.json_value import JsonValue
from estimation.values.reasons import MeaningEnum


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


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one rule for one wheelset at one time; ``breached`` is None where the data do not decide.

    ``stands`` is whether an alert stands by all data in vehicle time; where None, evaluations are counted. ``since_ns``
    is when it was raised by them. ``mileage_km`` is that of the data, for delays in kilometres.
    """

    wheelset: str
    kind: str  # of the rule
    breached: bool | None
    cleared: bool | None  # beyond the clear limit (apart from the raise limit)
    severity: Severity
    probability: float | None
    evidence: Mapping[str, JsonValue]  # numbers, intervals, windows, limits
    action: str  # suggested action code
    raise_limit: float | None
    clear_limit: float | None
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

    alert_id: int
    fleet: str
    wheelset: str | None
    kind: str  # of the rule behind it
    severity: Severity
    condition: Condition
    opened_ns: int
    last_seen_ns: int
    occurrence_count: int
    probability: float | None
    evidence: Mapping[str, JsonValue]
    action: str
    raise_limit: float | None
    clear_limit: float | None
    cleared_ns: int | None = None
    closed_ns: int | None = None
    close_reason: CloseReason | None = None
    acknowledged_by: str | None = None
    acknowledged_ns: int | None = None
    shelved_until_ns: int | None = None
    shelved_reason: str | None = None
    external_refs: tuple[str, ...] = ()
    fleet_alert_id: int | None = None
    rules_version: str | None = None
    version: int = 1
    track_section: str | None = None  # code of the section that it is about

    @property
    def scope(self) -> AlertScope:
        """Whether it is about a wheelset, a track section or the fleet."""
        if self.track_section is not None:
            return AlertScope.TRACK_SECTION
        return AlertScope.FLEET if self.wheelset is None else AlertScope.WHEELSET


@dataclass(frozen=True, slots=True)
class AlertEvent:
    """One line of the feed; ``sequence`` is commit-ordered and 0 until stored."""

    sequence: int
    kind: AlertEventKind
    alert: Alert  # as it was right after the event
    recorded_ns: int
    actor: str = "treadwatch"
    note: str = ""


@dataclass(frozen=True, slots=True)
class Transition:
    """What a finding does to an alert: the alert afterwards, and the events to record."""

    alert: Alert
    events: tuple[AlertEventKind, ...] = field(default=())
