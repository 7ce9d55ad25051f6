"""The motion of the wheelsets of a vehicle over one run, each on its own contact geometry."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import convolve1d

from estimation.contact.geometry import ContactTable
from estimation.errors import ContactError, ProfileError, ScenarioError
from estimation.values.arrays import FloatArray
from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, BogieParameters
from ingest.simulator.campaign import VehicleRun, friction_factor, with_stretches
from ingest.simulator.drawn_fleet import vehicle_bogie, vehicle_parameters
from ingest.simulator.motion import WheelsetMotion, simulate_wheelset
from ingest.simulator.running_gear import RunningGear, Wheel, simulate_gear
from ingest.simulator.scenario import Scenario, Stream, VehiclePlan, WheelsetPlan, generator
from ingest.simulator.track import TrackTruth
from ingest.simulator.wear import GeometryTruth, WornContact, section_at, truth_of, wear_at, worn_contact

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
    varied = track.surface is not None or bool(scenario.running.stretches)
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


def wheelset_motion(
    scenario: Scenario, track: TrackTruth, run: VehicleRun, axle: int, table: ContactTable | None = None
) -> WheelsetMotion:
    """Return the true motion of the wheelset at ``axle`` (from 0) over ``run``.

    ``table`` is its contact geometry where that is at hand already; made here otherwise.
    """
    axles = together(scenario, run.vehicle, axle)
    known = [table if place == axle else None for place in axles]
    return axle_motions(scenario, track, run, axles, known)[axles.index(axle)]


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
    tables: Sequence[ContactTable | None],
) -> tuple[WheelsetMotion, ...]:
    """Return the true motion of the wheelsets at ``axles`` (from 0), which move together, over ``run``.

    Contact geometry that is None is computed here.
    """
    found = [
        contact_of(scenario, track, run.vehicle.wheelsets[axle], run.odometer).table if table is None else table
        for axle, table in zip(axles, tables, strict=True)
    ]
    start = float(run.distance[0]) - run.vehicle.axle_offsets[axles[0]]
    contacts = [averaged(table, scenario.running.contact_half_width) for table in found]
    gear = running_gear(scenario, run, axles)
    track = with_stretches(track, scenario.running, run.campaign, gear.creep.friction)
    if scenario.bogie is None and scenario.running.plain:
        alone = replace(gear.parameters, nominal_radius=gear.nominal_radii[0])
        motions: tuple[WheelsetMotion, ...] = (simulate_wheelset(alone, contacts[0], track, run.speed, start),)
    else:
        motions = simulate_gear(gear, contacts, track, run.speed, start)
    for axle, table, motion in zip(axles, found, motions, strict=True):
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
    running = scenario.running
    parameters, bogie = true_suspension(scenario, run.vehicle, axles[0], run.campaign)
    shares = running.shares_of_traction(len(run.vehicle.wheelsets))
    factor = friction_factor(running, scenario.seed, run.campaign)
    return RunningGear(
        parameters=parameters,
        bogie=bogie,
        creep=replace(running.creep, friction=min(factor * running.creep.friction, 1.0)),
        wheels=tuple(_wheels(scenario, run, axle) for axle in axles) if running.out_of_round else (),
        traction=tuple(shares[axle] for axle in axles) if running.traction else None,
        braking=(1.0,) * len(axles) if running.traction else None,
        nominal_radii=tuple(run.vehicle.wheelsets[axle].nominal_radius for axle in axles),
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


def _wheels(scenario: Scenario, run: VehicleRun, axle: int) -> tuple[Wheel, Wheel]:
    order = scenario.vehicles.index(run.vehicle)
    phases = generator(scenario.seed, Stream.OUT_OF_ROUND, order, axle, run.campaign).uniform(0.0, 2.0 * np.pi, 2)
    left, right = (Wheel(scenario.running.out_of_round, float(phase)) for phase in phases)
    return left, right


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
        section, step = section_at(scenario, odometer), scenario.running.contact_step
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
