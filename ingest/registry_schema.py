"""Schema of a registry file: the records as they are, and what stands there of files beside it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict

from estimation.values.file_units import MM, Key
from estimation.values.registry import (
    Code,
    FleetRecord,
    Kilometres,
    MomentNs,
    Mounting,
    Reprofiling,
    SensorChange,
    VehicleRecord,
    WheelsetRecord,
)
from estimation.values.track import TrackSectionRecord
from ingest.file_value import Inline
from ingest.input_file import InputTable, NotNegative, Positive, Text, field_error

FORMAT = "treadwatch-registry-1"


@dataclass(frozen=True, slots=True)
class NamedFile:
    """What is in a file beside the registry."""

    file: Text


@dataclass(frozen=True, slots=True)
class MeasurementEntry:
    """An entry of ``measured_profiles``."""

    wheelset: Code
    at_ns: Annotated[MomentNs, Key("at")]
    mileage_km: Kilometres
    left: NamedFile
    right: NamedFile
    std: Annotated[Positive, MM] = 1e-3 * 0.1  # of the lateral displacement that follows from measured profiles


@dataclass(frozen=True, slots=True)
class AlignmentEntry:
    """``alignment`` of a track section."""

    file: Text
    gauge_deviation_std: Annotated[NotNegative, MM]
    alignment_std: Annotated[NotNegative, MM] | None = None

    def of_file(self, given: Collection[str]) -> Self:
        """Refuse a null: a file of the gauge alone has no such key."""
        if self.alignment_std is None and "alignment_std_mm" in given:
            raise field_error("None is not a number", "alignment_std_mm")
        return self


@dataclass(frozen=True, slots=True)
class SectionEntry:
    """An entry of ``track_sections``."""

    record: Annotated[TrackSectionRecord, Inline(TrackSectionRecord)]
    alignment: AlignmentEntry | None = None
    layout: NamedFile | None = None
    coordinates: NamedFile | None = None


class RecordedClassEntry(InputTable):
    """An entry of ``vehicle_classes`` as an export has it: the class as it is stored, in SI units."""

    recorded: dict[str, Any]


class ClassEntry(InputTable):
    """An entry of ``vehicle_classes``: a file, as recorded, or a ``VehicleClassEntry``, and checked as that."""

    model_config = ConfigDict(extra="allow")


@dataclass(frozen=True, slots=True)
class RegistryObject:
    """The whole file."""

    format: Literal["treadwatch-registry-1"]
    fleets: tuple[FleetRecord, ...] = ()
    vehicle_classes: tuple[ClassEntry, ...] = ()
    vehicles: tuple[VehicleRecord, ...] = ()
    wheelsets: tuple[WheelsetRecord, ...] = ()
    mountings: tuple[Mounting, ...] = ()
    reprofilings: tuple[Reprofiling, ...] = ()
    measured_profiles: tuple[MeasurementEntry, ...] = ()
    sensor_changes: tuple[SensorChange, ...] = ()
    track_sections: tuple[SectionEntry, ...] = ()

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse a record that is there twice."""
        for name, key in _KEYS:
            before: set[tuple[object, ...]] = set()
            for index, entry in enumerate(getattr(self, name)):
                found = tuple(getattr(getattr(entry, "record", entry), part) for part in key)
                if found in before:
                    raise field_error(f"{found[0]!r} is in an entry before", name, index)
                before.add(found)
        return self


_KEYS = (  # of the entries of each array
    ("fleets", ("code",)),
    ("vehicles", ("code",)),
    ("wheelsets", ("serial",)),
    ("mountings", ("wheelset", "from_ns")),
    ("reprofilings", ("wheelset", "at_ns")),
    ("measured_profiles", ("wheelset", "at_ns")),
    ("sensor_changes", ("vehicle", "at_ns")),
    ("track_sections", ("code",)),
    ("track_sections", ("number",)),
)
