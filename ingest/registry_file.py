"""The operator's registry as a JSON file: what runs where, and the track it runs on. ``docs/registry.md`` describes it.

The whole file is read and checked before the first record is written, and every write is an upsert: loading the same
file again changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from estimation.contact.profiles import MeasuredProfiles, Profile
from estimation.errors import ConflictError, InputError, NotFoundError, ProfileError
from estimation.storage import UnitOfWork
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.registry import FleetRecord, Mounting, Reprofiling, VehicleRecord, WheelsetRecord
from estimation.values.track import TrackAlignment, TrackLayout, TrackSectionRecord
from ingest.json_fields import Fields, read_json
from ingest.profiles.wheel_profile import read_wheel_profile
from ingest.track_file import (
    LAYOUT_COLUMNS,
    read_gauge_columns,
    read_layout_columns,
    read_track_columns,
    uniform_distance,
)

FORMAT = "treadwatch-registry-1"
MOST_AXLES = 8
LEAST_LAID_OUT = 0.5  # of a section that its layout must reach
PROFILES_STD_MM = 0.1  # of the lateral displacement that follows from measured profiles
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class RegistryContents:
    """Everything a registry file holds, checked but not yet stored."""

    fleets: tuple[FleetRecord, ...]
    vehicles: tuple[VehicleRecord, ...]
    wheelsets: tuple[WheelsetRecord, ...]
    mountings: tuple[Mounting, ...]
    reprofilings: tuple[Reprofiling, ...]
    measured_profiles: tuple[MeasuredProfiles, ...]
    sections: tuple[TrackSectionRecord, ...]
    alignments: tuple[TrackAlignment, ...]
    layouts: tuple[TrackLayout, ...]


def load_registry(path: Path, unit_of_work: UnitOfWork) -> RegistryContents:
    """Read a registry file and store it through the registry and the tracks of ``unit_of_work``; return what it held.

    Raises
    ------
    InputError
        The file, a track file or a profile file cannot be read, a field is missing, unknown or impossible, or a record
        refers to something that neither the file nor the store knows; nothing has been committed then.
    """
    contents = read_registry(path)
    registry, tracks = unit_of_work.registry, unit_of_work.tracks
    _store(path, "fleets", contents.fleets, registry.add_fleet)
    _store(path, "vehicles", contents.vehicles, registry.add_vehicle)
    _store(path, "wheelsets", contents.wheelsets, registry.add_wheelset)
    _store(path, "mountings", contents.mountings, registry.add_mounting)
    _store(path, "reprofilings", contents.reprofilings, registry.add_reprofiling)
    _store(path, "measured_profiles", contents.measured_profiles, registry.add_measured_profiles)
    _store(path, "track_sections", contents.sections, tracks.add_section)
    _store(path, "track_sections", contents.alignments, lambda known: _add_alignment(unit_of_work, known))
    _store(path, "track_sections", contents.layouts, lambda layout: _add_layout(unit_of_work, layout))
    return contents


def _add_alignment(unit_of_work: UnitOfWork, alignment: TrackAlignment) -> None:
    """Store an alignment; where it takes the place of another, let the windows of the section be looked at again.

    Where they were had been found against that other one, which may lie some metres off.
    """
    tracks = unit_of_work.tracks
    before = tracks.in_force(alignment.section)
    version = tracks.add_alignment(alignment)
    if before is not None and version > before.version:
        tracks.forget_positions(alignment.section)
        unit_of_work.windows.requeue_section(alignment.section)


def _add_layout(unit_of_work: UnitOfWork, layout: TrackLayout) -> None:
    """Store a layout; where it is another than before, let the windows of the section be estimated again."""
    before = unit_of_work.tracks.layout(layout.section)
    version = unit_of_work.tracks.add_layout(layout)
    if before is None or before.version != version:
        unit_of_work.windows.requeue_section(layout.section)


def read_registry(path: Path) -> RegistryContents:
    """Read and check a registry file and the files it names; raises ``InputError`` as ``load_registry`` does."""
    root = read_json(path)
    if root.text("format") != FORMAT:
        raise root.fail(f"must be {FORMAT!r}", "format")
    sections, alignments, layouts = _sections(root, path)
    contents = RegistryContents(
        fleets=_each(root, "fleets", _fleet),
        vehicles=_each(root, "vehicles", _vehicle),
        wheelsets=_each(root, "wheelsets", _wheelset),
        mountings=_each(root, "mountings", _mounting),
        reprofilings=_each(root, "reprofilings", _reprofiling),
        measured_profiles=_each(root, "measured_profiles", partial(_measured_profiles, folder=path.parent)),
        sections=sections,
        alignments=alignments,
        layouts=layouts,
    )
    root.end()
    return contents


def _store(path: Path, what: str, records: Sequence[_T], add: Callable[[_T], object]) -> None:
    for index, record in enumerate(records):
        try:
            add(record)
        except (NotFoundError, ConflictError) as error:
            raise InputError(str(error), file=path, field=f"{what}[{index}]") from error


def _each(root: Fields, key: str, read: Callable[[Fields], _T]) -> tuple[_T, ...]:
    records = []
    for fields in root.objects(key):
        records.append(read(fields))
        fields.end()
    return tuple(records)


def _fleet(fields: Fields) -> FleetRecord:
    return FleetRecord(fields.text("code"), fields.text("name"))


def _vehicle(fields: Fields) -> VehicleRecord:
    axles = fields.integer("axles", low=1, high=MOST_AXLES)
    offsets = fields.numbers("axle_offsets_m")
    if len(offsets) != axles:
        raise fields.fail(f"{len(offsets)} offsets for {axles} axles", "axle_offsets_m")
    return VehicleRecord(
        code=fields.text("code"),
        fleet=fields.text("fleet"),
        vehicle_class=fields.text("vehicle_class"),
        axles=axles,
        max_speed_m_s=fields.number("max_speed_km_h", low=1.0, high=600.0) / 3.6,
        axle_offsets_m=offsets,
    )


def _wheelset(fields: Fields) -> WheelsetRecord:
    return WheelsetRecord(
        serial=fields.text("serial"),
        fleet=fields.text("fleet"),
        wheel_profile=fields.text("wheel_profile"),
        nominal_radius_m=1e-3 * fields.number("nominal_radius_mm", low=100.0, high=1000.0),
        mounting=None,
    )


def _mounting(fields: Fields) -> Mounting:
    mounting = Mounting(
        wheelset=fields.text("wheelset"),
        vehicle=fields.text("vehicle"),
        axle=fields.integer("axle", low=1, high=MOST_AXLES),
        from_ns=fields.moment_ns("from"),
        to_ns=fields.optional_moment_ns("to"),
        vehicle_odometer_km=fields.number("vehicle_odometer_km"),
        wheelset_mileage_km=fields.number("wheelset_mileage_km"),
        reversed=fields.flag("reversed", default=False),
    )
    if mounting.to_ns is not None and mounting.to_ns <= mounting.from_ns:
        raise fields.fail("must be later than 'from'", "to")
    return mounting


def _reprofiling(fields: Fields) -> Reprofiling:
    return Reprofiling(
        wheelset=fields.text("wheelset"),
        at_ns=fields.moment_ns("at"),
        mileage_km=fields.number("mileage_km"),
        note=fields.text("note", ""),
    )


def _measured_profiles(fields: Fields, folder: Path) -> MeasuredProfiles:
    std_mm = fields.number("std_mm", PROFILES_STD_MM)
    if std_mm == 0.0:
        raise fields.fail("must be greater than 0", "std_mm")
    return MeasuredProfiles(
        wheelset=fields.text("wheelset"),
        at_ns=fields.moment_ns("at"),
        mileage_km=fields.number("mileage_km"),
        left=_wheel(fields.one_object("left"), folder),
        right=_wheel(fields.one_object("right"), folder),
        std=1e-3 * std_mm,
    )


def _wheel(fields: Fields, folder: Path) -> Profile:
    file = folder / fields.text("file")
    fields.end()
    try:
        return read_wheel_profile(file)
    except ProfileError as error:
        raise fields.fail(str(error), "file") from error


def _sections(
    root: Fields, path: Path
) -> tuple[tuple[TrackSectionRecord, ...], tuple[TrackAlignment, ...], tuple[TrackLayout, ...]]:
    sections, alignments, layouts = [], [], []
    for fields in root.objects("track_sections"):
        section = TrackSectionRecord(
            code=fields.text("code"),
            number=fields.integer("number", low=1, high=65534),
            name=fields.text("name"),
            rail_profile=fields.text("rail_profile"),
            rail_inclination=fields.number("rail_inclination", high=0.5),
            nominal_gauge_m=1e-3 * fields.number("nominal_gauge_mm", low=500.0, high=2000.0),
            length_m=fields.number("length_m", low=1.0),
        )
        known, curves = fields.optional_object("alignment"), fields.optional_object("layout")
        fields.end()
        sections.append(section)
        layout = None
        if known is not None:
            alignments.append(_alignment(known, section.code, path.parent))
            layout = _layout(path.parent / known.text("file"), section)
            known.end()
        if curves is not None:
            file = path.parent / curves.text("file")
            curves.end()
            layout = _layout(file, section)
            if layout is None:
                raise InputError(f"no such column; expected s_m, {', '.join(LAYOUT_COLUMNS)}", file=file, line=1)
        if layout is not None:
            layouts.append(layout)
    return tuple(sections), tuple(alignments), tuple(layouts)


def _layout(file: Path, section: TrackSectionRecord) -> TrackLayout | None:
    columns = read_layout_columns(file)
    if columns is None:
        return None
    last = float(columns[-1, 0])
    if last < LEAST_LAID_OUT * section.length_m or last > section.length_m / LEAST_LAID_OUT:
        reason = f"ends at {last:g} m, section {section.code!r} has {section.length_m:g} m; another unit or section?"
        raise InputError(reason, file=file, field="s_m")
    return TrackLayout(section.code, 0, *columns.T)


def _alignment(fields: Fields, section: str, folder: Path) -> TrackAlignment:
    file = folder / fields.text("file")
    s, alignment, gauge, std = _columns(fields, file)
    if not uniform_distance(s):
        raise InputError("distances must be evenly spaced", file=file, field="s_m")
    n = len(s)
    return TrackAlignment(
        section=section,
        version=0,
        s=np.linspace(s[0], s[-1], n),
        alignment=alignment,
        alignment_std=np.full(n, std),
        gauge_deviation=gauge,
        gauge_deviation_std=np.full(n, 1e-3 * fields.number("gauge_deviation_std_mm")),
        passes=np.zeros(n, dtype=np.int64),
        status=Status.ESTIMATED if np.isfinite(std) else Status.UNESTIMATED,
    )


def _columns(fields: Fields, file: Path) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return distance, alignment, gauge deviation (n,) and the std of the alignment, m; NaN where it is of gauge alone.

    A std of an alignment that the file has not is an error, for a misspelt column would be taken for none.
    """
    of_gauge = None if fields.has("alignment_std_mm") else read_gauge_columns(file)
    if of_gauge is not None:
        s, gauge = of_gauge.T
        return s, np.full(len(s), np.nan), gauge, float("nan")
    std = 1e-3 * fields.number("alignment_std_mm")
    s, alignment, gauge = read_track_columns(file).T
    return s, alignment, gauge, std
