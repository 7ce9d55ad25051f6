"""Job: bin tables of a wheelset become its geometry, per mileage interval and current.

A table is added once to the roll-up of its interval, so that a new window costs itself, however much came before.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from estimation.errors import ConflictError, TreadwatchError
from estimation.jobs.hand_out import hand_out, unit_size
from estimation.jobs.isolation import Isolation, fails_alone, inputs_of
from estimation.jobs.job import Job, JobContext, Work
from estimation.jobs.steps.membership import membership
from estimation.jobs.steps.rolled_geometries import SUMS_IN_MEMORY, RolledGeometries
from estimation.jobs.steps.rolling import Part, rolled
from estimation.jobs.steps.vehicle_classes import ClassLookup
from estimation.storage import UnitOfWork
from estimation.values.geometry import GeometryRecord
from estimation.values.roll_up import RolledPart, RollUpState
from estimation.values.runs import SubjectKind
from estimation.values.windows import DueStage

_STALE_AT_ONCE = 10_000
_BEING_MADE = RollUpState("", {})  # of roll-ups that are made again, until all of them are


def run(context: JobContext) -> Mapping[str, int]:
    """Refresh every wheelset whose windows changed; each is committed as a whole."""
    counts: Counter[str] = Counter(wheelsets=0, geometries=0)
    isolation = Isolation(context, "refresh_geometry")
    with context.storage.read() as unit:
        stale = unit.geometries.stale(_STALE_AT_ONCE)
    due = [one for one in stale if not isolation.waits(SubjectKind.WHEELSET, one, inputs_of(context, one))]
    counts["quarantined"] = isolation.quarantined
    size = unit_size(context, len(due), _MOST_TOGETHER)
    units = (tuple(due[first : first + size]) for first in range(0, len(due), size))
    done = len(stale) - len(due)

    def progress(more: int) -> None:
        nonlocal done
        done += more
        context.checkpoint(done, len(stale))

    counts.update(hand_out(context, STAGE, units, progress))
    return counts


def _work(context: JobContext, serials: Sequence[str]) -> Mapping[str, int]:
    """Refresh wheelsets, a few in a transaction; what fails at one of them is kept in quarantine."""
    counts: Counter[str] = Counter()
    isolation = Isolation(context, "refresh_geometry")
    for first in range(0, len(serials), STORED_TOGETHER):
        found: dict[str, _Made] = {}
        for serial in serials[first : first + STORED_TOGETHER]:
            try:
                found[serial] = _whole(context, serial)
            except ConflictError:  # still stale
                counts["wheelsets"] += 1
                isolation.release(SubjectKind.WHEELSET, serial)
            except Exception as error:
                if not fails_alone(error):
                    raise
                isolation.keep(SubjectKind.WHEELSET, serial, inputs_of(context, serial)(), error)
        counts.update(_stored(context, isolation, found))
    counts["quarantined"] = isolation.quarantined
    return counts


def _stored(context: JobContext, isolation: Isolation, found: Mapping[str, _Made]) -> Mapping[str, int]:
    """Store what was made of wheelsets in one transaction; where that fails, of each in its own."""
    counts: Counter[str] = Counter()
    try:
        changed = _put(context, found)
    except Exception as error:
        if not fails_alone(error):
            raise
        for serial, made in found.items():
            with isolation.alone(SubjectKind.WHEELSET, serial, inputs_of(context, serial)):
                with suppress(ConflictError):  # another process has changed something meanwhile: it is still stale
                    counts["geometries"] += _put(context, {serial: made})
                counts["wheelsets"] += 1
        return counts
    for serial in found:
        isolation.release(SubjectKind.WHEELSET, serial)
    return {"geometries": changed, "wheelsets": len(found)}


def _put(context: JobContext, found: Mapping[str, _Made]) -> int:
    """Store roll-ups and geometries of wheelsets in one transaction; return how many geometries have changed."""
    changed = 0
    if found:
        with context.storage.write() as unit:
            for serial, made in found.items():
                changed += sum(unit.geometries.put(record) for record in made.records)
                _store(unit, serial, made, context.clock.now_ns())
                unit.geometries.mark_current(serial, made.change)
    return changed


def _set_aside(context: JobContext, serial: str, error: TreadwatchError) -> None:
    isolation = Isolation(context, "refresh_geometry")
    isolation.keep(SubjectKind.WHEELSET, serial, inputs_of(context, serial)(), error)


JOB = Job("refresh_geometry", "Merge bin tables into wheelset geometries", every_s=900.0, run=run)
STAGE = Work(JOB.name, _work, _set_aside)
STORED_TOGETHER = 4  # wheelsets in a transaction, of each some sums of 1.5 MB
_MOST_TOGETHER = 16  # wheelsets that are claimed together


def geometries_of(unit: UnitOfWork, serial: str, context: JobContext) -> RolledGeometries:
    """Return the geometries of one wheelset, as they can be made from its roll-ups.

    Args:
        context: Settings of the estimation and version of the numerics.
    """
    rules = membership(unit, serial, ClassLookup(unit, context.settings.estimation))
    return RolledGeometries(unit, rules, rolled(unit, rules), context)


def _whole(context: JobContext, serial: str) -> _Made:
    """Return what is to be stored of a wheelset, once its roll-ups are in order."""
    found = _made(context, serial)
    while found.apart:
        _roll_again(context, serial, found.seen)
        found = _made(context, serial)
    return found


@dataclass(frozen=True, slots=True)
class _Made:
    """What was made of a wheelset in one transaction: roll-ups to store, and geometries."""

    change: int
    seen: RolledGeometries
    parts: list[RolledPart]
    records: list[GeometryRecord]
    apart: bool = False  # so many roll-ups have changed that each is stored by itself, before the geometries


def _made(context: JobContext, serial: str) -> _Made:
    """Return what is to be stored of a wheelset; nothing but the roll-ups where many of these have changed."""
    with context.storage.read() as unit:
        change, seen = unit.geometries.change(serial), geometries_of(unit, serial, context)
        changed = [part for part in seen.rolled.parts if part.changed] if seen.rolled.due else []
        if len(changed) > SUMS_IN_MEMORY:
            return _Made(change, seen, [], [], apart=True)
        records = seen.records()
        parts = [_with_sums(seen, part) for part in changed]
        return _Made(change, seen, parts, records)


def _roll_again(context: JobContext, serial: str, seen: RolledGeometries) -> None:
    """Store the many roll-ups of a wheelset that have changed, one at a time.

    What is stored on the way counts only when all are: until then the next run begins again.
    """
    with context.storage.write() as unit:
        unit.roll_ups.put_state(serial, _BEING_MADE)
    for part in seen.rolled.parts:
        if part.changed:
            with context.storage.read() as unit:
                whole = _with_sums(_seen_again(unit, seen), part)
            with context.storage.write() as unit:
                unit.roll_ups.put(serial, [whole], context.clock.now_ns())
    with context.storage.write() as unit:
        _store_state(unit, serial, seen)


def _seen_again(unit: UnitOfWork, seen: RolledGeometries) -> RolledGeometries:
    """Return the same, read in another transaction."""
    rules = replace(seen.rules, classes=ClassLookup(unit, seen.rules.classes.settings))
    return RolledGeometries(unit, rules, seen.rolled, seen.context)


def _with_sums(seen: RolledGeometries, part: Part) -> RolledPart:
    plain, forgetting = seen.sums(part)
    return RolledPart(part.roll_up, part.before, plain, forgetting, part.added)


def _store_state(unit: UnitOfWork, serial: str, seen: RolledGeometries) -> None:
    """Store what holds once all roll-ups of a wheelset are stored that have changed."""
    unit.tables.note_running(serial, seen.rolled.mileages)
    unit.due.settle(DueStage.SUMS, serial, seen.rolled.looked_at)
    unit.roll_ups.drop(serial, seen.rolled.dropped)
    unit.roll_ups.put_state(serial, seen.rolled.state)


def _store(unit: UnitOfWork, serial: str, found: _Made, now_ns: int) -> None:
    seen = found.seen
    if seen.rolled.due:
        unit.roll_ups.put(serial, found.parts, now_ns)
        _store_state(unit, serial, seen)
        unit.roll_ups.forget(serial, seen.forgotten())
    if seen.earlier is not None:
        unit.roll_ups.put_earlier(serial, *seen.earlier)
    unit.roll_ups.put_rolling(list(seen.radius.fresh.values()))
    if seen.rolled.due:
        unit.roll_ups.keep_rolling(serial, [start for part in seen.rolled.parts for _, start in part.roll_up.chosen])
