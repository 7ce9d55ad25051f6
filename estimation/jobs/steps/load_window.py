"""What a window is read with: its samples as its vehicle's class reads them, and what is on file of it.

Blows are bridged, with gravity and the yaw of the bogie's frame, as of a vehicle that runs forward. What is on file is
read again in the transaction that stores results where it may be another by then: then a window waits again.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.errors import DamagedError, NotFoundError, PurgedError
from estimation.jobs.job import JobContext
from estimation.jobs.parameters import WORK
from estimation.jobs.steps.assumptions import Assumed, ClassLookup
from estimation.motion.axle_distance import (
    bogie_runs_backwards,
    check_axle_distance,
    check_frame_sensors,
    turned_over,
    with_frame_yaw,
)
from estimation.motion.checks import runs_backwards
from estimation.motion.without_blows import without_blows
from estimation.storage import UnitOfWork
from estimation.values.opinions import FRICTION
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.registry import Mounting, mounting_of
from estimation.values.roll_up import MOST_CHOSEN
from estimation.values.runs import FAILED, Facet, SubjectKind
from estimation.values.track import Correction, TrackAlignment, TrackLayout
from estimation.values.units import LATEST_NS
from estimation.values.windows import (
    Window,
    WindowKey,
    WindowPosition,
    WindowRecord,
    WindowState,
    key_of_text,
    text_of_key,
)
from estimation.vehicle.vehicle_class import VehicleClass

FACETS = (Facet.REGISTRY, Facet.PLACES, Facet.WINDOWS, FRICTION)
"""Of wheelsets, vehicles and sections: one is raised with whatever a window is estimated with."""
Stretches = tuple[tuple[float, float], ...]  # from and to, m


def load_window(unit: UnitOfWork, record: WindowRecord, vehicle_class: VehicleClass) -> Window | Reason:
    """Return a stored window as :meth:`WindowLoader.load` does."""
    return WindowLoader(unit).load(record, vehicle_class)


@dataclass(frozen=True, slots=True)
class WindowLoader:
    """Loads windows, as one transaction sees them; the last ones are kept for the other of their bogie."""

    unit: UnitOfWork
    # records that the transaction has read; others are looked up
    known: Mapping[WindowKey, WindowRecord] = field(default_factory=dict)
    _kept: dict[WindowKey, Window] = field(default_factory=dict)

    def load(self, record: WindowRecord, vehicle_class: VehicleClass) -> Window | Reason:
        """Return a stored window as its vehicle's class reads it, or why it is not to be used.

        The registry may have another wheelset there by now, while the window is still to be made again, or cannot be;
        the bogie's frame may be unknown or another.

        Raises:
            PurgedError: The samples of the window have been purged.
            DamagedError: The samples of the window, or of the one on the other axle, are damaged; names the file.
        """
        window = self._samples(record.key)
        elsewhere = self._elsewhere(window)
        if elsewhere is not None:
            return elsewhere
        if window.measures_gravity != vehicle_class.sensors.measures_gravity:
            window = replace(window, measures_gravity=vehicle_class.sensors.measures_gravity)
        partner_axle = vehicle_class.partner(record.axle)
        if partner_axle is None:
            return self._as_it_travels(window, record)
        partner = self._partner(record, partner_axle)
        if isinstance(partner, Reason):
            return partner
        if partner.sample_interval_s != window.sample_interval_s or len(partner.valid) != len(window.valid):
            return _unknown(partner_axle, "is sampled otherwise")
        return self._in_bogie(window, replace(partner, measures_gravity=window.measures_gravity), record)

    def _in_bogie(self, window: Window, partner: Window, record: WindowRecord) -> Window | Reason:
        """Return the window of one axle of a bogie with the yaw of their frame, or what contradicts the registry."""
        offsets = self.unit.registry.vehicle(record.vehicle).axle_offsets_m
        behind = offsets[record.axle - 1]
        ahead = offsets[partner.axle - 1] - behind
        backwards = bogie_runs_backwards(window, partner, ahead)
        contradiction = check_axle_distance(window, partner, -ahead if backwards else ahead)
        refusal = contradiction or check_frame_sensors(window, partner)
        if refusal is not None:
            return refusal
        framed = with_frame_yaw(window, partner, ahead)
        return turned_over(framed, behind) if backwards else framed

    def _as_it_travels(self, window: Window, record: WindowRecord) -> Window:
        """Return the window of a single wheelset as one of a vehicle that runs forward.

        A node that alone says that the vehicle runs backwards is the wrong way round itself.
        """
        if not runs_backwards(window):
            return window
        vehicle = self.unit.registry.vehicle(record.vehicle)
        others = [runs_backwards(other) for other in self._others(window, vehicle.axles)]
        if others.count(False) > others.count(True):
            return window
        return turned_over(window, vehicle.axle_offsets_m[record.axle - 1])

    def _others(self, window: Window, axles: int) -> Iterator[Window]:
        """Yield what the other nodes of the vehicle measured at the time of a window."""
        for axle in range(1, axles + 1):
            mounting = self.unit.registry.mounting_at(window.vehicle, axle, window.start_ns)
            if axle == window.axle or mounting is None:
                continue
            try:
                other = self._samples((mounting.wheelset, window.start_ns))
            except (NotFoundError, PurgedError, DamagedError):
                continue
            if other.vehicle == window.vehicle:
                yield replace(other, measures_gravity=window.measures_gravity)

    def _samples(self, key: WindowKey) -> Window:
        """Return a window as it is stored, but for blows."""
        if key not in self._kept:
            record = self.known.get(key)
            window = self.unit.windows.load(*key) if record is None else self.unit.windows.samples(record)
            window = without_blows(window)
            if len(self._kept) >= WORK.loaded_windows:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = window
        return self._kept[key]

    def _elsewhere(self, window: Window) -> Reason | None:
        """Return that the wheelset of a window was not at its axle, from its first valid sample to its last."""
        valid = np.flatnonzero(window.valid)
        first, last = (int(valid[0]), int(valid[-1])) if len(valid) else (0, len(window.valid) - 1)
        for place in (first, last):
            at_ns = window.start_ns + place * window.length_ns // len(window.valid)
            mounting = self.unit.registry.mounting_at(window.vehicle, window.axle, at_ns)
            if mounting is None or mounting.wheelset != window.wheelset:
                there = "no wheelset" if mounting is None else f"wheelset {mounting.wheelset}"
                text = f"the registry has {there} at axle {window.axle} of vehicle {window.vehicle} then"
                return Reason(ReasonCode.MOUNTING_DIFFERS, text)
        return None

    def _partner(self, record: WindowRecord, axle: int) -> Window | Reason:
        mounting = self.unit.registry.mounting_at(record.vehicle, axle, record.start_ns)
        if mounting is None:
            return _unknown(axle, "has no wheelset on file")
        try:
            partner = self._samples((mounting.wheelset, record.start_ns))
        except NotFoundError:
            return _unknown(axle, "has no window of this time")
        except PurgedError:
            return _unknown(axle, "has no samples of this time any more")
        if (partner.vehicle, partner.axle) != (record.vehicle, axle):
            return _unknown(axle, f"has no window of this time of wheelset {mounting.wheelset}")
        return partner


def _unknown(axle: int, why: str) -> Reason:
    return Reason(ReasonCode.FRAME_UNKNOWN, f"the other axle of the bogie, axle {axle}, {why}")


CAUSE = "the file of a window is lost or damaged"


def assemble_if_lost(unit: UnitOfWork, record: WindowRecord, refusal: Reason) -> None:
    """Let the windows of a vehicle at a time be made again where one was refused for its file."""
    if refusal.code is ReasonCode.FILE_DAMAGED:
        unit.stale_spans.add(record.vehicle, record.start_ns, record.start_ns + record.length_ns, CAUSE)


def correction_of(record: WindowRecord, at: WindowPosition | None) -> Correction | None:
    """Return by what the position of a window is corrected; None where it was not found from these samples."""
    if at is None or at.content_digest != record.content_digest:
        return None
    return Correction(at.offset_m, at.scale, at.middle_m)


@dataclass(frozen=True, slots=True)
class WindowInputs:
    """What a window is estimated with."""

    position: WindowPosition | None  # where it was, if that has been looked at
    layout: int | None  # version of the layout of its section
    assumed: Assumed | Reason  # of its vehicle
    mounting: Mounting | None  # at its begin
    partner: str | None  # digest of the window on the other axle of the bogie
    low_adhesion: Stretches = ()  # stretches of its section that surely had little friction

    @property
    def mounted_reversed(self) -> bool:
        """Whether the wheelset is mounted the other way round."""
        return self.mounting is not None and self.mounting.reversed

    def correction(self, record: WindowRecord) -> Correction | None:
        """Return by what the position is corrected; None where it was not found from these samples."""
        return correction_of(record, self.position)


@dataclass(frozen=True, slots=True)
class Facts:
    """Subjects of which something is read for windows of a batch, with the sums of their versions then.

    Those of other wheelsets of the vehicles are counted as well: one may be on the other axle of a bogie.
    """

    subjects: frozenset[tuple[SubjectKind, str]]
    vehicles: frozenset[str]
    versions: tuple[int, int]

    def are_same(self, unit: UnitOfWork) -> bool:
        """Return whether nothing that was read is another by now."""
        return unit.marks.versions(self.subjects, self.vehicles, FACETS) == self.versions


def _facts(unit: UnitOfWork, records: Sequence[WindowRecord]) -> Facts:
    vehicles = frozenset(record.vehicle for record in records)
    subjects = {(SubjectKind.WHEELSET, record.wheelset) for record in records}
    subjects |= {(SubjectKind.VEHICLE, vehicle) for vehicle in vehicles}
    subjects |= {(SubjectKind.SECTION, record.track_section or "") for record in records}
    return Facts(frozenset(subjects), vehicles, unit.marks.versions(subjects, vehicles, FACETS))


@dataclass(frozen=True, slots=True)
class BatchInputs:
    """What the windows of a batch are estimated with, as one transaction sees it."""

    unit: UnitOfWork
    records: Mapping[WindowKey, WindowRecord]  # of the windows and of those on the other axles of their bogies
    facts: Facts  # what all of this is of
    found: Mapping[WindowKey, WindowInputs]
    versions: Mapping[WindowKey, int | None]  # of the alignment, on which the windows of epochs are estimated

    def alignment(self, record: WindowRecord) -> TrackAlignment | None:
        """Return the alignment that a window is estimated on: that of its epoch, else the one in force."""
        section = record.track_section
        if section is None:
            return None
        if record.key not in self.versions:
            return self.unit.tracks.alignment(section)
        version = self.versions[record.key]
        return None if version is None else self.unit.tracks.alignment(section, version)

    def layout(self, record: WindowRecord) -> TrackLayout | None:
        """Return the layout of a window's section; None where there is none."""
        return None if record.track_section is None else self.unit.tracks.layout(record.track_section)


def inputs_of_batch(unit: UnitOfWork, records: Sequence[WindowRecord], classes: ClassLookup) -> BatchInputs:
    """Return what windows are estimated with."""
    # before records of the registry are read: those that were read earlier may be of the time before
    facts = _facts(unit, records)
    mountings = {code: unit.registry.mountings_on(code, 0, LATEST_NS) for code in facts.vehicles}
    positions = unit.tracks.positions([record.key for record in records])
    sections = {record.track_section for record in records} - {None}
    layouts = {section: unit.tracks.layout_version(section) for section in sorted(filter(None, sections))}
    low = low_adhesion(unit, records)
    classes.look_up([record.wheelset for record in records])
    assumed = {record.key: classes.assumed(record.vehicle, record.wheelset) for record in records}
    partners = {record.key: _partner_key(mountings[record.vehicle], record, assumed[record.key]) for record in records}
    missing = sorted({key for key in partners.values() if key is not None} - {record.key for record in records})
    known = {record.key: record for record in [*records, *(unit.windows.several(missing) if missing else ())]}
    found = {}
    for record in records:
        key, partner = record.key, partners[record.key]
        found[key] = WindowInputs(
            positions.get(key),
            None if record.track_section is None else layouts[record.track_section],
            assumed[key],
            mounting_of(mountings[record.vehicle], record.axle, record.start_ns),
            known[partner].content_digest if partner in known else None,
            low.get(key, ()),
        )
    return BatchInputs(unit, known, facts, found, unit.epochs.alignment_versions(list(found)))


def low_adhesion(unit: UnitOfWork, records: Sequence[WindowRecord]) -> Mapping[WindowKey, Stretches]:
    """Return where the sections of windows surely had little friction: one statement for each section."""
    found: dict[WindowKey, Stretches] = {}
    for section in sorted({record.track_section for record in records} - {None}, key=str):
        own = [record for record in records if record.track_section == section]
        stretches = certain_stretches(unit, str(section), [record.start_ns for record in own])
        found |= {record.key: stretches[record.start_ns] for record in own}
    return found


def certain_stretches(unit: UnitOfWork, section: str, starts: Sequence[int]) -> Mapping[int, Stretches]:
    """Return the stretches of certainly low friction of a section at some times."""
    hours = unit.adhesion.during(section, min(starts), max(starts)) if starts else ()
    return {
        start_ns: next((hour.certain_stretches for hour in hours if hour.from_ns <= start_ns <= hour.to_ns), ())
        for start_ns in starts
    }


def _partner_key(mountings: Sequence[Mounting], record: WindowRecord, assumed: Assumed | Reason) -> WindowKey | None:
    """Return the key that the window on the other axle of the bogie has; None without one."""
    axle = None if isinstance(assumed, Reason) else assumed.window_parameters.vehicle_class.partner(record.axle)
    mounting = None if axle is None else mounting_of(mountings, axle, record.start_ns)
    return None if mounting is None else (mounting.wheelset, record.start_ns)


@dataclass(frozen=True, slots=True)
class TableInputs:
    """A window, and what it is estimated with."""

    record: WindowRecord
    inputs: WindowInputs
    facts: Facts = field(metadata={"made_from": False})
    # as its vehicle's class reads it, or why it is not to be used
    window: Window | Reason = field(metadata={"made_from": False})
    track: TrackAlignment | None = field(metadata={"made_from": False})
    layout: TrackLayout | None = field(metadata={"made_from": False})
    rolls: bool  # whether somebody will ask for what it says of its rolling radius


def load_windows(unit: UnitOfWork, keys: Sequence[str], context: JobContext) -> Mapping[str, TableInputs]:
    """Return windows that wait or failed, with what they are estimated with; the others are left out."""
    standing = unit.windows.several([key_of_text(key) for key in keys])
    waiting = (one for one in standing if one.state is WindowState.PENDING or code_of(one.reason) in FAILED)
    # the windows of a bogie next to each other: each needs the samples of the other
    records = sorted(waiting, key=lambda record: (record.vehicle, record.start_ns, record.axle))
    if not records:
        return {}
    batch = inputs_of_batch(unit, records, ClassLookup(unit, context.settings.estimation))
    loader = WindowLoader(unit, batch.records)
    chosen, inputs = likely_chosen(unit, records), {}
    for record in records:
        found = batch.found[record.key]
        inputs[text_of_key(*record.key)] = TableInputs(
            record=record,
            inputs=found,
            facts=batch.facts,
            window=_window(loader, record, found.assumed),
            track=batch.alignment(record),
            layout=batch.layout(record),
            rolls=record.key in chosen,
        )
    return inputs


def _window(loader: WindowLoader, record: WindowRecord, assumed: Assumed | Reason) -> Window | Reason:
    if record.implausible is not None:
        return record.implausible
    if isinstance(assumed, Reason):
        return assumed
    try:
        return loader.load(record, assumed.window_parameters.vehicle_class)
    except DamagedError as error:
        return Reason(ReasonCode.FILE_DAMAGED, str(error))  # names the file; the other windows go on


def likely_chosen(unit: UnitOfWork, records: Sequence[WindowRecord]) -> set[WindowKey]:
    """Return which windows of a batch would be chosen beside those of the newest roll-up of their wheelset."""
    of_wheelset: defaultdict[str, list[WindowRecord]] = defaultdict(list)
    for record in records:
        if not record.quality.hunting.sustained:
            of_wheelset[record.wheelset].append(record)
    stored = unit.roll_ups.newest_chosen(sorted(of_wheelset)) if of_wheelset else {}
    found: set[WindowKey] = set()
    for wheelset, several in of_wheelset.items():
        digests = {*stored.get(wheelset, ()), *(record.content_digest for record in several)}
        smallest = set(sorted(digests)[:MOST_CHOSEN])
        found |= {record.key for record in several if record.content_digest in smallest}
    return found
