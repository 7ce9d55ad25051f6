"""The wheelsets of a vehicle: wear that grows with mileage, the contact geometry with it, and their motion in a run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.ndimage import convolve1d

from estimation.contact.conicity import equivalent_conicity, nonlinearity_parameter, zero_crossing
from estimation.contact.geometry import ContactTable, WheelsetOnTrack, contact_table, refined_curve
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.wear import RailWear, TreadWear, worn, worn_rail
from estimation.errors import ContactError, ProfileError, ScenarioError
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, BogieParameters, VehicleParameters
from ingest.profiles.files import read_profile, read_wheel_profile
from ingest.simulator.campaign import VehicleRun, friction_factor, with_stretches
from ingest.simulator.drawn_fleet import vehicle_bogie, vehicle_parameters
from ingest.simulator.motion import WheelsetMotion
from ingest.simulator.rates import ROUND, Wheels
from ingest.simulator.running import CONTACT_STEP
from ingest.simulator.running_gear import RunningGear, simulate_gear
from ingest.simulator.scenario import Scenario, Stream, VehiclePlan, WheelsetPlan, generator
from ingest.simulator.section import SectionPlan
from ingest.simulator.track import TrackTruth


def section_at(scenario: Scenario, odometer: float) -> SectionPlan:
    """Return the section as its rails are when the vehicles' odometer stands at ``odometer``, m."""
    section, sessions = scenario.section, scenario.sessions
    days = (odometer - sessions.first_odometer) / sessions.distance_per_day
    wear = section.rail_wear and section.rail_wear.after(section.tonnage or 0.0, days)
    return replace(section, rail_wear=wear)


@lru_cache(maxsize=256)
def wheel_in(path: Path) -> Profile:
    """Return the wheel profile in a file, read once in a process."""
    return read_wheel_profile(path)


@lru_cache(maxsize=16)
def rail_in(path: Path, mirror: bool | None) -> Profile:  # noqa: FBT001 - a place beside the path, as the plans have it
    """Return the rail profile in a file, read once in a process.

    ``mirror``: whether its gauge side is at positive y of the file; None decides from the shape.
    """
    return read_profile(path, "rail", mirror=mirror)


def rails_of(section: SectionPlan) -> tuple[Profile, Profile, float]:
    """Return left and right rail of a section as worn, and the inclination (a tangent) that is to be given to them."""
    left = right = rail_profile(section.rail_profile)
    inclination = section.inclination
    if section.rail_files != (None, None):
        inclination = section.file_inclination
        left, right = (
            rail_profile(section.rail_profile) if path is None else rail_in(path, mirror)
            for path, mirror in zip(section.rail_files, section.rail_mirrors, strict=True)
        )
    wear = section.rail_wear
    if wear is not None:
        left, right = (
            worn_rail(rail, RailWear(depth, wear.centre, wear.half_width))
            for rail, depth in zip((left, right), wear.depths, strict=True)
        )
    return left, right, inclination


AMPLITUDES = tuple(float(a) for a in np.arange(2, 21) * 0.25e-3)  # m


@dataclass(frozen=True, slots=True)
class WearState:
    """Wear of a wheelset at one moment; m."""

    mileage: float  # since new
    reprofilings: int  # so far
    depth_left: float
    depth_right: float


def wear_at(plan: WheelsetPlan, odometer: float) -> WearState:
    """Return the wear when the vehicle's odometer stands at ``odometer``, m; the lathe takes all of it away."""
    done = [place for place in plan.reprofilings if place <= odometer]
    since = odometer - done[-1] if done else odometer
    left, right = (0.0, 0.0) if done else (plan.initial_left, plan.initial_right)
    return WearState(
        plan.initial_mileage + odometer, len(done), left + plan.rate_left * since, right + plan.rate_right * since
    )


@dataclass(frozen=True, slots=True)
class WornContact:
    """A worn wheelset on a section, and its contact geometry."""

    wheelset: WheelsetOnTrack
    table: ContactTable


def worn_contact(
    plan: WheelsetPlan,
    wear: WearState,
    section: SectionPlan,
    gauge_deviation: FloatArray,
    limit: float,
    step: float = CONTACT_STEP,
) -> WornContact:
    """Return the contact geometry of a worn wheelset on ``section`` at gauge deviations (g,), m; rigid with roll."""
    wheelset = _on_track(plan, wear, section)
    half = round(limit / step)
    grid = np.asarray(step * np.arange(-half, half + 1))
    return WornContact(wheelset, contact_table(wheelset, grid, gauge_deviation, outside="hold"))


def _on_track(plan: WheelsetPlan, wear: WearState, section: SectionPlan) -> WheelsetOnTrack:
    left_rail, right_rail, inclination = rails_of(section)
    left_wheel, right_wheel = worn_profiles(plan, wear)
    return WheelsetOnTrack(
        left_wheel=left_wheel,
        right_wheel=right_wheel,
        left_rail=left_rail,
        right_rail=right_rail,
        inclination=inclination,
        gauge=section.nominal_gauge,
        left_radius=plan.nominal_radius + 0.25 * plan.diameter_difference,
        right_radius=plan.nominal_radius - 0.25 * plan.diameter_difference,
    )


@dataclass(frozen=True, slots=True)
class GeometryTruth(FrozenArrays):
    """True contact geometry of a wheelset at nominal gauge as EN 15302 means it: rigid, without roll.

    The curves are those of such a contact table; conicity, nonlinearity and zero crossing have every contact jump where
    it is, and are NaN where they reach beyond the last displacement with contact.
    """

    lateral_displacement: Annotated[FloatArray, "n"]  # m
    rolling_radius_sum: Annotated[FloatArray, "n"]  # m
    rolling_radius_difference: Annotated[FloatArray, "n"]  # m
    contact_angle_sum: Annotated[FloatArray, "n"]  # rad
    contact_angle_difference: Annotated[FloatArray, "n"]  # rad
    amplitude: Annotated[FloatArray, "k"]  # (k,) m
    equivalent_conicity: Annotated[FloatArray, "k"]  # (k,)
    nonlinearity: float  # 1/mm
    zero_crossing: float  # m


def truth_of(contact: WornContact) -> GeometryTruth:
    """Return the true geometry of a worn wheelset at nominal gauge, whatever gauge its line has."""
    grid = contact.table.lateral_displacement
    table = contact_table(contact.wheelset, grid, method=ContactMethod.EN15302, outside="hold")
    curve = refined_curve(contact.wheelset, table, 0)
    x, R = curve.displacement, curve.difference
    return GeometryTruth(
        lateral_displacement=table.lateral_displacement,
        rolling_radius_sum=table.rolling_radius_sum[:, 0],
        rolling_radius_difference=table.rolling_radius_difference[:, 0],
        contact_angle_sum=table.contact_angle_sum[:, 0],
        contact_angle_difference=table.contact_angle_difference[:, 0],
        amplitude=np.array(AMPLITUDES),
        equivalent_conicity=equivalent_conicity(x, R, AMPLITUDES),
        nonlinearity=nonlinearity_parameter(x, R),
        zero_crossing=zero_crossing(x, R),
    )


def worn_profiles(plan: WheelsetPlan, wear: WearState) -> tuple[Profile, Profile]:
    """Return the profiles of the left and the right wheel of ``plan`` after that wear."""
    left, right = (wheel_profile(plan.wheel_profile) if path is None else wheel_in(path) for path in plan.wheel_files)
    return _worn(plan, left, wear.depth_left), _worn(plan, right, wear.depth_right)


def _worn(plan: WheelsetPlan, wheel: Profile, depth: float) -> Profile:
    if depth == 0.0:
        return wheel
    return worn(wheel, TreadWear(depth, plan.wear_centre, plan.wear_half_width, plan.flange_share * depth))


DISPLACEMENT_LIMIT = 8e-3  # m
DRAWN_LIMIT = 12e-3  # m, the same of a drawn fleet, whose worn wheelsets swing further
DRAWN_LIMIT_WIDE = 15e-3  # m, the same where gauge varies: flanges are further apart in wide gauge
GAUGE_LIMIT = 10e-3  # m, of a listed fleet where gauge varies: flange contact is at some 7 mm
ROUGH_LIMIT = 15e-3  # m, on tracks and with wheels as they are recorded: flanges run up to 10 mm, and come back
LIMIT_STEP = 0.5e-3  # m
GAUGE_STEP = 0.5e-3  # m: contact jumps move over y - d by half the gauge deviation, and tables blend between steps


def gauge_grid(track: TrackTruth) -> FloatArray:
    """Return the gauge deviations (g,) that a contact table needs for ``track``: one where the gauge is constant."""
    low, high = track.gauge_range()
    if high - low < 1e-9:  # noqa: PLR2004 - a nanometre is constant
        return np.array([0.5 * (low + high)])
    first, last = np.floor(low / GAUGE_STEP), np.ceil(high / GAUGE_STEP)
    return np.asarray(GAUGE_STEP * np.arange(first, last + 1.0))


def displacement_limit(scenario: Scenario, track: TrackTruth) -> float:
    """Return the lateral displacement, m, beyond which a wheelset of the scenario derails."""
    recipe = scenario.section.recipe
    _, widest = track.gauge_range()
    more = LIMIT_STEP * math.ceil(0.5 * max(widest, 0.0) / LIMIT_STEP - 1e-9)
    varied = track.surface is not None or bool(scenario.creep.stretches)
    if recipe is None or not recipe.plain or scenario.files or varied:
        return ROUGH_LIMIT + more
    if recipe.gauge_std > 0.0:
        wide = GAUGE_LIMIT + more
        return wide if scenario.drawn is None else max(wide, DRAWN_LIMIT_WIDE)
    return more + (DISPLACEMENT_LIMIT if scenario.drawn is None else DRAWN_LIMIT)


def first_climb(table: ContactTable, motion: WheelsetMotion) -> int | None:
    """Return the first sample of a motion at which a wheel climbs its rail; None where there is none.

    A wheel climbs where the wheelset is beyond the table, or where the table has no contact of both wheels (its values
    are those of the nearest displacement that has one).
    """
    if motion.outside == 0 and table.exists.all():
        return None
    x = table.lateral_displacement
    first = np.argmax(table.exists, axis=0)
    last = len(x) - 1 - np.argmax(table.exists[::-1], axis=0)
    low = np.interp(motion.gauge_deviation, table.gauge_deviation, x[first])
    high = np.interp(motion.gauge_deviation, table.gauge_deviation, x[last])
    beyond = ~((motion.relative_displacement >= low) & (motion.relative_displacement <= high))  # NaN is beyond
    return int(np.argmax(beyond)) if beyond.any() else None


MEANS = ("rolling_radius_left", "rolling_radius_right", "contact_angle_left", "contact_angle_right", "roll")


class DerailmentError(ScenarioError):
    """A wheelset leaves the range of its contact geometry; ``axle`` (from 0) says which."""

    axle: int = 0


def together(scenario: Scenario, vehicle: VehiclePlan, axle: int) -> tuple[int, ...]:
    """Return the axles (from 0) that move together with ``axle``: those of its bogie, or itself alone."""
    if scenario.bogie is None:
        return (axle,)
    first = axle - axle % AXLES_OF_A_BOGIE
    return tuple(range(first, min(first + AXLES_OF_A_BOGIE, len(vehicle.wheelsets))))


def axle_motions(
    scenario: Scenario,
    track: TrackTruth,
    run: VehicleRun,
    axles: Sequence[int],
    tables: Sequence[ContactTable],
) -> tuple[WheelsetMotion, ...]:
    """Return the true motion of the wheelsets at ``axles`` (from 0), which move together, over ``run``."""
    start = float(run.distance[0]) - run.vehicle.axle_offsets[axles[0]]
    contacts = [averaged(table, scenario.wheels.contact_half_width) for table in tables]
    gear = running_gear(scenario, run, axles)
    track = with_stretches(track, scenario.creep, run.campaign, gear.creep.friction)
    motions = simulate_gear(gear, contacts, track, run.speed, start)
    for axle, table, motion in zip(axles, tables, motions, strict=True):
        at = first_climb(table, motion)
        if at is None:
            continue
        error = DerailmentError(
            f"{run.vehicle.wheelsets[axle].serial} derails in campaign {run.campaign + 1}: at "
            f"{motion.distance[at]:.1f} m of the section a wheel climbs its rail, "
            f"{1e3 * motion.relative_displacement[at]:+.1f} mm beside the track centre in "
            f"{1e3 * motion.gauge_deviation[at]:+.1f} mm of gauge deviation",
            field=f"vehicles.{run.vehicle.code}",
        )
        error.axle = axle
        raise error
    return motions


def running_gear(scenario: Scenario, run: VehicleRun, axles: Sequence[int]) -> RunningGear:
    """Return the true running gear of the wheelsets at ``axles`` (from 0), which move together, in one run."""
    parameters, bogie = true_suspension(scenario, run.vehicle, axles[0], run.campaign)
    radii = tuple(run.vehicle.wheelsets[axle].nominal_radius for axle in axles)
    if bogie is None:
        parameters = replace(parameters, nominal_radius=radii[0])
    shares = None if scenario.traction is None else scenario.traction.shares(len(run.vehicle.wheelsets))
    friction = min(friction_factor(scenario, run.campaign) * scenario.creep.friction, 1.0)
    return RunningGear(
        parameters=parameters,
        bogie=bogie,
        creep=replace(scenario.creep, friction=friction),
        wheels=tuple(_wheels(scenario, run, axle) if scenario.wheels.out_of_round else ROUND for axle in axles),
        traction=None if shares is None else tuple(shares[axle] for axle in axles),
        nominal_radii=radii,
    )


def true_suspension(
    scenario: Scenario, vehicle: VehiclePlan, axle: int, campaign: int
) -> tuple[VehicleParameters, BogieParameters | None]:
    """Return the true parameters of the running gear of an axle: of its vehicle, less what its damper has lost."""
    parameters, bogie = vehicle_parameters(scenario, vehicle.code), vehicle_bogie(scenario, vehicle.code)
    weak, gear = vehicle.weak_damper, axle if bogie is None else axle // AXLES_OF_A_BOGIE
    if weak is None or campaign + 1 < weak.from_campaign or weak.running_gear not in (None, gear + 1):
        return parameters, bogie
    if bogie is None:
        return replace(parameters, lateral_damping=weak.share * parameters.lateral_damping), None
    return parameters, replace(bogie, secondary_lateral_damping=weak.share * bogie.secondary_lateral_damping)


def _wheels(scenario: Scenario, run: VehicleRun, axle: int) -> Wheels:
    rng = generator(scenario.seed, Stream.OUT_OF_ROUND, scenario.vehicles.index(run.vehicle), axle, run.campaign)
    left, right = rng.uniform(0.0, 2.0 * np.pi, 2).tolist()
    return Wheels((scenario.wheels.out_of_round,) * 2, (left, right))


def averaged(table: ContactTable, half_width: float) -> ContactTable:
    """Return a contact table whose radii, angles and roll are means over a contact of finite size.

    The mean is over a semi-ellipse of lateral displacement of this half width, m; 0 leaves the table as it is.
    """
    step = float(table.lateral_displacement[1] - table.lateral_displacement[0])
    reach = int(half_width / step)
    if reach == 0:
        return table
    weights = np.sqrt(1.0 - (step * np.arange(-reach, reach + 1) / half_width) ** 2)
    weights /= weights.sum()
    means: dict[str, Any] = {name: convolve1d(getattr(table, name), weights, axis=0, mode="nearest") for name in MEANS}
    return replace(table, **means)


def contact_of(scenario: Scenario, track: TrackTruth, plan: WheelsetPlan, odometer: float) -> WornContact:
    """Return the contact geometry of a wheelset at one mileage of its vehicle."""
    gauges, limit = gauge_grid(track), displacement_limit(scenario, track)
    with _named(scenario, plan):
        section, step = section_at(scenario, odometer), scenario.wheels.contact_step
        return worn_contact(plan, wear_at(plan, odometer), section, gauges, limit, step)


def true_geometry(scenario: Scenario, plan: WheelsetPlan, contact: WornContact) -> GeometryTruth:
    """Return the true geometry of a wheelset at nominal gauge."""
    with _named(scenario, plan):
        return truth_of(contact)


@contextmanager
def _named(scenario: Scenario, plan: WheelsetPlan) -> Iterator[None]:
    """Name wheelset and section in what profiles and contact search raise."""
    try:
        yield
    except (ContactError, ProfileError) as error:
        raise ScenarioError(f"{plan.serial} on {scenario.section.code}: {error.reason}", field=error.field) from error
