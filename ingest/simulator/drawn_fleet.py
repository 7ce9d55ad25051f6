"""The wheelsets of a fleet: listed in the tables of vehicles, or drawn.

Of those that are drawn wear is by rank or distribution, wheel and rail by seed.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Self, TypeVar

import numpy as np
from annotated_types import Interval, Len

from estimation.contact.wear import TreadWear, WearFamily, wear_course
from estimation.errors import ScenarioError
from estimation.values.arrays import FloatArray
from estimation.values.fields import KM, KM_H, MM, FileUnit, Key
from estimation.values.registry import MAX_AXLES
from estimation.values.units import GRAVITY
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, Arrangement, BogieParameters, VehicleParameters
from ingest.file_value import FileBeside, IncreasingPlaces, Inline, between, taken
from ingest.input_file import NotNegative, Positive, Text, field_error
from ingest.simulator.drawn_plan import DrawnFleet, ProfilePair, Wear, WearDistribution
from ingest.simulator.scenario import (
    Fault,
    Scenario,
    Stream,
    VehicleErrors,
    VehiclePlan,
    WeakDamper,
    WheelsetPlan,
    generator,
    usual_offsets,
)
from ingest.simulator.section import RailFiles, SideFiles, WheelName

MOST_DRAWS = 1000  # of a wear within its limits
NORMAL_95 = 1.96  # a 95 % limit in standard deviations
WEAR_SHARES = (1.0, 0.85, 0.7, 0.5, 1.5)  # tried in turn until a wheelset stays on the rails


def with_seed(scenario: Scenario, seed: int) -> Scenario:
    """Return the scenario with another seed; wheel, rail and wear of a drawn fleet are those of the seed."""
    if scenario.drawn is None:
        return replace(scenario, seed=seed)
    pair = scenario.drawn.pairs[seed % len(scenario.drawn.pairs)]
    rails = {item.name: getattr(pair, item.name) for item in fields(RailFiles)}
    if pair.rail_files == (None, None):  # files of the section keep the inclination that it has itself
        rails = {"built_inclination": scenario.section.file_inclination}
    section = replace(scenario.section, rail_profile=pair.rail_profile, inclination=pair.inclination, **rails)
    return replace(scenario, seed=seed, section=section, vehicles=_vehicles(scenario, scenario.drawn, seed))


def drawn_serial(rank: int) -> str:
    """Return the serial of the wheelset at a place of a drawn fleet, from 0."""
    return f"W{rank:02d}"


def with_less_wear(scenario: Scenario, vehicle: str, axle: int, share: float) -> Scenario:
    """Return the scenario with ``share`` of the wear of one wheelset."""
    worn = scenario.vehicle(vehicle).wheelsets[axle]
    less = replace(worn, initial_left=share * worn.initial_left, initial_right=share * worn.initial_right)
    return with_wheelset(scenario, vehicle, axle, less)


def with_wheelset(scenario: Scenario, vehicle: str, axle: int, wheelset: WheelsetPlan) -> Scenario:
    """Return the scenario with another wheelset at one place."""
    plan = scenario.vehicle(vehicle)
    wheelsets = tuple(wheelset if place == axle else item for place, item in enumerate(plan.wheelsets))
    changed = replace(plan, wheelsets=wheelsets)
    return replace(scenario, vehicles=tuple(changed if item is plan else item for item in scenario.vehicles))


def vehicle_parameters(scenario: Scenario, vehicle: str) -> VehicleParameters:
    """Return the true parameters of a vehicle: those of the scenario, or drawn around them."""
    assumed, limits = scenario.parameters, scenario.vehicle_errors
    if limits is None:
        return assumed
    creep = 1.0 + limits.creep / NORMAL_95 * generator(scenario.seed, Stream.CREEP).standard_normal()
    lateral, yaw, wheelset, body = _draws(scenario, vehicle)
    return _scaled(
        assumed,
        (creep, "longitudinal_creep_coefficient lateral_creep_coefficient lateral_spin_creep_coefficient"),
        (1.0 + limits.stiffness * lateral, "lateral_stiffness"),
        (1.0 + limits.stiffness * yaw, "yaw_stiffness"),
        (1.0 + limits.mass * wheelset, "wheelset_mass yaw_inertia pitch_inertia"),
        (1.0 + limits.mass * body, "suspended_mass load"),
    )


def vehicle_bogie(scenario: Scenario, vehicle: str) -> BogieParameters | None:
    """Return the true parameters of a vehicle's bogies; masses are as far off as its suspended mass."""
    assumed, limits = scenario.bogie, scenario.vehicle_errors
    if assumed is None or limits is None:
        return assumed
    lateral, yaw, _, body = _draws(scenario, vehicle)
    return _scaled(
        assumed,
        (1.0 + limits.mass * body, "frame_mass frame_yaw_inertia body_mass"),
        (1.0 + limits.stiffness * lateral, "secondary_lateral_stiffness"),
        (1.0 + limits.stiffness * yaw, "secondary_yaw_stiffness"),
    )


_Parameters = TypeVar("_Parameters", VehicleParameters, BogieParameters)


def _scaled(assumed: _Parameters, *factors: tuple[float, str]) -> _Parameters:
    """Return parameters of which some, named with blanks between, are multiplied by factors."""
    scaled = {name: factor * getattr(assumed, name) for factor, names in factors for name in names.split()}
    return replace(assumed, **scaled)


def _draws(scenario: Scenario, vehicle: str) -> FloatArray:
    limits = scenario.vehicle_errors or VehicleErrors()
    codes = limits.fleet or tuple(plan.code for plan in scenario.vehicles)
    seed = scenario.seed if limits.seed is None else limits.seed
    return np.asarray(generator(seed, Stream.VEHICLE, codes.index(vehicle)).standard_normal(4) / NORMAL_95)


def shares_of_wear(plan: WheelsetPlan) -> tuple[float, ...]:
    """Return which shares of its wear are tried in turn with a wheelset that derails; none of what has no wear."""
    return WEAR_SHARES if plan.initial_left or plan.initial_right else WEAR_SHARES[:1]


def no_wear_left(scenario: Scenario, vehicle: str, axle: int, last: ScenarioError) -> ScenarioError:
    """Return the error of a wheelset that derails with every share of its wear."""
    plan = scenario.vehicle(vehicle).wheelsets[axle]
    if shares_of_wear(plan) != WEAR_SHARES:
        return ScenarioError(f"seed {scenario.seed}: {last.reason}", field=last.field)
    shares = ", ".join(f"{share:.0%}" for share in WEAR_SHARES)
    return ScenarioError(
        f"wheelset {plan.serial} of seed {scenario.seed} derails with {shares} of its wear; less wear or a lower speed "
        f"keeps it from hunting (the last time: {last.reason})",
        field="drawn_fleet.pairs.deepest_wear_mm",
    )


def _vehicles(scenario: Scenario, fleet: DrawnFleet, seed: int) -> tuple[VehiclePlan, ...]:
    """Return the vehicles: wheelsets are numbered across the vehicles, the first axle of all before the second."""
    return tuple(
        VehiclePlan(
            code=f"V{number}",
            vehicle_class=fleet.vehicle_class,
            max_speed=fleet.max_speed,
            axle_offsets=usual_offsets(len(ranks), scenario.bogie),
            wheelsets=tuple(_wheelset(scenario, fleet, seed, rank) for rank in ranks),
        )
        for number in range(fleet.vehicles)
        for ranks in [range(number, fleet.places, fleet.vehicles)]
    )


def _wheelset(scenario: Scenario, fleet: DrawnFleet, seed: int, rank: int) -> WheelsetPlan:
    pair = fleet.pairs[seed % len(fleet.pairs)]
    rng = generator(seed, Stream.WEAR, rank)
    depth, apart = _depth(fleet, pair, rank, rng), rng.normal(0.0, fleet.wear.asymmetry)
    if fleet.wear_alike:
        depth, apart = pair.deepest_wear * 0.5, 0.0
    smaller, uneven = generator(seed, Stream.DIAMETER, rank).standard_normal(2)
    files: tuple[SideFiles, ...] = pair.wheel_files or ((None, None),)
    place = int(generator(seed, Stream.WHEEL, rank).integers(len(files))) if pair.wheels_drawn else rank
    course = _usual_wear(pair.wheel_profile)
    return WheelsetPlan(
        serial=drawn_serial(rank),
        wheel_profile=pair.wheel_profile,
        nominal_radius=scenario.parameters.nominal_radius + fleet.radius_std * smaller,
        rate_left=0.0,
        rate_right=0.0,
        wear_centre=course.centre,
        wear_half_width=course.half_width,
        flange_share=1.0,  # the flange loses as much as the tread: ``estimation.contact.wear.wear_course``
        initial_left=depth * (1.0 + apart),
        initial_right=depth * (1.0 - apart),
        initial_mileage=0.0,
        reprofilings=(),
        diameter_difference=fleet.diameter_difference_std * uneven,
        fault=None,
        wheel_files=files[place % len(files)],
    )


def _usual_wear(wheel_profile: str) -> TreadWear:
    return wear_course(WearFamily.S1002_ON_60E1 if "1002" in wheel_profile else WearFamily.P8_ON_56E1, 0.0)


def _depth(fleet: DrawnFleet, pair: ProfilePair, rank: int, rng: np.random.Generator) -> float:
    wear = fleet.wear
    highest = pair.deepest_wear if wear.highest is None else wear.highest
    if wear.distribution is WearDistribution.STEPS:
        return highest * ((rank + rng.uniform()) / fleet.places)
    if wear.distribution is WearDistribution.UNIFORM:
        return rng.uniform(wear.lowest, highest)
    for _ in range(MOST_DRAWS):
        if wear.distribution is WearDistribution.NORMAL:
            depth = rng.normal(wear.mean, wear.std)
        else:
            variance = math.log1p((wear.std / wear.mean) ** 2)  # of the logarithm
            depth = rng.lognormal(math.log(wear.mean) - 0.5 * variance, math.sqrt(variance))
        if wear.lowest <= depth <= highest:
            return depth
    reason = f"{MOST_DRAWS} draws gave no wear between {1e3 * wear.lowest:g} and {1e3 * highest:g} mm"
    raise ScenarioError(reason, field="drawn_fleet.wear.mean_mm")


ROUNDING = 1e-3  # m, of axle offsets
FLANGE_SHARE = 0.6
Rate = Annotated[float, between(0.0, 20.0), FileUnit("_mm_per_100000_km", 1e-3 / 1e8)]


def impossible_bogies(offsets: Sequence[float], wheelbase: float) -> str | None:
    """Return why axles at ``offsets`` are not in bogies of ``wheelbase``, both m; None where they are."""
    if len(offsets) % AXLES_OF_A_BOGIE:
        return f"{len(offsets)} wheelsets, bogies have two each"
    for front, rear in zip(offsets[::2], offsets[1::2], strict=True):
        if abs(rear - front - wheelbase) > ROUNDING:
            return f"axles at {front:g} and {rear:g} m are not {wheelbase:g} m apart, the wheelbase of their bogie"
    return None


@dataclass(frozen=True, slots=True)
class DynamicsTable:
    """``[dynamics]``: parameters of the vehicle by their names, in SI units.

    Where the table has none, the load is the whole axle load, and the suspended mass of a wheelset in a bogie half of
    what is above both.
    """

    parameters: Annotated[VehicleParameters, Inline(VehicleParameters)] = field(
        default_factory=lambda: replace(VehicleParameters(), load=VehicleParameters().axle_load)
    )
    arrangement: Arrangement = Arrangement.SINGLE_WHEELSET
    bogie: BogieParameters | None = None

    def of_file(self, given: Collection[str]) -> Self:
        """Refuse bogies without parameters, and the reverse."""
        wanted = self.arrangement is Arrangement.BOGIE
        if wanted and self.bogie is None:
            raise field_error("is missing; the arrangement needs it", "bogie")
        if not wanted and self.bogie is not None:
            raise field_error(f"arrangement = {str(Arrangement.BOGIE)!r} is needed beside it", "bogie")
        parameters = self.parameters
        if self.bogie is None:
            load = parameters.axle_load
        else:
            above = (self.bogie.frame_mass + self.bogie.body_mass) / AXLES_OF_A_BOGIE
            load = (parameters.wheelset_mass + above) * GRAVITY
            if "suspended_mass" not in given:
                parameters = replace(parameters, suspended_mass=above)
        return replace(self, parameters=parameters if "load" in given else replace(parameters, load=load))


@dataclass(frozen=True, slots=True)
class WheelsetTable:
    """``[[vehicles.wheelsets]]``."""

    serial: Text
    wheel_profile: WheelName = "P8"
    nominal_radius: Annotated[float, between(150.0, 700.0), MM] | None = None
    wear: Rate = 0.0
    wear_left: Rate | None = None
    wear_right: Rate | None = None
    wear_centre: Annotated[float, between(-30.0, 30.0), MM] | None = None
    wear_half_width: Annotated[float, between(5.0, 100.0), MM] | None = None
    flange_wear_share: Annotated[float, between(0.0, 2.0)] = FLANGE_SHARE
    initial_wear: Wear = 0.0
    initial_wear_left: Wear | None = None
    initial_wear_right: Wear | None = None
    initial_mileage: Annotated[NotNegative, KM] = 0.0
    reprofiled: Annotated[IncreasingPlaces, Key("reprofiled_at_odometer_km")] = ()  # km
    reprofilings_registered: bool = True
    diameter_difference: Annotated[float, between(-5.0, 5.0), MM] = 0.0
    wheel_file: FileBeside | None = None
    wheel_left_file: FileBeside | None = None
    wheel_right_file: FileBeside | None = None
    fault: Fault | None = None

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse two files of one wheel."""
        if self.wheel_file is not None and (self.wheel_left_file, self.wheel_right_file) != (None, None):
            raise field_error("cannot be given beside the files of one side", "wheel_file")
        return self

    def plan(self, radius: float) -> WheelsetPlan:
        """Return the wheelset; where wear is not located, as measured on such wheels."""
        course = _usual_wear(self.wheel_profile)
        centre, half_width = self.wear_centre, self.wear_half_width
        initial_left, initial_right = self.initial_wear_left, self.initial_wear_right
        return taken(
            WheelsetPlan,
            self,
            nominal_radius=radius if self.nominal_radius is None else self.nominal_radius,
            rate_left=self.wear if self.wear_left is None else self.wear_left,
            rate_right=self.wear if self.wear_right is None else self.wear_right,
            wear_centre=1e-3 * (course.centre / 1e-3) if centre is None else centre,
            wear_half_width=1e-3 * (course.half_width / 1e-3) if half_width is None else half_width,
            flange_share=self.flange_wear_share,
            initial_left=self.initial_wear if initial_left is None else initial_left,
            initial_right=self.initial_wear if initial_right is None else initial_right,
            reprofilings=tuple(1e3 * odometer_km for odometer_km in self.reprofiled),
            wheel_files=(self.wheel_file or self.wheel_left_file, self.wheel_file or self.wheel_right_file),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleTable:
    """``[[vehicles]]``."""

    code: Text
    vehicle_class: Annotated[Text, Key("class")]
    max_speed: Annotated[float, Interval(gt=0.0, le=400.0), KM_H]
    axle_offsets: Annotated[IncreasingPlaces, Key("axle_offsets_m")] | None = None
    longest_run: Annotated[Positive, FileUnit("", 60.0), Key("minutes_each")] = math.inf
    wheelsets: Annotated[tuple[WheelsetTable, ...], Len(1, MAX_AXLES)]
    weak_damper: WeakDamper | None = None

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse another number of offsets than of wheelsets."""
        offsets = self.axle_offsets
        if offsets is not None and len(offsets) != len(self.wheelsets):
            raise field_error(f"{len(offsets)} offsets for {len(self.wheelsets)} wheelsets", "axle_offsets_m")
        return self

    def offsets(self, bogie: BogieParameters | None) -> tuple[float, ...]:
        """Return the distances of the axles behind the position reference, m."""
        return usual_offsets(len(self.wheelsets), bogie) if self.axle_offsets is None else self.axle_offsets

    def plan(self, radius: float, bogie: BogieParameters | None) -> VehiclePlan:
        """Return the vehicle."""
        wheelsets = tuple(wheelset.plan(radius) for wheelset in self.wheelsets)
        return taken(VehiclePlan, self, axle_offsets=self.offsets(bogie), wheelsets=wheelsets)
