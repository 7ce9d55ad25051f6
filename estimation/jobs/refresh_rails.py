"""Job: part what belongs to the rails of each section from what belongs to the wheels of each wheelset.

Conicities of a wheelset by section are made again where something has happened to the wheelset; what follows from all
of them, where one of them or what holds their level is another. Where nothing has happened to any wheelset, and what is
on file of sections and classes is as it was, counters say so: no conicity is read.
"""

from __future__ import annotations

import hashlib
import logging
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from itertools import groupby

import numpy as np

from estimation.errors import DamagedError
from estimation.jobs.isolation import Isolation, inputs_of
from estimation.jobs.job import Job, JobContext
from estimation.jobs.steps.rail_anchors import anchor_inputs, anchors
from estimation.jobs.steps.rail_cells import cells_of
from estimation.jobs.steps.section_looks import NO_SECTION, note_sections
from estimation.rails.apart import exceeds, init, reported, result, update
from estimation.rails.cell import with_refused
from estimation.rails.parameters import RailsParameters
from estimation.storage import UnitOfWork
from estimation.values.rails import (
    RailKey,
    RailPart,
    RailsApart,
    SectionRailsRecord,
    StoredCell,
    WheelKey,
    WheelsetRailsRecord,
)
from estimation.values.runs import Look, SectionLook, SubjectKind

STAGE = "refresh_rails"
_log = logging.getLogger(__name__)


def run(context: JobContext) -> Mapping[str, int]:
    """Make cells again where wheelsets have news, each committed on its own; then part wheels and rails if need be."""
    counts: Counter[str] = Counter(wheelsets=0, cells=0, sections=0, known_refused=0, quarantined=0)
    isolation = Isolation(context, STAGE)
    with context.storage.read() as unit:
        seen, looks, whole = unit.looks.of(STAGE), wheelset_looks(unit, context), unit.section_looks.of(STAGE)
        everything = look_at_all(unit, context, looks)
    failed = {item.key for item in isolation.held(SubjectKind.WHEELSET)}
    news = [serial for serial, look in looks.items() if seen.get(serial) != look or serial in failed]
    if not news and whole.get(NO_SECTION) == everything:
        return counts
    for done, serial in enumerate(news):
        context.checkpoint(done, len(news))
        changes = inputs_of(context, serial)
        if isolation.waits(SubjectKind.WHEELSET, serial, changes):
            continue
        with isolation.alone(SubjectKind.WHEELSET, serial, changes):
            counts["cells"] += _refresh_cells(context, serial, looks[serial])
            counts["wheelsets"] += 1
    counts.update(_refresh_found(context, isolation))
    if not isolation.held(SubjectKind.WHEELSET):  # what is held is read again, whatever is counted
        note_sections(context, STAGE, {NO_SECTION: everything})
    counts["quarantined"] = isolation.quarantined
    return counts


def wheelset_looks(unit: UnitOfWork, context: JobContext) -> dict[str, Look]:
    """Return by wheelset what its cells are made from, by what has happened to it.

    Args:
        unit: As one transaction sees it, before the look.
    """
    codes = unit.registry.classes_in_use()
    classes = [(code, None if (found := unit.registry.vehicle_class(code)) is None else found.digest) for code in codes]
    settings = context.settings
    common = f"{classes!r} {settings.estimation.as_json()!r} {settings.rails.period_days!r} {context.code_version}"
    touched = unit.looks.touched()
    return {serial: Look(_digest(f"{touched[serial]} {common}")) for serial in sorted(touched)}


def look_at_all(unit: UnitOfWork, context: JobContext, looks: Mapping[str, Look]) -> SectionLook:
    """Return what parting wheels and rails is made from: all wheelsets, and what is on file of all sections.

    Args:
        unit: As one transaction sees it, before the look.
        looks: Of all wheelsets.
    """
    rails, of_wheelsets = context.settings.rails, [(serial, look.inputs) for serial, look in looks.items()]
    settings = (sorted(rails.known_sections), rails.model)
    return SectionLook(_digest(f"{of_wheelsets!r} {unit.tracks.sections()!r} {settings!r} {context.code_version}"), 0)


def _refresh_cells(context: JobContext, serial: str, look: Look) -> int:
    """Store the cells of a wheelset that are others by now; return how many."""
    with context.storage.read() as unit:
        found = cells_of(unit, serial, context)
    with context.storage.write() as unit:
        unit.rails.put_cells(found.changed)
        unit.rails.drop_cells(found.gone)
        unit.looks.note(STAGE, serial, look)
    return len(found.changed) + len(found.gone)


def _refresh_found(context: JobContext, isolation: Isolation) -> Mapping[str, int]:
    """Part wheels and rails where that is not what is stored; return of how many sections something is said.

    Beside that, how many sections that are named as known hold no level.
    """
    parameters = context.settings.rails.model
    with context.storage.read() as unit:
        cells = unit.rails.cells()
        inputs = anchor_inputs(unit, cells, context)
        digest = _digest(f"{[_stands_for(one) for one in cells]!r} {inputs.text} {parameters!r}")
        unchanged = unit.rails.input_digest() == (digest, context.code_version)
    _keep_damaged(context, isolation, cells)
    if unchanged:
        return {"sections": 0, "known_refused": 0}
    usable = [one.usable for one in cells if one.usable is not None]
    amplitude = usable[0].amplitude if usable else np.array(context.settings.estimation.geometry.curve.amplitudes)
    with context.storage.read() as unit:
        held = anchors(unit, inputs, amplitude)
    found = with_refused(result(update(init(parameters, amplitude), usable), held), cells)
    refused = {**dict.fromkeys(held.missing, "not on file"), **{code: str(why) for code, why in found.refused.items()}}
    for code, why in sorted(refused.items()):
        _log.warning("section %s is named as known, but holds no level: %s", code, why)
    for serial, reason in sorted(found.refused_wheels.items()):
        _log.warning("wheelset %s is measured, but holds no level: %s", serial, reason)
    sections = _section_records(found, held.wheel.profile, parameters, digest, context)
    wheelsets = _wheelset_records(found, digest, context)
    with context.storage.write() as unit:
        unit.rails.put_found(sections, wheelsets)
    return {"sections": len(sections), "known_refused": len(refused)}


def _stands_for(one: StoredCell) -> tuple[WheelKey, RailKey, str, str | None]:
    return one.wheel, one.rail, one.digest, None if one.reason is None else str(one.reason.code)


def _keep_damaged(context: JobContext, isolation: Isolation, cells: Sequence[StoredCell]) -> None:
    """Keep wheelsets with cells that cannot be read in quarantine, which has them made again."""
    for serial, own in groupby((one for one in cells if one.damaged), key=lambda one: one.wheel.wheelset):
        if serial not in {item.key for item in isolation.held(SubjectKind.WHEELSET)}:
            error = DamagedError("; ".join(str(one.reason) for one in own))
            isolation.keep(SubjectKind.WHEELSET, serial, inputs_of(context, serial)(), error)


def _section_records(
    found: RailsApart, profile: str, parameters: RailsParameters, digest: str, context: JobContext
) -> list[SectionRailsRecord]:
    """Return what is found of every section, its periods oldest first."""
    periods: defaultdict[str, list[RailPart]] = defaultdict(list)
    for one in found.rails:
        periods[one.rail.section].append(one)
    records = []
    for section, parts in sorted(periods.items()):
        newest = reported(parts[-1].excess, found.amplitude, parameters.limit_amplitude)
        excess, amplitude = (None, None) if newest is None else newest
        records.append(
            SectionRailsRecord(
                section=section,
                amplitude=tuple(found.amplitude.tolist()),
                reference_wheel_profile=profile,
                periods=tuple(parts),
                trend=found.trends.get(section),
                limit=parameters.limit,
                exceeded=None if excess is None else exceeds(excess, parameters.limit),
                reported_amplitude=amplitude,
                input_digest=digest,
                code_version=context.code_version,
                recorded_ns=context.clock.now_ns(),
                refused=found.refused.get(section),
                no_trend=found.no_trends.get(section),
            )
        )
    return records


def _wheelset_records(found: RailsApart, digest: str, context: JobContext) -> list[WheelsetRailsRecord]:
    """Return what is found of every wheelset in its newest interval."""
    newest = {one.wheel.wheelset: one for one in found.wheels}  # in the order of their keys
    amplitude, now_ns = tuple(found.amplitude.tolist()), context.clock.now_ns()
    return [
        WheelsetRailsRecord(amplitude, one, digest, context.code_version, now_ns, found.refused_wheels.get(serial))
        for serial, one in newest.items()
    ]


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


JOB = Job(
    name=STAGE,
    description="Part what belongs to the rails of sections from what belongs to the wheels of wheelsets",
    every_s=3_600.0,
    run=run,
)
