"""Job: refresh the trend of every wheelset whose interval geometries or limit have changed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.conicity_limit import ConicityLimitRule
from estimation.jobs.isolation import Isolation, inputs_of
from estimation.jobs.job import Job, JobContext
from estimation.jobs.steps.identities import identity_change
from estimation.storage import UnitOfWork
from estimation.trend.extrapolation import LIMIT_AMPLITUDE
from estimation.trend.points import conicity_points
from estimation.trend.trend import TrendParameters, refresh
from estimation.values.geometry import GeometryRecord
from estimation.values.identity import since_change
from estimation.values.quarantine import SubjectKind
from estimation.values.registry import WheelsetRecord
from estimation.values.trend import TrendRecord, WearTrend


def run(context: JobContext) -> Mapping[str, int]:
    """Refresh trends; each wheelset is committed on its own, and one without news is left alone."""
    with context.storage.read() as unit:
        wheelsets = unit.registry.wheelsets()
    counts = dict.fromkeys(("wheelsets", "refreshed", "unchanged", "without_limit"), 0)
    isolation = Isolation(context, "refresh_trends")
    for done, wheelset in enumerate(wheelsets):
        context.checkpoint(done, len(wheelsets))
        inputs = inputs_of(context, wheelset.serial)
        if isolation.waits(SubjectKind.WHEELSET, wheelset.serial, inputs):
            continue
        with isolation.alone(SubjectKind.WHEELSET, wheelset.serial, inputs):
            counts[_refresh(context, wheelset)] += 1
            counts["wheelsets"] += 1
    counts["quarantined"] = isolation.quarantined
    return counts


def _refresh(context: JobContext, wheelset: WheelsetRecord) -> str:
    params, baseline = context.settings.trend, len(wheelset.reprofilings)
    with context.storage.read() as unit:
        limit = _limit(unit, wheelset, context.settings.rules)
        change = identity_change(unit, wheelset.serial)
        known = since_change(unit.geometries.intervals(wheelset.serial, baseline), change)
        records = [record for record in known if record.geometry.windows]  # others were followed by empty ones
        latest = unit.trends.latest(wheelset.serial)
    if limit is None:
        return "without_limit"
    digest = _digest(records, limit, params)
    if latest is not None and (latest.baseline, latest.input_digest, latest.code_version) == (
        baseline,
        digest,
        context.code_version,
    ):
        return "unchanged"
    record = TrendRecord(
        wheelset=wheelset.serial,
        baseline=baseline,
        trend=trend_of(records, limit, params),
        input_digest=digest,
        code_version=context.code_version,
        recorded_ns=context.clock.now_ns(),
        parameters=asdict(params),
    )
    with context.storage.write() as unit:
        return "refreshed" if unit.trends.put(record) else "unchanged"


def trend_of(records: Sequence[GeometryRecord], limit: float, parameters: TrendParameters) -> WearTrend:
    """Return the trend of the geometries of intervals.

    Parameters
    ----------
    records
        Of one wheelset and baseline, with windows.
    limit
        Of the conicity at 3 mm.
    parameters
        Of the fit.
    """
    chosen = conicity_points(records)
    return refresh(
        chosen.points,
        limit,
        parameters,
        quantity=chosen.quantity,
        note=chosen.note,
        shared_std=chosen.spread,
        not_comparable=chosen.not_comparable,
    )


def _limit(unit: UnitOfWork, wheelset: WheelsetRecord, book: RuleBook) -> float | None:
    """Return the conicity limit in the vehicle it runs in, or ran in last."""
    mounting = wheelset.mounting or max(unit.registry.mountings(wheelset.serial), key=lambda m: m.from_ns, default=None)
    if mounting is None:
        return None
    vehicle = unit.registry.vehicle(mounting.vehicle)
    return book.of(wheelset.fleet, vehicle.vehicle_class).rule(ConicityLimitRule).limit_for(vehicle)


def _digest(records: Sequence[GeometryRecord], limit: float, params: TrendParameters) -> str:
    inputs = [[r.interval, r.input_digest, r.mileage_km, r.code_version] for r in records]
    text = json.dumps([inputs, limit, LIMIT_AMPLITUDE, asdict(params)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


JOB = Job(
    name="refresh_trends",
    description="Refresh the wear trend of every wheelset with new geometry",
    every_s=60.0,
    run=run,
)
