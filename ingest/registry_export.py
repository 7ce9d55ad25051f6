"""The registry written as a file that loads to the same registry again, with the files it names beside it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import InputError
from estimation.values.fields import MM, JsonValue
from estimation.values.reasons import utc_text
from estimation.values.track import TrackAlignment, TrackSectionRecord
from estimation.vehicle.vehicle_class import class_document
from fleet_db.atomic_files import write_atomically
from fleet_db.storage import SqlUnitOfWork
from ingest.file_value import entry_of
from ingest.profiles.stored import SUFFIX, stored_profile_text
from ingest.registry_file import FORMAT
from ingest.track_file import COLUMNS, GAUGE_COLUMNS, LAYOUT_COLUMNS, LINE_COLUMNS

Entry = dict[str, JsonValue]
MOST_VEHICLES = 1 << 31


@dataclass(frozen=True, slots=True)
class ExportedRegistry:
    """A registry as text, and the files that it names by their path beside it."""

    text: str
    files: dict[str, str] = field(default_factory=dict)
    records: int = 0


def export_registry(unit: SqlUnitOfWork, folder: str) -> ExportedRegistry:
    """Return the registry of a store as a file; what was voided is left out.

    The files that it names will be in a folder, relative to the registry file.
    """
    registry, files = unit.registry, _Files(folder)
    serials = [wheelset.serial for wheelset in registry.wheelsets() if not registry.voided(wheelset.serial)]
    wheelsets = [registry.wheelset(serial) for serial in serials]
    vehicles = registry.vehicles_page(None, None, MOST_VEHICLES)
    arrays: dict[str, Sequence[Entry]] = {
        "fleets": [entry_of(fleet) for fleet in registry.fleets()],
        "vehicle_classes": [
            {"recorded": class_document(record.vehicle_class)} for record in registry.vehicle_classes()
        ],
        "vehicles": [entry_of(vehicle) for vehicle in vehicles],
        "wheelsets": [entry_of(wheelset) for wheelset in wheelsets],
        "mountings": [entry_of(mounting) for serial in serials for mounting in registry.mountings(serial)],
        "reprofilings": [entry_of(reprofiling) for wheelset in wheelsets for reprofiling in wheelset.reprofilings],
        "measured_profiles": [
            _measurement(profiles, files) for serial in serials for profiles in registry.measured_profiles(serial)
        ],
        "sensor_changes": [
            entry_of(change) for vehicle in vehicles for change in unit.sensor_changes.list(vehicle.code)
        ],
        "track_sections": [_section(unit, section, files) for section in unit.tracks.sections()],
    }
    filled = {name: list(entries) for name, entries in arrays.items() if entries}
    text = json.dumps({"format": FORMAT, **filled}, indent=1, ensure_ascii=False) + "\n"
    return ExportedRegistry(text, files.content, sum(map(len, filled.values())))


def write_export(path: Path, unit: SqlUnitOfWork) -> ExportedRegistry:
    """Write the registry of a store as a file and the folder ``<name>-files`` beside it; return what was written.

    The registry itself is written last: where it is, it is whole.
    """
    folder = f"{path.stem}-files"
    if path.exists() or (path.parent / folder).exists():
        raise InputError(f"it or the folder {folder!r} exists; give another name", file=path)
    written = export_registry(unit, folder)
    try:
        for name, content in written.files.items():
            write_atomically(path.parent / name, content.encode(), durable=False)
        write_atomically(path, written.text.encode(), durable=True)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror or error}", file=path) from error
    return written


@dataclass(frozen=True, slots=True)
class _Files:
    folder: str
    content: dict[str, str] = field(default_factory=dict)

    def add(self, stem: str, suffix: str, content: str) -> Entry:
        """Add a file; return the entry that names it."""
        name = f"{self.folder}/{len(self.content) + 1}_{quote(stem, safe='')[:100]}{suffix}"
        self.content[name] = content
        return {"file": name}


def _measurement(measured: MeasuredProfiles, files: _Files) -> Entry:
    sides = {
        side: files.add(f"{measured.wheelset}_{side}", SUFFIX, stored_profile_text(profile))
        for side, profile in (("left", measured.left), ("right", measured.right))
    }
    entry: Entry = {"wheelset": measured.wheelset, "at": utc_text(measured.at_ns), "mileage_km": measured.mileage_km}
    return {**entry, **sides, "std_mm": MM.write(measured.std)}


def _section(unit: SqlUnitOfWork, section: TrackSectionRecord, files: _Files) -> Entry:
    entry = entry_of(section)
    if section.tonnage_mgt_per_year is None:
        del entry["tonnage_mgt_per_year"]
    registered = unit.tracks.registered(section.code)
    alignment = None if registered is None else unit.tracks.alignment(section.code, registered)
    if alignment is not None:
        entry["alignment"] = _alignment(alignment, files)
    layout = unit.tracks.layout(section.code)
    if layout is not None:
        curvature, cant = (map(MM.write, values.tolist()) for values in (layout.curvature, layout.cant))
        rows = zip(layout.s.tolist(), curvature, cant, strict=True)
        entry["layout"] = files.add(f"{section.code}_layout", ".csv", _csv((COLUMNS[0], *LAYOUT_COLUMNS), rows))
    if section.line is not None:
        entry["coordinates"] = files.add(f"{section.code}_coordinates", ".csv", _csv(LINE_COLUMNS, section.line))
    return entry


def _alignment(alignment: TrackAlignment, files: _Files) -> Entry:
    """Return the entry of an alignment; one of the gauge alone has no standard deviation."""
    gauge = map(MM.write, alignment.gauge_deviation.tolist())
    gauge_std = MM.write(float(alignment.gauge_deviation_std[0]))
    s, std = alignment.s.tolist(), float(alignment.alignment_std[0])
    if std != std:  # noqa: PLR0124 - NaN
        content = _csv(GAUGE_COLUMNS, zip(s, gauge, strict=True))
        return {**files.add(alignment.section, ".csv", content), "gauge_deviation_std_mm": gauge_std}
    content = _csv(COLUMNS, zip(s, map(MM.write, alignment.alignment.tolist()), gauge, strict=True))
    stds: Entry = {"alignment_std_mm": MM.write(std), "gauge_deviation_std_mm": gauge_std}
    return {**files.add(alignment.section, ".csv", content), **stds}


def _csv(columns: Sequence[str], rows: Iterator[tuple[float, ...]] | Sequence[tuple[float, ...]]) -> str:
    lines = [",".join(map(repr, row)) for row in rows]
    return "\n".join([",".join(columns), *lines]) + "\n"
