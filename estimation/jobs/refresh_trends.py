"""Stage: the trend of a wheelset, from the conicities of its mileage intervals and the limit of its vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

from estimation.alerts.rules.conicity_limit import ConicityLimitRule
from estimation.jobs.job import Job, JobContext
from estimation.jobs.runner import run
from estimation.jobs.stage import Counted, Outcome, Part, Stage, made_from
from estimation.jobs.steps.assumptions import identity_changes
from estimation.storage import UnitOfWork
from estimation.trend.change_point import CONICITY
from estimation.trend.extrapolation import conicity_points
from estimation.trend.parameters import CURVES
from estimation.trend.trend import TrendParameters, behind_step, newest_step, refresh, with_step
from estimation.values.geometry import GEOMETRY, IntervalConicities
from estimation.values.registry import VehicleRecord
from estimation.values.runs import Facet
from estimation.values.trend import TREND as TRENDS
from estimation.values.trend import WearTrend, baseline_part, since_change

NUMBERS = (CURVES, CONICITY)
METHOD = made_from(*NUMBERS)[:16]


@dataclass(frozen=True, slots=True)
class TrendInputs:
    """What the trend of a wheelset is made from."""

    baseline: int
    # of the intervals with windows since the last reprofiling and the last change of identity
    conicities: tuple[IntervalConicities, ...]
    limit: float | None  # of the conicity at 3 mm, in the vehicle it runs in or ran in last; None where there is none
    parameters: TrendParameters
    raise_probability: float | None = None  # of the rule that has the limit


def load(unit: UnitOfWork, serials: Sequence[str], context: JobContext) -> Mapping[str, TrendInputs]:
    """Return what the trends of some wheelsets are made from."""
    vehicles, changes = _vehicles(unit, serials), identity_changes(unit, serials)
    wheelsets = unit.registry.wheelsets_of(serials)
    intervals = unit.geometries.conicities_of({wheelset.serial: len(wheelset.reprofilings) for wheelset in wheelsets})
    inputs = {}
    for wheelset in wheelsets:
        serial, baseline, vehicle = wheelset.serial, len(wheelset.reprofilings), vehicles.get(wheelset.serial)
        conicities = since_change(intervals[serial], changes.get(serial))
        rules = None if vehicle is None else context.settings.rules.of(wheelset.fleet, vehicle.vehicle_class)
        rule = None if rules is None else rules.rule(ConicityLimitRule)
        inputs[serial] = TrendInputs(
            baseline=baseline,
            conicities=tuple(entry for entry in conicities if entry.windows),  # others were followed by empty ones
            limit=None if rule is None or vehicle is None else rule.limit_for(vehicle),
            parameters=context.settings.trend,
            raise_probability=None if rule is None else rule.raise_probability,
        )
    return inputs


def _vehicles(unit: UnitOfWork, serials: Sequence[str]) -> Mapping[str, VehicleRecord]:
    """Return the vehicle that each wheelset runs in, or ran in last."""
    last = {
        serial: next((mounting for mounting in mountings if mounting.to_ns is None), mountings[-1])
        for serial, mountings in unit.registry.mountings_of(serials).items()
    }
    vehicles = unit.registry.vehicles_of({mounting.vehicle for mounting in last.values()})
    return {serial: vehicles[mounting.vehicle] for serial, mounting in last.items()}


def compute(inputs: TrendInputs) -> Outcome[WearTrend]:
    """Return the trend, where a limit is in force."""
    if inputs.limit is None:
        return Outcome(counted="without_limit")
    trend = trend_of(inputs.conicities, inputs.limit, inputs.parameters)
    if inputs.raise_probability is not None:
        trend = replace(trend, raise_probability=inputs.raise_probability)
    part = Part(
        trend,
        part=baseline_part(inputs.baseline),
        status=trend.status,
        reason=trend.reason,
        head=trend.head,
        parameters={**asdict(inputs.parameters), "method": METHOD},
    )
    return Outcome([part])


def trend_of(records: Sequence[IntervalConicities], limit: float, parameters: TrendParameters) -> WearTrend:
    """Return the trend of the conicities of intervals, since their newest step, against the limit at 3 mm."""
    step = newest_step(records, parameters)
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


TREND = Stage(
    name=TRENDS.stage,
    job="refresh_trends",
    kind=TRENDS.subject,
    facets=(Facet.REGISTRY, Facet.RESTARTS, GEOMETRY.stage),
    settings=lambda settings: (settings.trend, settings.rules.version),
    load=load,
    compute=compute,
    counted=Counted(looked="wheelsets", changed="refreshed", same="unchanged", more=("without_limit",)),
    numbers=NUMBERS,
    results=TRENDS,
    at_once=32,
    here=True,
)
JOB = Job(
    name=TREND.job,
    description="Refresh the wear trend of every wheelset with new geometry",
    every_s=300.0,
    run=partial(run, TREND),
)
