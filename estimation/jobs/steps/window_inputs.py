"""What a batch of windows is estimated with besides samples and alignment, read for all of them together.

It is read again in the transaction that stores their results: where it is another by then, a window waits again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimation.jobs.isolation import fails_alone
from estimation.jobs.steps.vehicle_classes import Assumed, ClassLookup
from estimation.jobs.steps.vehicle_lookup import VehicleLookup
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason
from estimation.values.registry import Mounting
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
