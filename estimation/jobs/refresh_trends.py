"""Job: refresh the trend of every wheelset whose interval geometries or limit have changed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.conicity_limit import ConicityLimitRule
from estimation.jobs.isolation import Isolation, inputs_of
from estimation.jobs.job import Job, JobContext
from estimation.jobs.steps.identities import identity_change, suspected
from estimation.jobs.steps.roster import roster
from estimation.storage import UnitOfWork
from estimation.trend.extrapolation import LIMIT_AMPLITUDE, conicity_points
from estimation.trend.steps import behind_step, newest_step, with_step
from estimation.trend.trend import TrendParameters, refresh
from estimation.values.geometry import IntervalConicities
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.runs import Look, SubjectKind
from estimation.values.trend import IdentityChange, TrendRecord, WearTrend, since_change

STAGE = "refresh_trends"


def run(context: JobContext) -> Mapping[str, int]:
    """Refresh trends; each wheelset is committed on its own, and one without news is not even looked at."""
    isolation = Isolation(context, STAGE)
    with context.storage.read() as unit:
        seen, now = unit.looks.of(STAGE), _inputs(unit, context)
    counts = dict.fromkeys(("wheelsets", "refreshed", "unchanged", "without_limit"), 0)
    failed = {item.key for item in isolation.held(SubjectKind.WHEELSET)}
    for done, (serial, inputs) in enumerate(now.items()):
        context.checkpoint(done, len(now))
        if (look := seen.get(serial)) is not None and look.inputs == inputs.digest and serial not in failed:
            counts["without_limit" if inputs.limit is None else "unchanged"] += 1
            counts["wheelsets"] += 1
            continue
        changes = inputs_of(context, serial)
        if isolation.waits(SubjectKind.WHEELSET, serial, changes):
            continue
        with isolation.alone(SubjectKind.WHEELSET, serial, changes):
            counts[_refresh(context, serial, inputs)] += 1
            counts["wheelsets"] += 1
    counts["quarantined"] = isolation.quarantined
    return counts


@dataclass(frozen=True, slots=True)
class _Inputs:
    """What stands for everything that the trend of a wheelset is made from; with another one it is looked at again."""

    baseline: int
    newest_geometry: int | None  # number of the one that was appended last
    limit: float | None
    change: IdentityChange | None
    common: str  # what is the same for all wheelsets: parameters and version of the numerics

    @property
    def digest(self) -> str:
        """Digest of all of it."""
        return hashlib.sha256(repr(self).encode()).hexdigest()


def _inputs(unit: UnitOfWork, context: JobContext) -> dict[str, _Inputs]:
    """Return the inputs of all wheelsets by serial: some statements for all, not some for each."""
    geometries = unit.geometries.newest_numbers()
    on_file, changed = roster(unit), suspected(unit)
    common = repr((LIMIT_AMPLITUDE, context.settings.trend, context.code_version))

    def inputs(wheelset: WheelsetRecord) -> _Inputs:
        return _Inputs(
            baseline=len(wheelset.reprofilings),
            newest_geometry=geometries.get(wheelset.serial),
            limit=_limit(unit, wheelset, context.settings.rules, on_file.vehicles),
            change=identity_change(unit, wheelset.serial) if wheelset.serial in changed else None,
            common=common,
        )

    return {wheelset.serial: inputs(wheelset) for wheelset in on_file.wheelsets}


def _refresh(context: JobContext, serial: str, inputs: _Inputs) -> str:
    """Store the trend of a wheelset if it is another by now, and with what it was looked at."""
    record = None if inputs.limit is None else _news(context, serial, inputs, inputs.limit)
    with context.storage.write() as unit:
        refreshed = record is not None and unit.trends.put(record)
        unit.looks.note(STAGE, serial, Look(inputs.digest))
    if inputs.limit is None:
        return "without_limit"
    return "refreshed" if refreshed else "unchanged"


def _news(context: JobContext, serial: str, inputs: _Inputs, limit: float) -> TrendRecord | None:
    """Return the trend of a wheelset; None where it would be the newest one again."""
    with context.storage.read() as unit:
        known = since_change(unit.geometries.conicities(serial, inputs.baseline), inputs.change)
        records = [record for record in known if record.windows]  # others were followed by empty ones
        latest = unit.trends.latest(serial)
    params = context.settings.trend
    digest = _digest(records, limit, params)
    if latest is not None and (latest.baseline, latest.input_digest, latest.code_version) == (
        inputs.baseline,
        digest,
        context.code_version,
    ):
        return None
    return TrendRecord(
        wheelset=serial,
        baseline=inputs.baseline,
        trend=trend_of(records, limit, params),
        input_digest=digest,
        code_version=context.code_version,
        recorded_ns=context.clock.now_ns(),
        parameters=asdict(params),
    )


def trend_of(records: Sequence[IntervalConicities], limit: float, parameters: TrendParameters) -> WearTrend:
    """Return the trend of the conicities of intervals, since their newest step.

    Args:
        limit: Of the conicity at 3 mm.
    """
    step = newest_step(records)
    chosen = conicity_points(behind_step(records, step))
    trend = refresh(
        chosen.points,
        limit,
        parameters,
        quantity=chosen.quantity,
        note=chosen.note,
        shared_std=chosen.spread,
        not_comparable=chosen.not_comparable,
    )
    return trend if step is None else with_step(trend, step)


def _limit(
    unit: UnitOfWork, wheelset: WheelsetRecord, book: RuleBook, vehicles: Mapping[str, VehicleRecord]
) -> float | None:
    """Return the conicity limit in the vehicle it runs in, or ran in last."""
    mounting = wheelset.mounting or max(unit.registry.mountings(wheelset.serial), key=lambda m: m.from_ns, default=None)
    if mounting is None:
        return None
    vehicle = vehicles[mounting.vehicle]
    return book.of(wheelset.fleet, vehicle.vehicle_class).rule(ConicityLimitRule).limit_for(vehicle)


def _digest(records: Sequence[IntervalConicities], limit: float, params: TrendParameters) -> str:
    inputs = [[r.interval, r.input_digest, r.mileage_km, r.code_version] for r in records]
    text = json.dumps([inputs, limit, LIMIT_AMPLITUDE, asdict(params)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


JOB = Job(
    name=STAGE,
    description="Refresh the wear trend of every wheelset with new geometry",
    every_s=300.0,
    run=run,
)
