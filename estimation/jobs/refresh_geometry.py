"""Stage: the geometries of a wheelset from its bin tables, per mileage interval and current.

A table is added once to the roll-up of its interval, so that a new window costs itself, however much came before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

from estimation.jobs.job import Job, JobContext
from estimation.jobs.runner import run
from estimation.jobs.stage import Counted, Outcome, Stage, part_of_result
from estimation.jobs.steps.rolled_geometries import SUMS_IN_MEMORY, RolledGeometries
from estimation.jobs.steps.rolling import read_ahead, read_sums_ahead, rolled
from estimation.jobs.steps.vehicle_classes import ClassLookup, membership
from estimation.storage import UnitOfWork
from estimation.values.geometry import GEOMETRY as GEOMETRIES
from estimation.values.geometry import GeometryRecord, WheelsetGeometry, result_of_geometry
from estimation.values.roll_up import RolledPart, RollUpState
from estimation.values.runs import Facet
from estimation.values.trend import TREND
from estimation.values.windows import DueStage

_BEING_MADE = RollUpState("", {})  # of roll-ups that are made again, until all of them are


@dataclass(frozen=True, slots=True)
class GeometryInputs:
    """What the geometries of a wheelset are made from, and what became of it while it was read.

    The sums of bin tables are megabytes: each is made a geometry where it is read, and only these are kept.

    Attributes:
        rules: Digest of what says to which roll-up a window belongs.
        contents: Of the roll-ups, as they are to be.
        looked_at: Windows that are due, with the versions that were read.
        made_from: By part, digests of the geometries that are others by now.
        whole: Whether these are all roll-ups that are to be made again; else the rest, and the geometries, come next.
    """

    rules: str
    contents: tuple[tuple[str, str], ...]
    looked_at: Mapping[int, int]
    made_from: tuple[str, ...]
    whole: bool
    records: tuple[GeometryRecord, ...] = field(metadata={"made_from": False})
    parts: tuple[RolledPart, ...] = field(metadata={"made_from": False})
    rolled: RolledGeometries = field(metadata={"made_from": False})


def load(unit: UnitOfWork, serials: Sequence[str], context: JobContext) -> Mapping[str, GeometryInputs]:
    """Return the inputs of the wheelsets that have a bin table or a geometry: the others have nothing to estimate from.

    Where many roll-ups are to be made again, some of them at a time, before the geometries.
    """
    wheelsets = unit.geometries.estimable(serials)
    found = geometries_of(unit, [serial for serial in serials if serial in wheelsets], context)
    read_sums_ahead(unit, [(serial, one.rolled) for serial, one in found.items()])
    return {serial: _inputs(geometries) for serial, geometries in found.items()}


def _inputs(geometries: RolledGeometries) -> GeometryInputs:
    rolled = geometries.rolled
    changed = [part for part in rolled.parts if part.changed] if rolled.due else []
    whole = len(changed) <= SUMS_IN_MEMORY
    records = geometries.records() if whole else []
    some = changed if whole else changed[:SUMS_IN_MEMORY]
    parts = [RolledPart(part.roll_up, part.before, *geometries.sums(part), part.added) for part in some]
    geometries.forget_sums()
    return GeometryInputs(
        rules=repr(rolled.state),
        contents=tuple((str(part.roll_up.key), part.roll_up.content) for part in rolled.parts),
        looked_at=rolled.looked_at,
        made_from=tuple(record.input_digest for record in records),
        whole=whole,
        records=tuple(records),
        parts=tuple(parts),
        rolled=geometries,
    )


def geometries_of(unit: UnitOfWork, serials: Sequence[str], context: JobContext) -> Mapping[str, RolledGeometries]:
    """Return the geometries of wheelsets by serial, as they can be made from their roll-ups.

    Args:
        context: Settings of the estimation and version of the numerics.
    """
    rules = [membership(unit, serial, ClassLookup(unit, context.settings.estimation)) for serial in serials]
    read_ahead(unit, rules)
    return {one.wheelset: RolledGeometries(unit, one, rolled(unit, one), context) for one in rules}


def compute(inputs: GeometryInputs) -> Outcome[WheelsetGeometry]:
    """Return the geometries that are others by now."""
    return Outcome([part_of_result(result_of_geometry(record)) for record in inputs.records], more=not inputs.whole)


def store(
    unit: UnitOfWork, context: JobContext, made: Mapping[str, tuple[GeometryInputs | None, Outcome[WheelsetGeometry]]]
) -> Mapping[str, int]:
    """Store the roll-ups, and the bins of the current geometry as plain rows."""
    inputs = {serial: one for serial, (one, _) in made.items() if one is not None}
    whole = {serial: one for serial, one in inputs.items() if one.whole}
    being_made = {serial: _BEING_MADE for serial in inputs if serial not in whole}
    due = {serial: one.rolled.rolled for serial, one in whole.items() if one.rolled.rolled.due}
    current = (serial for serial, one in whole.items() if any(record.interval is None for record in one.records))
    unit.geometries.show_bins(list(current))
    parts = {serial: one.parts for serial, one in inputs.items() if serial in due or serial in being_made}
    unit.roll_ups.put(parts, context.clock.now_ns())
    unit.tables.note_running({serial: one.mileages for serial, one in due.items()})
    looked_at = {(serial, at_ns): version for serial, one in due.items() for at_ns, version in one.looked_at.items()}
    unit.due.settle_all(DueStage.SUMS, looked_at)
    earlier = {serial: one.rolled.earlier for serial, one in whole.items() if one.rolled.earlier is not None}
    unit.roll_ups.put_states(being_made | {serial: one.state for serial, one in due.items()}, earlier)
    for serial, one in due.items():
        unit.roll_ups.drop(serial, one.dropped)
        unit.roll_ups.forget(serial, whole[serial].rolled.forgotten())
    unit.roll_ups.put_rolling([sums for one in whole.values() for sums in one.rolled.radius.fresh.values()])
    chosen = {serial: [at for part in one.parts for _, at in part.roll_up.chosen] for serial, one in due.items()}
    unit.roll_ups.keep_rolling(chosen)
    return {}


GEOMETRY = Stage(
    name=GEOMETRIES.stage,
    job="refresh_geometry",
    kind=GEOMETRIES.subject,
    facets=(Facet.REGISTRY, Facet.TABLES, Facet.RESTARTS, TREND.head_facet),
    settings=lambda settings: settings.estimation,
    load=load,
    compute=compute,
    store=store,
    counted=Counted(looked="wheelsets", changed="geometries"),
    results=GEOMETRIES,
)
JOB = Job(GEOMETRY.job, "Merge bin tables into wheelset geometries", every_s=900.0, run=partial(run, GEOMETRY))
