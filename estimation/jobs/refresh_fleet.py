"""Stages: what the points of each wheelset alone say of its wear, and what a fleet says of each of its wheelsets.

They run once a day, and what a fleet says is rounded: trends are computed again for the points of their own wheelset,
and where the fleet has learnt something. Wheelsets are alike that run in vehicles of one class of one fleet, at the
same place in the bogie; where these are few, so are all of the class in the fleet, all of the class, and all.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from estimation.jobs.job import Job, JobContext
from estimation.jobs.refresh_trends import TrendHistory, histories, vehicles_of
from estimation.jobs.runner import run_counted
from estimation.jobs.stage import Counted, Outcome, Part, Stage, made_from
from estimation.storage import UnitOfWork
from estimation.trend.change_point import CONICITY
from estimation.trend.extrapolation import beyond_reached, conicity_points
from estimation.trend.fleet import fleet_priors, own_wear
from estimation.trend.parameters import CURVES, FLEET
from estimation.trend.trend import behind_step, newest_step, points_of
from estimation.values.geometry import GEOMETRY
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import EVERYTHING, Facet
from estimation.values.trend import FLEET_WEAR, OWN_WEAR, FleetWear, OwnWear
from estimation.values.units import DAY_S
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE

NUMBERS = (CURVES, CONICITY, FLEET)
TOO_FEW = Reason(ReasonCode.TOO_FEW_POINTS, "too few points to say anything of wear")


def load_histories(unit: UnitOfWork, serials: Sequence[str], context: JobContext) -> Mapping[str, TrendHistory]:
    """Return the conicities of some wheelsets."""
    return {serial: history for serial, (_, history) in histories(unit, serials, context).items()}


def own(history: TrendHistory) -> Outcome[OwnWear]:
    """Return what the points of a wheelset say of its wear; a reason where they are too few."""
    step = newest_step(history.conicities, history.parameters)
    chosen = conicity_points(behind_step(history.conicities, step))
    points = points_of(chosen.points, history.parameters)
    if points is None:
        return Outcome([Part(None, status=Status.UNESTIMATED, reason=TOO_FEW)])
    origin_km = history.turned_km if step is None else step.before_km
    wear = own_wear(points.mileage_km, points.value, points.noise, origin_km, chosen.amplitude)
    return Outcome([Part(replace(wear, beyond=beyond_reached(history.conicities)))])


@dataclass(frozen=True, slots=True)
class Place:
    """Where a wheelset runs; with each name less, more wheelsets are alike."""

    amplitude: float
    vehicle_class: str
    fleet: str
    axle_of_bogie: int

    @property
    def widening(self) -> Sequence[Hashable]:
        """What has to be the same, ever less."""
        names = (self.amplitude, self.vehicle_class, self.fleet, self.axle_of_bogie)
        return [names[:count] for count in range(len(names), 0, -1)]


@dataclass(frozen=True, slots=True)
class FleetInputs:
    """What the wheelsets say, and where they run."""

    wears: Mapping[str, OwnWear]
    places: Mapping[str, Place]


def load_fleet(unit: UnitOfWork, _: Sequence[str], __: JobContext) -> Mapping[str, FleetInputs]:
    """Return what all wheelsets say."""
    wears = {result.subject: result.value for result in unit.results.in_force(OWN_WEAR) if result.value is not None}
    vehicles = vehicles_of(unit, sorted(wears))
    fleets = {wheelset.serial: wheelset.fleet for wheelset in unit.registry.wheelsets_of(sorted(wears))}
    places = {
        serial: Place(wears[serial].amplitude, vehicle.vehicle_class, fleets[serial], 1 + (axle - 1) % AXLES_OF_A_BOGIE)
        for serial, (vehicle, axle) in vehicles.items()
    }
    return {EVERYTHING: FleetInputs({serial: wears[serial] for serial in places}, places)}


def together(inputs: FleetInputs) -> Outcome[FleetWear]:
    """Return what the wheelsets that are alike say of each."""
    alike: defaultdict[Hashable, list[str]] = defaultdict(list)
    for serial, place in sorted(inputs.places.items()):
        for same in place.widening:
            alike[same].append(serial)
    asked: defaultdict[Hashable, list[str]] = defaultdict(list)
    for serial, place in sorted(inputs.places.items()):
        narrow = (same for same in place.widening if len(alike[same]) > FLEET.least_others)
        asked[next(narrow, place.widening[-1])].append(serial)
    parts = []
    for same, serials in asked.items():
        said = fleet_priors([inputs.wears[serial] for serial in alike[same]])
        by_serial = dict(zip(alike[same], said, strict=True))
        parts += [Part(by_serial[s], subject=s, made_from=made_from(by_serial[s])) for s in serials]
    return Outcome(parts)


OF_WHEELSETS = Stage(
    name=OWN_WEAR.stage,
    job="refresh_fleet",
    kind=OWN_WEAR.subject,
    facets=(Facet.REGISTRY, Facet.RESTARTS, GEOMETRY.stage),
    settings=lambda settings: settings.trend,
    load=load_histories,
    compute=own,
    counted=Counted(looked="wheelsets", changed="refreshed", same="unchanged"),
    numbers=NUMBERS,
    results=OWN_WEAR,
    at_once=32,
)
OF_ALL = Stage(
    name=FLEET_WEAR.stage,
    job=OF_WHEELSETS.job,
    kind=FLEET_WEAR.subject,
    facets=(Facet.REGISTRY, OWN_WEAR.stage),
    settings=lambda _: (),
    load=load_fleet,
    compute=together,
    counted=Counted(looked="looks", changed="learnt"),
    numbers=NUMBERS,
    results=FLEET_WEAR,
    together=True,
    here=True,
)


JOB = Job(
    name=OF_WHEELSETS.job,
    description="Learn from the wheelsets of a fleet how they wear",
    every_s=DAY_S,
    run=partial(run_counted, (OF_WHEELSETS, OF_ALL)),
)
