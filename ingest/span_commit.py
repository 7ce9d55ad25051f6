"""The windows of a vehicle in a span become exactly those that were assembled: new, changed, healed, removed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.values.reasons import ReasonCode
from fleet_db.receipts import ChunkRecord
from fleet_db.storage import SqlUnitOfWork
from ingest.align.windows import MountedWindow
from ingest.assembly import Assembler
from ingest.span_assembly import SpanAssembly, registry_lookup


@dataclass(frozen=True, slots=True)
class SpanChanges:
    """How many windows of a span are not as they were.

    Attributes
    ----------
    new, changed, removed
        Windows that were not there, have another content or mileage now, or are none any more.
    healed
        Windows whose file had been lost or damaged.
    quarantined
        Vehicles at which it failed, or that are not due yet after a failure.
    """

    new: int = 0
    changed: int = 0
    removed: int = 0
    healed: int = 0
    quarantined: int = 0

    @property
    def windows(self) -> int:
        """Number of windows that were stored or removed."""
        return self.new + self.changed + self.removed + self.healed

    def __add__(self, other: SpanChanges) -> SpanChanges:
        """Return the sums."""
        return SpanChanges(
            self.new + other.new,
            self.changed + other.changed,
            self.removed + other.removed,
            self.healed + other.healed,
            self.quarantined + other.quarantined,
        )


NO_CHANGES = SpanChanges()


def still_so(
    unit: SqlUnitOfWork, assembler: Assembler, assembly: SpanAssembly, coming: Sequence[ChunkRecord] = ()
) -> bool:
    """Whether recordings and registry are those that an assembly was made from.

    Parameters
    ----------
    unit
        The transaction that will store it.
    assembler
        Made it.
    assembly
        The windows of a span.
    coming
        Receipts of recordings that will be stored with it.
    """
    span = (assembly.from_ns, assembly.to_ns)
    decoded = [receipt for receipt in coming if receipt.first_ns is not None]
    sources = assembler.sources(unit, assembly.vehicle, span, decoded)
    if {source.digest for source in sources} != assembly.sources:
        return False
    return registry_lookup(unit, unit.registry.vehicle(assembly.vehicle), *span) == assembly.lookup


def commit(unit: SqlUnitOfWork, assembly: SpanAssembly, recorded_ns: int, *, verify: bool = False) -> SpanChanges:
    """Make the stored windows of a vehicle in a span those of an assembly.

    Bin tables and positions of windows that are removed go with them; the jobs find what rested on those.

    Parameters
    ----------
    unit
        An open transaction; nothing is committed here.
    assembly
        All windows of the span.
    recorded_ns
        Our time, ns UTC.
    verify
        Whether the files of windows that have not changed are read and checked.
    """
    stored = {
        (record.wheelset, record.start_ns): record
        for record in unit.assembled.of_vehicle(assembly.vehicle, assembly.from_ns, assembly.to_ns)
    }
    wanted = {(each.window.wheelset, each.window.start_ns): each for each in assembly.windows}
    gone = [
        record
        for key, record in stored.items()
        if key not in wanted and not assembly.keeps(record.start_ns, record.length_ns)
    ]
    removed = unit.assembled.remove(gone)
    for record in removed:
        _requeue_partner(unit, record.vehicle, record.axle, record.start_ns)
    changes = sum((_put(unit, each, recorded_ns, verify=verify) for each in assembly.windows), NO_CHANGES)
    return replace(changes, removed=len(removed))


def mileage_km(mounted: MountedWindow) -> float:
    """Return the mileage of a wheelset at the start of a window.

    Parameters
    ----------
    mounted
        The window with its mounting.
    """
    mounting = mounted.mounting
    return mounting.wheelset_mileage_km + (mounted.window.odometer_m / 1000.0 - mounting.vehicle_odometer_km)


def _put(unit: SqlUnitOfWork, mounted: MountedWindow, recorded_ns: int, *, verify: bool) -> SpanChanges:
    window = mounted.window
    before = unit.windows.get(window.wheelset, window.start_ns)
    refused = before is not None and before.reason is not None and before.reason.code is ReasonCode.FILE_DAMAGED
    lost = before is not None and not unit.assembled.intact(before, verify=verify or refused)
    stored = unit.windows.put(window, mileage_km(mounted), recorded_ns)
    unit.plausibility.note_odometer(window.wheelset, window.start_ns, mounted.odometer_excess_m)
    unit.plausibility.note_place(window.wheelset, window.start_ns, mounted.off_line_m)
    after = unit.windows.get(window.wheelset, window.start_ns)
    assert after is not None
    same = before is not None and before.content_digest == after.content_digest
    if same and (lost or refused):
        unit.windows.wait_again(window.wheelset, window.start_ns)
    elif same and not stored:
        return NO_CHANGES
    if not same or lost or refused:
        _requeue_partner(unit, window.vehicle, window.axle, window.start_ns)
    if before is None:
        return SpanChanges(new=1)
    return SpanChanges(healed=1) if same and (lost or refused) else SpanChanges(changed=1)


def _requeue_partner(unit: SqlUnitOfWork, vehicle: str, axle: int, start_ns: int) -> None:
    """Let the window of the other axle in the bogie wait again: it is estimated with the signals of both."""
    on_file = unit.registry.vehicle_class(unit.registry.vehicle(vehicle).vehicle_class)
    partner = None if on_file is None else on_file.vehicle_class.partner(axle)
    if partner is not None:
        unit.windows.requeue_axle(vehicle, partner, start_ns)
