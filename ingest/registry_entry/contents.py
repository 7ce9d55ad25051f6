"""What is entered together into the registry, whether a file, a command or a client of the REST API brings it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

from estimation.errors import InputError
from estimation.values.reasons import utc_text
from estimation.values.registry import FleetRecord, Mounting, Reprofiling, SensorChange, VehicleRecord, WheelsetRecord
from fleet_db.records import Decision, EstimatedAgain
from ingest.input_file import Location

if TYPE_CHECKING:  # the help of a command that names rules does not wait for the numerics
    from estimation.contact.profiles import MeasuredProfiles
    from estimation.values.track import TrackAlignment, TrackLayout, TrackSectionRecord
    from estimation.vehicle.vehicle_class import VehicleClass


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
    Kind.VEHICLE_CLASS: "vehicle class",
    Kind.MOUNTING: "mounting of wheelset",
    Kind.REPROFILING: "reprofiling of wheelset",
    Kind.MEASUREMENT: "measured profiles of wheelset",
    Kind.SENSOR_CHANGE: "work on the sensors of vehicle",
    Kind.SECTION: "track section",
    Kind.WINDOW: "window of wheelset",
}
"""Of kinds whose noun is not the name of the array without its s."""


@dataclass(frozen=True, slots=True)
class RecordName:
    """Which record: its kind, its code or its wheelset, and its time where that belongs to its key."""

    kind: Kind
    key: str
    at_ns: int | None = None

    def __str__(self) -> str:
        """Return it as a person reads it."""
        when = "" if self.at_ns is None else f" at {utc_text(self.at_ns)}"
        return f"{_NOUNS.get(self.kind, self.kind.removesuffix('s'))} {self.key!r}{when}"


@dataclass(frozen=True, slots=True)
class Contradiction:
    """What is said against a record."""

    rule: Rule
    record: RecordName
    field: str
    reason: str
    others: tuple[RecordName, ...] = ()  # that it contradicts; none where it is impossible by itself


@dataclass(frozen=True, slots=True)
class RegistryContents:
    """Records that are checked each by itself but not yet stored, in the order in which they were given."""

    fleets: tuple[FleetRecord, ...] = ()
    classes: tuple[VehicleClass, ...] = ()
    vehicles: tuple[VehicleRecord, ...] = ()
    wheelsets: tuple[WheelsetRecord, ...] = ()
    mountings: tuple[Mounting, ...] = ()
    reprofilings: tuple[Reprofiling, ...] = ()
    measured_profiles: tuple[MeasuredProfiles, ...] = ()
    sensor_changes: tuple[SensorChange, ...] = ()
    sections: tuple[TrackSectionRecord, ...] = ()
    alignments: tuple[TrackAlignment, ...] = ()
    layouts: tuple[TrackLayout, ...] = ()


@dataclass(frozen=True, slots=True)
class Entry:
    """How something is entered."""

    decision: Decision  # who enters it, why, and our time; kept with what changes
    now_ns: int | None = None  # our time, after which the future begins; None where it is not known
    confirmed: frozenset[Rule] = frozenset()  # rules whose doubts whoever enters it has confirmed to be unfounded

    @property
    def recorded_ns(self) -> int:
        """Our time."""
        return self.decision.recorded_ns or 0


class Source(Protocol):
    """Where records come from: what names the place of an error in it."""

    def error(self, reason: str, location: Location = ()) -> InputError:
        """Return the error that names a place: array, index and field of a registry file."""
        ...


@dataclass(frozen=True, slots=True)
class Refusal:
    """One thing that is wrong: the error with its place, and what it contradicts where a rule refuses it."""

    error: InputError
    contradiction: Contradiction | None = None


class RegistryRefusedError(InputError):
    """What was to be entered is refused whole; ``refusals`` lists all that is wrong, the first is the message."""

    def __init__(self, refusals: tuple[Refusal, ...]) -> None:
        first = refusals[0]
        self.refusals = refusals
        super().__init__(first.error.reason, file=first.error.file, line=first.error.line, field=first.error.field)


@dataclass(frozen=True, slots=True)
class LoadedRegistry:
    """What was stored of what was entered."""

    contents: RegistryContents
    again: tuple[EstimatedAgain, ...]  # what is estimated again, by class, vehicle and wheelset
    without_class: tuple[VehicleRecord, ...]  # vehicles that are not estimated: nobody knows their class


ARRAYS = {kind: str(kind) for kind in Kind} | {Kind.VEHICLE_CLASS: "classes", Kind.SECTION: "sections"}
"""Field of :class:`RegistryContents` by kind of record."""
