"""What was decided on records of the registry: entered, changed, voided, restored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from estimation.values.fields import JsonValue


class RecordKind(StrEnum):
    """Records of the registry whose history is kept."""

    MOUNTING = "mounting"  # of a wheelset, from a time
    REPROFILING = "reprofiling"  # of a wheelset, at a time
    MEASUREMENT = "measurement"  # of the profiles of a wheelset, at a time
    WHEELSET = "wheelset"
    SECTION = "section"
    VEHICLE = "vehicle"
    VEHICLE_CLASS = "vehicle_class"
    SENSOR_CHANGE = "sensor_change"  # at an axle of a vehicle, at a time

    @property
    def dated(self) -> bool:
        """Whether a time belongs to its key."""
        return self in {RecordKind.MOUNTING, RecordKind.REPROFILING, RecordKind.MEASUREMENT, RecordKind.SENSOR_CHANGE}


class RecordAction(StrEnum):
    """What was done to a record."""

    ENTERED = "entered"
    CHANGED = "changed"
    VOIDED = "voided"
    RESTORED = "restored"


@dataclass(frozen=True, slots=True)
class Decision:
    """Who decides on a record, why, and when by our clock; None where that is not known."""

    actor: str = ""
    reason: str = ""
    recorded_ns: int | None = None


@dataclass(frozen=True, slots=True)
class RegistryEvent:
    """One decision on a record.

    Attributes:
        kind, subject, at_ns: The record: its wheelset or section, and its time on the vehicle's clock where that
            belongs to its key.
        action, actor, reason: What was done, by whom, and why; the last two are empty where a registry file changed it.
        record: What it was before it was changed or voided; what was restored; empty where it is new.
        after: What it was afterwards where it was entered or changed; None of others.
    """

    id: int  # in the order of the decisions
    kind: RecordKind
    subject: str
    at_ns: int | None
    action: RecordAction
    actor: str
    reason: str
    record: Mapping[str, JsonValue]
    recorded_ns: int | None  # our time; None where it is not known
    after: Mapping[str, JsonValue] | None = None
