"""What a batch of windows is estimated with besides samples and alignment, read for all of them together.

It is read again in the transaction that stores their results: where it is another by then, a window waits again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from estimation.jobs.isolation import fails_alone
from estimation.jobs.steps.vehicle_classes import Assumed, ClassLookup, VehicleLookup
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason
from estimation.values.registry import Mounting
from estimation.values.track import AlignmentRecord, TrackAlignment, TrackLayout
from estimation.values.windows import WindowKey, WindowPosition, WindowRecord


@dataclass(frozen=True, slots=True)
class WindowInputs:
    """What a window is estimated with."""

    position: WindowPosition | None  # where it was, if that has been looked at
    layout: int | None  # version of the layout of its section
    assumed: Assumed | Reason  # of its vehicle
    mounting: Mounting | None  # at its begin
    partner: str | None  # digest of the window on the other axle of the bogie
    low_adhesion: tuple[tuple[float, float], ...] = ()  # m, stretches of its section that surely had little friction


@dataclass(frozen=True, slots=True)
class BatchInputs:
    """What the windows of a batch are estimated with, as one transaction sees it.

    Attributes:
        vehicles: Of the transaction.
        records: Of the windows and of those on the other axles of their bogies.
    """

    vehicles: VehicleLookup
    records: Mapping[WindowKey, WindowRecord]
    _found: Mapping[WindowKey, WindowInputs | Exception]

    def of(self, key: WindowKey) -> WindowInputs:
        """Return what a window of the batch is estimated with.

        Raises:
            Exception: It could not be read for this window.
        """
        found = self._found[key]
        if isinstance(found, Exception):
            raise found
        return found


def inputs_of_batch(unit: UnitOfWork, records: Sequence[WindowRecord], classes: ClassLookup) -> BatchInputs:
    """Return what windows are estimated with.

    Args:
        classes: Of the same transaction.
    """
    vehicles = VehicleLookup(unit)
    positions = unit.tracks.positions([record.key for record in records])
    sections = {record.track_section for record in records} - {None}
    layouts = {section: unit.tracks.layout_version(section) for section in sorted(filter(None, sections))}
    low = _low_adhesion(unit, records)
    classes.look_up([record.wheelset for record in records])
    assumed = {record.key: _assumed(classes, record) for record in records}
    partners = {record.key: _partner(vehicles, record, assumed[record.key]) for record in records}
    missing = sorted({key for key in partners.values() if key is not None} - {record.key for record in records})
    known = {record.key: record for record in [*records, *(unit.windows.several(missing) if missing else ())]}
    found: dict[WindowKey, WindowInputs | Exception] = {}
    for record in records:
        key = record.key
        of_vehicle, partner = assumed[key], partners[key]
        if isinstance(of_vehicle, Exception):
            found[key] = of_vehicle
            continue
        found[key] = WindowInputs(
            positions.get(key),
            None if record.track_section is None else layouts[record.track_section],
            of_vehicle,
            vehicles.mounting_at(record.vehicle, record.axle, record.start_ns),
            known[partner].content_digest if partner in known else None,
            low.get(key, ()),
        )
    return BatchInputs(vehicles, known, found)


def _low_adhesion(
    unit: UnitOfWork, records: Sequence[WindowRecord]
) -> Mapping[WindowKey, tuple[tuple[float, float], ...]]:
    """Return where the sections of windows surely had little friction, m: one statement for each section."""
    found: dict[WindowKey, tuple[tuple[float, float], ...]] = {}
    for section in sorted({record.track_section for record in records} - {None}, key=str):
        own = [record for record in records if record.track_section == section]
        starts = [record.start_ns for record in own]
        known = unit.adhesion.during(str(section), min(starts), max(starts))
        for record in own:
            hours = (one for one in known if one.from_ns <= record.start_ns <= one.to_ns)
            newest = next(hours, None)
            found[record.key] = () if newest is None else newest.certain_stretches
    return found


def _assumed(classes: ClassLookup, record: WindowRecord) -> Assumed | Reason | Exception:
    """Return what is assumed of a window's vehicle, or what was raised: the other windows of the batch go on."""
    try:
        return classes.assumed(record.vehicle, record.wheelset)
    except Exception as error:
        if not fails_alone(error):
            raise
        return error


def _partner(vehicles: VehicleLookup, record: WindowRecord, assumed: Assumed | Reason | Exception) -> WindowKey | None:
    """Return the key that the window on the other axle of the bogie has; None without one."""
    axle = assumed.windows.vehicle_class.partner(record.axle) if isinstance(assumed, Assumed) else None
    mounting = None if axle is None else vehicles.mounting_at(record.vehicle, axle, record.start_ns)
    return None if mounting is None else (mounting.wheelset, record.start_ns)


@dataclass(frozen=True, slots=True)
class TrackLookup:
    """Looks up sections; each version of an alignment is read once.

    Attributes:
        unit: Sections are read.
        versions: By window, on which versions those of epochs are estimated.
    """

    unit: UnitOfWork
    versions: Mapping[WindowKey, int | None]
    _in_force: dict[str, AlignmentRecord | None] = field(default_factory=dict)
    _alignments: dict[tuple[str, int], TrackAlignment | None] = field(default_factory=dict)
    _layouts: dict[str, TrackLayout | None] = field(default_factory=dict)

    def in_force(self, record: WindowRecord) -> AlignmentRecord | None:
        """Return which alignment of a window's section is in force; None where none is, or the section is not known."""
        section = record.track_section
        if section is None:
            return None
        if section not in self._in_force:
            self._in_force[section] = self.unit.tracks.in_force(section)
        return self._in_force[section]

    def alignment(self, record: WindowRecord) -> TrackAlignment | None:
        """Return the alignment that a window is estimated on; None where there is none."""
        now, section = self.in_force(record), record.track_section
        version = self.versions.get(record.key, None if now is None else now.version)
        if section is None or version is None:
            return None
        if (section, version) not in self._alignments:
            self._alignments[section, version] = self.unit.tracks.alignment(section, version)
        return self._alignments[section, version]

    def layout(self, record: WindowRecord) -> TrackLayout | None:
        """Return the layout of a window's section; None where there is none."""
        section = record.track_section
        if section is None:
            return None
        if section not in self._layouts:
            self._layouts[section] = self.unit.tracks.layout(section)
        return self._layouts[section]


def tracks_of_batch(unit: UnitOfWork, records: Sequence[WindowRecord]) -> TrackLookup:
    """Return the look-up of the sections of some windows."""
    return TrackLookup(unit, unit.epochs.alignment_versions([record.key for record in records]))
