"""Stage: the trend of a wheelset, from the conicities of its mileage intervals and the limit of its vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

from estimation.accuracy.wheel_contact import wheel_contact
from estimation.alerts.rules.conicity_limit import ConicityLimitRule
from estimation.jobs.job import Job, JobContext
from estimation.jobs.runner import run
from estimation.jobs.stage import Counted, Outcome, Part, Stage, made_from
from estimation.jobs.steps.assumptions import identity_changes
from estimation.jobs.steps.measured_wheelsets import MeasuredConicity, measured_conicities
from estimation.storage import UnitOfWork
from estimation.trend.change_point import CONICITY
from estimation.trend.extrapolation import SAME_AMPLITUDE, TrendPoints, conicity_points
from estimation.trend.fleet import usual_wear
from estimation.trend.parameters import CALIBRATION, CURVES, FLEET
from estimation.trend.trend import TrendParameters, behind_step, newest_step, refresh, with_step
from estimation.values.geometry import GEOMETRY, IntervalConicities
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.runs import Facet
from estimation.values.trend import (
    FLEET_WEAR,
    FleetWear,
    TrendPoint,
    TrendStep,
    WearTrend,
    baseline_part,
    since_change,
)
from estimation.values.trend import TREND as TRENDS

NUMBERS = (CURVES, CONICITY, FLEET, CALIBRATION)
METHOD = made_from(*NUMBERS)[:16]


@dataclass(frozen=True, slots=True)
class TrendHistory:
    """The conicities that a trend is made from, and how its points are chosen."""

    # of the intervals with windows since the last reprofiling and the last change of identity
    conicities: tuple[IntervalConicities, ...]
    turned_km: float  # mileage of the last reprofiling; 0 of a wheelset as it was new
    parameters: TrendParameters


@dataclass(frozen=True, slots=True)
class TrendInputs:
    """What the trend of a wheelset is made from."""

    baseline: int
    history: TrendHistory
    limit: float | None  # of the conicity at 3 mm, in the vehicle it runs in or ran in last; None where there is none
    fleet: FleetWear  # what is known of its wear beforehand
    raise_probability: float | None = None  # of the rule that has the limit
    measured: tuple[MeasuredConicity, ...] = ()  # since it runs where it runs, with the sensors that are there


def load(unit: UnitOfWork, serials: Sequence[str], context: JobContext) -> Mapping[str, TrendInputs]:
    """Return what the trends of some wheelsets are made from."""
    vehicles = vehicles_of(unit, serials)
    fleets = beforehand(unit, serials)
    measured = _measured(unit, serials, context.settings.estimation.interval_km)
    inputs = {}
    for serial, (wheelset, history) in histories(unit, serials, context).items():
        vehicle = vehicles[serial][0] if serial in vehicles else None
        rules = None if vehicle is None else context.settings.rules.of(wheelset.fleet, vehicle.vehicle_class)
        rule = None if rules is None else rules.rule(ConicityLimitRule)
        inputs[serial] = TrendInputs(
            baseline=len(wheelset.reprofilings),
            history=history,
            limit=None if rule is None or vehicle is None else rule.limit_for(vehicle),
            fleet=fleets[serial],
            raise_probability=None if rule is None else rule.raise_probability,
            measured=measured.get(serial, ()),
        )
    return inputs


def _measured(
    unit: UnitOfWork, serials: Sequence[str], interval_km: float
) -> Mapping[str, tuple[MeasuredConicity, ...]]:
    """Return what was measured of those wheelsets that were, of which all that estimates have in common still holds."""
    serials = sorted(unit.registry.newest_measurement_of(serials))
    changes, mounted = identity_changes(unit, serials), unit.registry.mountings_of(serials)
    sensors = unit.sensor_changes.newest({mountings[-1].vehicle for mountings in mounted.values()}) if mounted else {}
    found = {}
    for wheelset in unit.registry.wheelsets_of(serials):
        since = [changes[wheelset.serial].after_ns] if wheelset.serial in changes else []
        for last in mounted.get(wheelset.serial, ())[-1:]:
            since += [last.from_ns, sensors.get((last.vehicle, last.axle), last.from_ns)]
        since_ns = max(since, default=0)
        found[wheelset.serial] = measured_conicities(unit, wheelset, wheel_contact, interval_km, since_ns)
    return found


def histories(
    unit: UnitOfWork, serials: Sequence[str], context: JobContext
) -> Mapping[str, tuple[WheelsetRecord, TrendHistory]]:
    """Return what the points of trends are made from, of the present profile of each of some wheelsets."""
    wheelsets, changes = unit.registry.wheelsets_of(serials), identity_changes(unit, serials)
    intervals = unit.geometries.conicities_of({wheelset.serial: len(wheelset.reprofilings) for wheelset in wheelsets})
    found = {}
    for wheelset in wheelsets:
        conicities = since_change(intervals[wheelset.serial], changes.get(wheelset.serial))
        with_windows = tuple(entry for entry in conicities if entry.windows)  # others were followed by empty ones
        turned = turned_km(wheelset, len(wheelset.reprofilings))
        found[wheelset.serial] = (wheelset, TrendHistory(with_windows, turned, context.settings.trend))
    return found


def turned_km(wheelset: WheelsetRecord, baseline: int) -> float:
    """Return the mileage at which the profile of a baseline began to wear: its reprofiling, or 0 as it was new."""
    return wheelset.reprofilings[baseline - 1].mileage_km if baseline else 0.0


def beforehand(unit: UnitOfWork, serials: Sequence[str]) -> Mapping[str, FleetWear]:
    """Return what is known of the wear of some wheelsets beforehand, by their fleets or of any."""
    said = {result.subject: result.value for result in unit.results.in_force(FLEET_WEAR, serials)}
    return {serial: said.get(serial) or usual_wear() for serial in serials}


def vehicles_of(unit: UnitOfWork, serials: Sequence[str]) -> Mapping[str, tuple[VehicleRecord, int]]:
    """Return the vehicle that each wheelset runs in, or ran in last, and its axle there."""
    last = {
        serial: next((mounting for mounting in mountings if mounting.to_ns is None), mountings[-1])
        for serial, mountings in unit.registry.mountings_of(serials).items()
    }
    vehicles = unit.registry.vehicles_of({mounting.vehicle for mounting in last.values()})
    return {serial: (vehicles[mounting.vehicle], mounting.axle) for serial, mounting in last.items()}


def compute(inputs: TrendInputs) -> Outcome[WearTrend]:
    """Return the trend, where a limit is in force."""
    if inputs.limit is None:
        return Outcome(counted="without_limit")
    history = inputs.history
    trend = trend_of(
        history.conicities, inputs.limit, history.parameters, inputs.fleet, history.turned_km, inputs.measured
    )
    if inputs.raise_probability is not None:
        trend = replace(trend, raise_probability=inputs.raise_probability)
    part = Part(
        trend,
        part=baseline_part(inputs.baseline),
        status=trend.status,
        reason=trend.reason,
        head=trend.head,
        parameters={**asdict(history.parameters), "method": METHOD},
    )
    return Outcome([part])


def trend_of(
    records: Sequence[IntervalConicities],
    limit: float,
    parameters: TrendParameters,
    fleet: FleetWear | None = None,
    turned_km: float | None = None,
    measured: Sequence[MeasuredConicity] = (),
) -> WearTrend:
    """Return the trend of the conicities of intervals, since their newest step, against the limit at 3 mm.

    Args:
        fleet: What is known of the wear beforehand; None for nothing.
        turned_km: Mileage of the last reprofiling; None where nobody knows it.
        measured: By profiles of the same wheels.
    """
    step = newest_step(records, parameters)
    chosen = conicity_points(behind_step(records, step), fleet)
    trend = refresh(
        chosen.points,
        limit,
        parameters,
        quantity=chosen.quantity,
        note=chosen.note,
        not_comparable=chosen.not_comparable,
        fleet=fleet,
        origin_km=turned_km if step is None else step.before_km,
        measured=_measured_points(measured, chosen, step),
    )
    return trend if step is None else with_step(trend, step)


def _measured_points(
    measured: Sequence[MeasuredConicity], chosen: TrendPoints, step: TrendStep | None
) -> list[TrendPoint]:
    """Return what was measured behind a step, at the amplitude of the points."""
    return [
        TrendPoint(item.mileage_km, item.at_ns, known.value, known.std)
        for item in measured
        for known in item.known
        if abs(known.amplitude - chosen.amplitude) < SAME_AMPLITUDE and (step is None or item.at_ns >= step.after_ns)
    ]


TREND = Stage(
    name=TRENDS.stage,
    job="refresh_trends",
    kind=TRENDS.subject,
    facets=(Facet.REGISTRY, Facet.RESTARTS, GEOMETRY.stage, FLEET_WEAR.stage),
    settings=lambda settings: (settings.trend, settings.rules.version, settings.estimation.interval_km),
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
