"""The windows of a vehicle in a span become exactly those that were assembled: new, changed, healed, removed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from estimation.values.reasons import ReasonCode
from estimation.values.windows import Window, WindowKey, WindowRecord
from fleet_db.records import ChunkRecord
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.assembled import AssembledWindow, StoredWindow
from fleet_db.telemetry import window_digest
from ingest.align.windows import MountedWindow
from ingest.assembly import Assembler, SpanAssembly, registry_lookup
from ingest.codec import Counts


@dataclass(frozen=True, slots=True)
class SpanChanges(Counts):
    """How many windows of a span are not as they were."""

    new: int = 0
    changed: int = 0  # in content or mileage
    removed: int = 0
    healed: int = 0  # their file had been lost or damaged
    quarantined: int = 0  # vehicles at which it failed, or that are not due yet after a failure

    @property
    def windows(self) -> int:
        """Number of windows that were stored or removed."""
        return self.new + self.changed + self.removed + self.healed


NO_CHANGES = SpanChanges()


def still_so(
    unit: SqlUnitOfWork, assembler: Assembler, assembly: SpanAssembly, coming: Sequence[ChunkRecord] = ()
) -> bool:
    """Whether recordings and registry are those that an assembly was made from.

    ``coming`` are receipts of recordings that will be stored with it.
    """
    span = (assembly.from_ns, assembly.to_ns)
    decoded = [receipt for receipt in coming if receipt.first_ns is not None]
    sources = assembler.sources(unit, assembly.vehicle, span, decoded)
    if {source.digest for source in sources} != assembly.sources:
        return False
    return registry_lookup(unit, unit.registry.vehicle(assembly.vehicle), *span) == assembly.lookup


def commit(unit: SqlUnitOfWork, assembly: SpanAssembly, recorded_ns: int, *, verify: bool = False) -> SpanChanges:
    """Make the stored windows of a vehicle in a span those of an assembly, in an open transaction.

    Bin tables and positions of windows that are removed go with them; the jobs find what rested on those. With
    ``verify`` the files of windows that have not changed are read and checked.
    """
    wanted = {_key(each.window): each for each in map(_assembled, assembly.windows)}
    wheelsets = {wheelset for wheelset, _ in wanted}
    in_span = unit.assembled.in_span(assembly.vehicle, wheelsets, assembly.from_ns, assembly.to_ns)
    stored = {_key(window.record): window for window in in_span}
    gone = [
        window.record
        for key, window in stored.items()
        if window.record.vehicle == assembly.vehicle
        and key not in wanted
        and not assembly.keeps(window.record.start_ns, window.record.length_ns)
    ]
    removed = unit.assembled.remove(gone)
    touched = [(record.axle, record.start_ns) for record in removed]
    new = [each for key, each in wanted.items() if key not in stored]
    # where another transaction has stored one since the look-up, each is looked at by itself
    alone = [] if unit.assembled.add(new, recorded_ns) else new
    replaced, unsure = _compared(unit, stored, wanted, verify=verify)
    unit.assembled.replace(replaced, recorded_ns)
    changes = SpanChanges(new=len(new) - len(alone), changed=len(replaced), removed=len(removed))
    others = [*new, *replaced]
    for each in (*alone, *unsure):
        made, is_other = _put(unit, each, recorded_ns, verify=verify)
        changes += made
        others += [each] if is_other else []
    touched += [(each.window.axle, each.window.start_ns) for each in others]
    gone_keys = {record.key for record in removed}
    kept = [window for window in in_span if window.record.key not in gone_keys]
    _look_at_partners(unit, assembly.vehicle, kept, touched)
    return changes


def _compared(
    unit: SqlUnitOfWork,
    stored: Mapping[WindowKey, StoredWindow],
    wanted: Mapping[WindowKey, AssembledWindow],
    *,
    verify: bool,
) -> tuple[list[AssembledWindow], list[AssembledWindow]]:
    """Return the windows whose samples alone are to be replaced, and those that are to be looked at one by one.

    Those that are stored as they are now are in neither.
    """
    replaced, unsure = [], []
    for key, before in stored.items():
        now = wanted.get(key)
        if now is None:
            continue
        reason = before.record.reason
        if verify or (reason is not None and reason.code is ReasonCode.FILE_DAMAGED):
            unsure.append(now)
        elif before.untouched and not before.samples_purged and before.record.content_digest != now.digest:
            replaced.append(now)
        elif not unit.assembled.is_as_stored(before, now):
            unsure.append(now)
    return replaced, unsure


def _key(window: Window | WindowRecord) -> WindowKey:
    return window.wheelset, window.start_ns


def _assembled(mounted: MountedWindow) -> AssembledWindow:
    window = mounted.window
    noted = (mileage_km(mounted), mounted.odometer_excess_m, mounted.off_line_m)
    return AssembledWindow(window, window_digest(window), *noted)


def mileage_km(mounted: MountedWindow) -> float:
    """Return the mileage of a wheelset at the start of a window."""
    mounting = mounted.mounting
    return mounting.wheelset_mileage_km + (mounted.window.odometer_m / 1000.0 - mounting.vehicle_odometer_km)


def _put(
    unit: SqlUnitOfWork, assembled: AssembledWindow, recorded_ns: int, *, verify: bool
) -> tuple[SpanChanges, bool]:
    """Store one window; return what changes, and whether it has other samples now, or has them again."""
    window = assembled.window
    before = unit.windows.get(window.wheelset, window.start_ns)
    refused = before is not None and before.reason is not None and before.reason.code is ReasonCode.FILE_DAMAGED
    lost = before is not None and not unit.assembled.intact(before, verify=verify or refused)
    stored = unit.windows.put(window, assembled.mileage_km, recorded_ns)
    noted = (assembled.odometer_excess_m, assembled.off_line_m)
    unit.plausibility.note(window.wheelset, window.start_ns, *noted)
    after = unit.windows.get(window.wheelset, window.start_ns)
    assert after is not None
    same = before is not None and before.content_digest == after.content_digest
    if same and (lost or refused):
        unit.windows.healed([(window.wheelset, window.start_ns)])
        return SpanChanges(healed=1), True
    if same:
        return (SpanChanges(changed=1) if stored else NO_CHANGES), False
    return (SpanChanges(new=1) if before is None else SpanChanges(changed=1)), True


def _look_at_partners(
    unit: SqlUnitOfWork, vehicle: str, stored: Iterable[StoredWindow], touched: Iterable[tuple[int, int]]
) -> None:
    """Let windows that are still stored wait again whose partner in the bogie, axle and start, is another now.

    They are estimated with the signals of both.
    """
    there = {
        (window.record.axle, window.record.start_ns): _key(window.record)
        for window in stored
        if window.record.vehicle == vehicle
    }
    starts = {start_ns for _, start_ns in there}
    touched = [place for place in dict.fromkeys(touched) if place[1] in starts]
    on_file = unit.registry.vehicle_class(unit.registry.vehicle(vehicle).vehicle_class) if touched else None
    if on_file is not None:
        partners = ((on_file.vehicle_class.partner(axle), start_ns) for axle, start_ns in touched)
        beside = (there.get((axle, start_ns)) for axle, start_ns in partners if axle is not None)
        unit.windows.look_again(sorted({key for key in beside if key is not None}))
