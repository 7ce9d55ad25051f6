"""What is said against records of the registry, and what of it may be confirmed."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from estimation.values.reasons import utc_text


class Rule(StrEnum):
    """Rules over records of the registry."""

    IN_THE_FUTURE = "in_the_future"
    BEFORE_FIRST_MOUNTING = "before_first_mounting"
    MILEAGE_BACKWARDS = "mileage_backwards"
    MILEAGE_JUMP = "mileage_jump"
    ODOMETER_BACKWARDS = "odometer_backwards"
    ODOMETER_JUMP = "odometer_jump"
    UNUSUAL_RADIUS = "unusual_radius"
    UNUSUAL_GAUGE = "unusual_gauge"
    UNKNOWN_PROFILE = "unknown_profile"
    CODE_UNUSABLE = "code_unusable"
    MOUNTED_TWICE = "mounted_twice"


CONFIRMABLE = frozenset(
    {
        Rule.ODOMETER_BACKWARDS,
        Rule.ODOMETER_JUMP,
        Rule.UNUSUAL_RADIUS,
        Rule.UNUSUAL_GAUGE,
        Rule.UNKNOWN_PROFILE,
    }
)
"""What can be so all the same: a new odometer, a wheel of a steam locomotive. Whoever knows it is so says so."""


class Kind(StrEnum):
    """Kinds of records, as the arrays of a registry file are called; windows are no records, but are named too."""

    FLEET = "fleets"
    VEHICLE_CLASS = "vehicle_classes"
    VEHICLE = "vehicles"
    WHEELSET = "wheelsets"
    MOUNTING = "mountings"
    REPROFILING = "reprofilings"
    MEASUREMENT = "measured_profiles"
    SENSOR_CHANGE = "sensor_changes"
    SECTION = "track_sections"
    WINDOW = "windows"


_NOUNS = {
    Kind.FLEET: "fleet",
    Kind.VEHICLE_CLASS: "vehicle class",
    Kind.VEHICLE: "vehicle",
    Kind.WHEELSET: "wheelset",
    Kind.MOUNTING: "mounting of wheelset",
    Kind.REPROFILING: "reprofiling of wheelset",
    Kind.MEASUREMENT: "measured profiles of wheelset",
    Kind.SENSOR_CHANGE: "work on the sensors of vehicle",
    Kind.SECTION: "track section",
    Kind.WINDOW: "window of wheelset",
}


@dataclass(frozen=True, slots=True)
class RecordName:
    """Which record: its kind, its code or its wheelset, and its time where that belongs to its key."""

    kind: Kind
    key: str
    at_ns: int | None = None

    def __str__(self) -> str:
        """Return it as a person reads it."""
        when = "" if self.at_ns is None else f" at {utc_text(self.at_ns)}"
        return f"{_NOUNS[self.kind]} {self.key!r}{when}"


@dataclass(frozen=True, slots=True)
class Contradiction:
    """What is said against a record.

    Attributes:
        field: Of the record, as a registry file calls it.
        reason: What is wrong, in one sentence that names the other records.
        others: The records and windows that it contradicts; none where it is impossible by itself.
    """

    rule: Rule
    record: RecordName
    field: str
    reason: str
    others: tuple[RecordName, ...] = ()
