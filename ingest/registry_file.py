"""The operator's registry as a JSON file: what runs where, and the track it runs on. ``docs/registry.md`` describes it.

The whole file is read and checked before the first record is written, and every write is an upsert: loading the same
file again changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from estimation.contact.profiles import MeasuredProfiles, Profile
from estimation.errors import ConflictError, InputError, NotFoundError, ParameterError, ProfileError
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.registry import FleetRecord, Mounting, Reprofiling, VehicleRecord, WheelsetRecord
from estimation.values.track import TrackAlignment, TrackLayout, TrackSectionRecord
from estimation.vehicle.vehicle_class import VehicleClass
from fleet_db.receipts import EstimatedAgain
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.registry import RegistryStore
from fleet_db.stores.section_numbers import free_numbers
from ingest.input_file import InputFile, Location, read_json
from ingest.profiles.wheel_profile import read_wheel_profile
from ingest.registry_classes import RunningWheelset, check_classes, check_vehicles, check_wheelsets, read_classes
from ingest.registry_schema import AlignmentEntry, MeasurementEntry, RegistryObject, SectionEntry
from ingest.section_line import read_line
from ingest.track_file import (
    LAYOUT_COLUMNS,
    read_gauge_columns,
    read_layout_columns,
    read_track_columns,
    uniform_distance,
)

MIN_LAYOUT_SHARE = 0.5  # of a section that its layout must reach
_T = TypeVar("_T")
_R = TypeVar("_R")


@dataclass(frozen=True, slots=True)
class RegistryContents:
    """Everything a registry file holds, checked but not yet stored."""

    fleets: tuple[FleetRecord, ...]
    classes: tuple[VehicleClass, ...]
    vehicles: tuple[VehicleRecord, ...]
    wheelsets: tuple[WheelsetRecord, ...]
    mountings: tuple[Mounting, ...]
    reprofilings: tuple[Reprofiling, ...]
    measured_profiles: tuple[MeasuredProfiles, ...]
    sections: tuple[TrackSectionRecord, ...]
    alignments: tuple[TrackAlignment, ...]
    layouts: tuple[TrackLayout, ...]


@dataclass(frozen=True, slots=True)
class LoadedRegistry:
    """What a registry file did to the store."""

    contents: RegistryContents
    again: tuple[EstimatedAgain, ...]  # what is estimated again, by class, vehicle and wheelset
    without_class: tuple[VehicleRecord, ...]  # vehicles of the file that are not estimated: nobody knows their class


def load_registry(path: Path, unit_of_work: SqlUnitOfWork, recorded_ns: int) -> LoadedRegistry:
    """Read a registry file and store its contents; return them, and what they change.

    Parameters
    ----------
    path
        The registry file; the files it names are relative to its folder.
    unit_of_work
        An open transaction; nothing is committed here.
    recorded_ns
        Our time, ns UTC.

    Raises
    ------
    InputError
        The file, a track file or a profile file cannot be read, a field is missing, unknown or impossible, or a record
        refers to something that neither the file nor the store knows; nothing has been committed then.
    """
    file = read_json(path)
    contents = _contents(file)
    registry, tracks = unit_of_work.registry, unit_of_work.tracks
    _check_classes(file, contents, registry)
    _store(path, "fleets", contents.fleets, registry.add_fleet)
    again = [registry.add_vehicle_class(one, recorded_ns) for one in contents.classes]
    again += _store(path, "vehicles", contents.vehicles, lambda one: registry.add_vehicle(one, recorded_ns))
    again += _store(path, "wheelsets", contents.wheelsets, lambda one: registry.add_wheelset(one, recorded_ns))
    before = registry.take_out(contents.mountings)
    _store(
        path,
        "mountings",
        contents.mountings,
        lambda one: registry.add_mounting(one, before.get((one.wheelset, one.from_ns)), recorded_ns),
    )
    _store(path, "reprofilings", contents.reprofilings, lambda one: registry.add_reprofiling(one, recorded_ns))
    _store(
        path,
        "measured_profiles",
        contents.measured_profiles,
        lambda one: registry.add_measured_profiles(one, recorded_ns),
    )
    free_numbers(unit_of_work.connection, contents.sections, recorded_ns)
    _store(path, "track_sections", contents.sections, lambda one: tracks.add_section(one, recorded_ns))
    _store(path, "track_sections", contents.alignments, lambda known: _add_alignment(unit_of_work, known))
    _store(path, "track_sections", contents.layouts, lambda layout: _add_layout(unit_of_work, layout))
    known = {code for code in _classes_of(contents) if registry.vehicle_class(code) is not None}
    without = tuple(vehicle for vehicle in contents.vehicles if vehicle.vehicle_class not in known)
    return LoadedRegistry(contents, tuple(one for one in again if one.subjects), without)


def _classes_of(contents: RegistryContents) -> set[str]:
    return {vehicle.vehicle_class for vehicle in contents.vehicles}


def _check_classes(file: InputFile, contents: RegistryContents, registry: RegistryStore) -> None:
    """Refuse vehicles and wheelsets of the file that do not belong to their class, of the file or on file."""
    classes = {one.code: one for one in contents.classes}
    for code in _classes_of(contents) - set(classes):
        known = _on_file(registry, code)
        if known is not None:
            classes[code] = known
    check_vehicles(file, contents.vehicles, classes)
    changed = {vehicle.code for vehicle in contents.vehicles}
    on_file = {
        one.code: [vehicle for vehicle in registry.vehicles_of_class(one.code) if vehicle.code not in changed]
        for one in contents.classes
    }
    check_classes(file, contents.classes, on_file)
    entries = {
        "wheelsets": [one.serial for one in contents.wheelsets],
        "mountings": [one.wheelset for one in contents.mountings],
        "vehicles": [one.code for one in contents.vehicles],
        "vehicle_classes": [one.code for one in contents.classes],
    }
    check_wheelsets(file, _running(contents, registry, classes), entries)


def _running(
    contents: RegistryContents, registry: RegistryStore, classes: Mapping[str, VehicleClass]
) -> list[RunningWheelset]:
    """Return the wheelsets in service as the file leaves them, those of whose class nothing is known left out."""
    wheelsets = {one.serial: one for one in registry.wheelsets()}
    mounted = [one.mounting for one in wheelsets.values() if one.mounting is not None]
    latest = {one.wheelset: one.vehicle for one in sorted([*mounted, *contents.mountings], key=lambda m: m.from_ns)}
    wheelsets |= {one.serial: one for one in contents.wheelsets}
    class_of = {one.code: one.vehicle_class for one in contents.vehicles}
    for code in set(latest.values()) - set(class_of):
        with suppress(NotFoundError):  # refused when the mounting is stored
            class_of[code] = registry.vehicle(code).vehicle_class
    known = {code: classes.get(code) or _on_file(registry, code) for code in set(class_of.values())}
    found = []
    for serial, vehicle in latest.items():
        of_vehicle = known.get(class_of.get(vehicle, ""))
        if serial in wheelsets and of_vehicle is not None:
            found.append(RunningWheelset(wheelsets[serial], vehicle, of_vehicle))
    return found


def _on_file(registry: RegistryStore, code: str) -> VehicleClass | None:
    found = registry.vehicle_class(code)
    return None if found is None else found.vehicle_class


def _add_alignment(unit_of_work: SqlUnitOfWork, alignment: TrackAlignment) -> None:
    """Store an alignment; where it replaces another, queue the windows of the section again.

    Their positions had been found against the replaced one, which may be off by some metres.
    """
    tracks = unit_of_work.tracks
    before = tracks.in_force(alignment.section)
    version = tracks.add_alignment(alignment)
    if before is not None and version > before.version:
        tracks.forget_positions(alignment.section)
        unit_of_work.windows.requeue_section(alignment.section)


def _add_layout(unit_of_work: SqlUnitOfWork, layout: TrackLayout) -> None:
    """Store a layout; where it differs from the one before, queue the windows of the section again."""
    before = unit_of_work.tracks.layout(layout.section)
    version = unit_of_work.tracks.add_layout(layout)
    if before is None or before.version != version:
        unit_of_work.windows.requeue_section(layout.section)


def read_registry(path: Path) -> RegistryContents:
    """Read and check a registry file and the files it names.

    Parameters
    ----------
    path
        The registry file; the files it names are relative to its folder.

    Raises
    ------
    InputError
        As ``load_registry``, but for what the store knows.
    """
    return _contents(read_json(path))


def _contents(file: InputFile) -> RegistryContents:
    entries = file.parse(RegistryObject)
    sections = [_section(file, entry, ("track_sections", index)) for index, entry in enumerate(entries.track_sections)]
    return RegistryContents(
        fleets=tuple(entry.record() for entry in entries.fleets),
        classes=read_classes(file, len(entries.vehicle_classes)),
        vehicles=tuple(entry.record() for entry in entries.vehicles),
        wheelsets=tuple(entry.record() for entry in entries.wheelsets),
        mountings=tuple(entry.record() for entry in entries.mountings),
        reprofilings=tuple(entry.record() for entry in entries.reprofilings),
        measured_profiles=tuple(
            _measured_profiles(file, entry, ("measured_profiles", index))
            for index, entry in enumerate(entries.measured_profiles)
        ),
        sections=tuple(section for section, _, _ in sections),
        alignments=tuple(alignment for _, alignment, _ in sections if alignment is not None),
        layouts=tuple(layout for _, _, layout in sections if layout is not None),
    )


def _store(path: Path, what: str, records: Sequence[_T], add: Callable[[_T], _R]) -> list[_R]:
    """Add each record; return what that gives."""
    results = []
    for index, record in enumerate(records):
        try:
            results.append(add(record))
        except ParameterError as error:
            raise InputError(error.reason, file=path, field=f"{what}[{index}].{error.field}") from error
        except (NotFoundError, ConflictError) as error:
            raise InputError(str(error), file=path, field=f"{what}[{index}]") from error
    return results


def _measured_profiles(file: InputFile, entry: MeasurementEntry, location: Location) -> MeasuredProfiles:
    """Return the measured profiles of a wheelset; ``location`` is that of its entry."""
    return MeasuredProfiles(
        wheelset=entry.wheelset,
        at_ns=entry.at,
        mileage_km=entry.mileage_km,
        left=_wheel(file, entry.left.file, (*location, "left", "file")),
        right=_wheel(file, entry.right.file, (*location, "right", "file")),
        std=1e-3 * entry.std_mm,
    )


def _wheel(file: InputFile, name: str, location: Location) -> Profile:
    """Return the profile in the file ``name`` beside the registry."""
    try:
        return read_wheel_profile(file.path.parent / name)
    except ProfileError as error:
        raise file.error(str(error), location) from error


def _section(
    file: InputFile, entry: SectionEntry, location: Location
) -> tuple[TrackSectionRecord, TrackAlignment | None, TrackLayout | None]:
    """Return a section with the track that the files of its entry hold; a layout of its own comes before the other."""
    section, folder = entry.record(), file.path.parent
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
    std = np.nan if entry.alignment_std_mm is None else 1e-3 * entry.alignment_std_mm
    return TrackAlignment(
        section=section,
        version=0,
        s=np.linspace(s[0], s[-1], n),
        alignment=alignment,
        alignment_std=np.full(n, std),
        gauge_deviation=gauge,
        gauge_deviation_std=np.full(n, 1e-3 * entry.gauge_deviation_std_mm),
        passes=np.zeros(n, dtype=np.int64),
        status=Status.ESTIMATED if np.isfinite(std) else Status.UNESTIMATED,
    )


def _columns(
    file: InputFile, entry: AlignmentEntry, track_file: Path, location: Location
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return distance, alignment, gauge deviation (n,), m; alignments are NaN in a file of the gauge alone.

    A standard deviation of an alignment that the file does not have is an error: the column may be misspelt.
    """
    if entry.alignment_std_mm is None:
        of_gauge = read_gauge_columns(track_file)
        if of_gauge is None:
            raise file.error("is missing", (*location, "alignment_std_mm"))
        s, gauge = of_gauge.T
        return s, np.full(len(s), np.nan), gauge
    s, alignment, gauge = read_track_columns(track_file).T
    return s, alignment, gauge
