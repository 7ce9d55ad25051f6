"""The operator's registry as a JSON file: what runs where, and the track it runs on. ``docs/registry.md`` describes it.

The whole file is read and checked before the first record is written, and every write is an upsert: loading the same
file again changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from pydantic import ConfigDict

from estimation.contact.profiles import MeasuredProfiles, Profile
from estimation.errors import InputError, ParameterError, ProfileError
from estimation.values.arrays import FloatArray
from estimation.values.fields import MM, Key
from estimation.values.quantities import Status
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
from estimation.values.track import TrackAlignment, TrackLayout, TrackSectionRecord
from estimation.vehicle.vehicle_class import VehicleClass, class_of_document
from fleet_db.records import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.file_value import Inline, read_value, table_of, taken
from ingest.input_file import InputFile, InputTable, Location, NotNegative, Positive, Text, field_error, read_json
from ingest.registry_entry.contents import Entry, LoadedRegistry, Refusal, RegistryContents, RegistryRefusedError
from ingest.registry_entry.enter import enter
from ingest.track_file import (
    LAYOUT_COLUMNS,
    read_gauge_columns,
    read_layout_columns,
    read_line,
    read_track_columns,
    uniform_distance,
)
from ingest.vehicle_class_schema import VehicleClassEntry, read_vehicle_class

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
                names = tuple(getattr(getattr(entry, "record", entry), part) for part in key)
                if names in before:
                    raise field_error(f"{names[0]!r} is in an entry before", name, index)
                before.add(names)
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


def read_classes(file: InputFile, count: int) -> tuple[VehicleClass, ...]:
    """Return the classes of a registry file, those in files of their own included."""
    classes: dict[str, VehicleClass] = {}
    for index in range(count):
        location: Location = ("vehicle_classes", index)
        vehicle_class = _class(file, location)
        if classes.setdefault(vehicle_class.code, vehicle_class) is not vehicle_class:
            raise file.error(f"there are two classes {vehicle_class.code!r}", location)
    return tuple(classes.values())


def _class(file: InputFile, location: Location) -> VehicleClass:
    if "file" in file.at(location):
        name = read_value(file, NamedFile, location).file
        return read_vehicle_class(file.path.parent / name)
    if "recorded" in file.at(location):
        document = file.parse(RecordedClassEntry, location).recorded
        try:
            return class_of_document(document)
        except (KeyError, TypeError, ValueError, AttributeError, ParameterError) as error:
            raise file.error(f"is no vehicle class as an export has it: {error}", (*location, "recorded")) from error
    return file.parse(VehicleClassEntry, location).record()


MIN_LAYOUT_SHARE = 0.5  # of a section that its layout must reach
_Read = TypeVar("_Read")


def load_registry(
    path: Path, unit_of_work: SqlUnitOfWork, recorded_ns: int, entry: Entry | None = None
) -> LoadedRegistry:
    """Read a registry file and store its contents; return them, and what they change.

    An entry says who loads it, our time to tell the future by, and what has been confirmed; by default nobody, none and
    nothing. Raises RegistryRefusedError, which lists everything that is wrong; nothing has been committed then.
    """
    file = read_json(path)
    contents, refusals = _contents(file)
    return enter(contents, unit_of_work, file, entry or Entry(Decision(recorded_ns=recorded_ns)), refusals)


def read_registry(path: Path) -> RegistryContents:
    """Read and check a registry file and the files it names."""
    contents, refusals = _contents(read_json(path))
    if refusals:
        raise RegistryRefusedError(tuple(refusals))
    return contents


def _contents(file: InputFile) -> tuple[RegistryContents, list[Refusal]]:
    """Return what a file holds as far as it can be read, and what cannot be."""
    wrong = [Refusal(error) for error in file.problems(table_of(RegistryObject))]
    if wrong:
        raise RegistryRefusedError(tuple(wrong))
    entries = read_value(file, RegistryObject)

    def read(reading: Callable[[], _Read]) -> list[_Read]:
        try:
            return [reading()]
        except InputError as error:
            wrong.append(Refusal(error))
            return []

    classes = read(lambda: read_classes(file, len(entries.vehicle_classes)))
    measured = [
        one
        for index, entry in enumerate(entries.measured_profiles)
        for one in read(partial(_measured_profiles, file, entry, ("measured_profiles", index)))
    ]
    sections = [
        one
        for index, entry in enumerate(entries.track_sections)
        for one in read(partial(_section, file, entry, ("track_sections", index)))
    ]
    contents = taken(
        RegistryContents,
        entries,
        classes=classes[0] if classes else (),
        measured_profiles=tuple(measured),
        sections=tuple(section for section, _, _ in sections),
        alignments=tuple(alignment for _, alignment, _ in sections if alignment is not None),
        layouts=tuple(layout for _, _, layout in sections if layout is not None),
    )
    return contents, wrong


def _measured_profiles(file: InputFile, entry: MeasurementEntry, location: Location) -> MeasuredProfiles:
    left = _wheel(file, entry.left.file, (*location, "left", "file"))
    right = _wheel(file, entry.right.file, (*location, "right", "file"))
    return taken(MeasuredProfiles, entry, left=left, right=right)


def _wheel(file: InputFile, name: str, location: Location) -> Profile:
    from ingest.profiles.files import read_wheel_profile  # noqa: PLC0415 - few registries wait for what smooths points

    try:
        return read_wheel_profile(file.path.parent / name)
    except ProfileError as error:
        raise file.error(str(error), location) from error


def _section(
    file: InputFile, entry: SectionEntry, location: Location
) -> tuple[TrackSectionRecord, TrackAlignment | None, TrackLayout | None]:
    """Return a section with the track that the files of its entry hold; a layout of its own comes before the other."""
    section, folder = entry.record, file.path.parent
    alignment = layout = None
    if entry.coordinates is not None:
        section = replace(section, line=read_line(folder / entry.coordinates.file, section))
    if entry.alignment is not None:
        alignment = _alignment(file, entry.alignment, section.code, (*location, "alignment"))
        layout = _layout(folder / entry.alignment.file, section)
    if entry.layout is not None:
        own = folder / entry.layout.file
        layout = _layout(own, section)
        if layout is None:
            raise InputError(f"no such column; expected s_m, {', '.join(LAYOUT_COLUMNS)}", file=own, line=1)
    return section, alignment, layout


def _layout(file: Path, section: TrackSectionRecord) -> TrackLayout | None:
    columns = read_layout_columns(file)
    if columns is None:
        return None
    last = float(columns[-1, 0])
    if last < MIN_LAYOUT_SHARE * section.length_m or last > section.length_m / MIN_LAYOUT_SHARE:
        reason = f"ends at {last:g} m, section {section.code!r} has {section.length_m:g} m; another unit or section?"
        raise InputError(reason, file=file, field="s_m")
    return TrackLayout(section.code, 0, *columns.T)


def _alignment(file: InputFile, entry: AlignmentEntry, section: str, location: Location) -> TrackAlignment:
    track_file = file.path.parent / entry.file
    s, alignment, gauge = _columns(file, entry, track_file, location)
    if not uniform_distance(s):
        raise InputError("distances must be evenly spaced", file=track_file, field="s_m")
    n = len(s)
    std = np.nan if entry.alignment_std is None else entry.alignment_std
    return TrackAlignment(
        section=section,
        version=0,
        s=np.linspace(s[0], s[-1], n),
        alignment=alignment,
        alignment_std=np.full(n, std),
        gauge_deviation=gauge,
        gauge_deviation_std=np.full(n, entry.gauge_deviation_std),
        passes=np.zeros(n, dtype=np.int64),
        status=Status.ESTIMATED if np.isfinite(std) else Status.UNESTIMATED,
    )


def _columns(
    file: InputFile, entry: AlignmentEntry, track_file: Path, location: Location
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return distance, alignment, gauge deviation (n,), m; alignments are NaN in a file of the gauge alone.

    A standard deviation of an alignment that the file does not have is an error: the column may be misspelt.
    """
    if entry.alignment_std is None:
        of_gauge = read_gauge_columns(track_file)
        if of_gauge is None:
            raise file.error("is missing", (*location, "alignment_std_mm"))
        s, gauge = of_gauge.T
        return s, np.full(len(s), np.nan), gauge
    s, alignment, gauge = read_track_columns(track_file).T
    return s, alignment, gauge
