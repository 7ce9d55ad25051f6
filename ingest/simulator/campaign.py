"""One vehicle over one recorded run: its speed, its place on the track, and what each wheelset's node measures.

Push-pull trains: every second run of a vehicle is with its rear end first.

Such a vehicle is simulated as what it is to the track: one that runs forward with its wheelsets in the other order and
each turned half round. Its nodes keep their places and axes, which point against the direction of travel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtr

from estimation.errors import ParameterError, ScenarioError
from estimation.values.arrays import FloatArray, FrozenArrays
from ingest.simulator.irregularity import Waves, superpose
from ingest.simulator.motion import STEP, WheelsetMotion, travelled
from ingest.simulator.running import CONTACT_STEP, STRETCH_END, CreepPlan, with_flat, with_track_blows
from ingest.simulator.scenario import (
    NORMAL_REACH,
    Scenario,
    Stream,
    VehiclePlan,
    WheelsetPlan,
    generator,
    seed_of,
)
from ingest.simulator.sensor_errors import SensorErrors, draw_node_errors
from ingest.simulator.sensors import SensorRecord, draw_offsets, measure
from ingest.simulator.track import Surface, TrackRecipe, TrackTruth, from_zero, make_track, read_track

RAIL_DISTANCE = 1.5  # m, over which cross level is measured (EN 13848-1)
LEAST_LOAD = 0.2  # of the mean: wheels stay on the rails


def with_surface(track: TrackTruth, scenario: Scenario) -> TrackTruth:
    """Return the track with what the scenario draws along it; each has a random stream of its own."""
    section, creep, seed = scenario.section, scenario.creep, scenario.seed
    if section.cross_level is None and section.load_variation is None and not creep.varies:
        return track
    n = len(track.s)
    roll, friction, load = np.zeros(n), np.ones(n), np.ones(n)
    if section.cross_level is not None:
        roll = _drawn(track, section.cross_level, generator(seed, Stream.CROSS_LEVEL), "cross_level") / RAIL_DISTANCE
    if creep.varies:
        friction = friction_along(creep, n, track.interval, generator(seed, Stream.FRICTION)) / creep.friction
    if section.load_variation is not None:
        varied = 1.0 + _drawn(track, section.load_variation, generator(seed, Stream.LOAD), "load_variation")
        load = np.maximum(varied, LEAST_LOAD)
    return replace(track, surface=Surface(roll, friction, load))


def friction_along(creep: CreepPlan, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """Return the coefficient of friction (n,): every value between the limits is as frequent, changes are smooth."""
    (lowest, highest), width = creep.limits, creep.correlation / interval
    reach = int(np.ceil(4.0 * width))
    smooth = gaussian_filter1d(rng.standard_normal(n + 2 * reach), width, mode="wrap")[reach : reach + n]
    scale = np.sqrt(2.0 * np.sqrt(np.pi) * width)  # of white noise that is smoothed so
    return np.asarray(lowest + (highest - lowest) * ndtr(scale * smooth))


def friction_factor(scenario: Scenario, campaign: int) -> float:
    """Return by what the coefficient of friction is multiplied in a campaign (from 0): rails are dry, wet or dirty."""
    std = scenario.creep.campaign_std
    return float(np.exp(std * generator(scenario.seed, Stream.FRICTION, campaign).standard_normal()))


def with_stretches(track: TrackTruth, creep: CreepPlan, campaign: int, mean_friction: float) -> TrackTruth:
    """Return the track of one campaign: with the stretches of another friction that there are by then.

    The friction of the track is over ``mean_friction``.
    """
    there = [one for one in creep.stretches if campaign + 1 >= one.from_campaign]
    if not there:
        return track
    flat = np.ones(len(track.s))
    surface = track.surface or Surface(np.zeros(len(track.s)), flat, flat)
    friction = surface.friction
    for one in there:
        depth = np.clip(np.minimum(track.s - one.begin, one.end - track.s) / STRETCH_END, 0.0, 1.0)
        inside = depth * depth * (3.0 - 2.0 * depth)  # smooth at both ends, so that the spline of the track is
        friction = friction + inside * (one.friction / mean_friction - friction)
    return replace(track, surface=replace(surface, friction=friction))


def _drawn(track: TrackTruth, waves: Waves, rng: np.random.Generator, key: str) -> FloatArray:
    try:
        values = superpose([waves], [rng], length=track.length, interval=track.interval)
    except ParameterError as error:
        raise ParameterError(error.reason, field=f"section.{key}") from error
    return np.asarray(np.interp(track.s - track.s[0], track.interval * np.arange(len(values)), values))


TURNED = (-1.0, 1.0, -1.0, -1.0)
"""Lateral, yaw, roll, lateral of the mass: what a node turned half round about the vertical axis measures of each."""


def runs_rear_first(scenario: Scenario, campaign: int) -> bool:
    """Return whether vehicles run with their rear end first in a campaign (from 0)."""
    return scenario.sessions.push_pull and campaign % 2 == 1


def length_ahead(vehicle: VehiclePlan) -> float:
    """Return by how much the first axle's reference is ahead of the vehicle's own when its rear end is first, m."""
    return vehicle.axle_offsets[0] + vehicle.axle_offsets[-1]


def seen_from_ahead(scenario: Scenario, vehicle: VehiclePlan) -> tuple[Scenario, VehiclePlan]:
    """Return the scenario and the vehicle as one that runs forward when its rear end is first."""
    ahead = length_ahead(vehicle)
    turned = replace(
        vehicle,
        axle_offsets=tuple(ahead - offset for offset in reversed(vehicle.axle_offsets)),
        wheelsets=tuple(_turned(wheelset) for wheelset in reversed(vehicle.wheelsets)),
    )
    others = tuple(turned if item is vehicle else item for item in scenario.vehicles)
    return replace(scenario, vehicles=others), turned


def _turned(wheelset: WheelsetPlan) -> WheelsetPlan:
    return replace(
        wheelset,
        rate_left=wheelset.rate_right,
        rate_right=wheelset.rate_left,
        initial_left=wheelset.initial_right,
        initial_right=wheelset.initial_left,
        diameter_difference=-wheelset.diameter_difference,
        wheel_files=(wheelset.wheel_files[1], wheelset.wheel_files[0]),
    )


MARGIN = 200.0  # m of track beyond both ends of a section that runs cross as a whole
LEAD_IN = 160.0  # m before such a section where a run begins
RUN_OUT = 50.0  # m behind it where the last axle ends


@dataclass(frozen=True, slots=True)
class VehicleRun(FrozenArrays):
    """The course of one vehicle over one campaign, every ``STEP`` s; reference is the vehicle's position antenna."""

    vehicle: VehiclePlan
    campaign: int  # from 0
    start_ns: int  # vehicle clock
    odometer: float  # m, at the start
    speed: Annotated[FloatArray, "n"]  # m/s
    distance: Annotated[FloatArray, "n"]  # m along the section, of the reference
    reported: Annotated[FloatArray, "n"]  # m, the same as the vehicle reports it


def scenario_track(scenario: Scenario) -> TrackTruth:
    """Return the true track of the scenario's section."""
    section = scenario.section
    if section.file is not None:
        track = from_zero(read_track(section.file))
    else:
        assert section.recipe is not None
        track = make_track(with_margins(scenario, section.recipe), seed_of(scenario.seed, Stream.TRACK))
    return with_surface(track, scenario)


def with_margins(scenario: Scenario, recipe: TrackRecipe) -> TrackRecipe:
    """Return the recipe of a section with what runs over the whole of it cross before and behind."""
    if not scenario.sessions.whole_section:
        return recipe
    return replace(recipe, length=recipe.length + 2.0 * MARGIN, begin=-MARGIN)


def vehicle_run(scenario: Scenario, track: TrackTruth, vehicle: VehiclePlan, campaign: int) -> VehicleRun:
    """Return where and how fast ``vehicle`` runs in ``campaign`` (from 0)."""
    rng = generator(scenario.seed, Stream.SPEED, scenario.vehicles.index(vehicle), campaign)
    speed = _speed(scenario, rng)[: round(scenario.duration(vehicle) / STEP) + 1]
    if scenario.sessions.whole_section:
        assert scenario.section.recipe is not None
        distance = travelled(speed, -LEAD_IN)
        end = scenario.section.recipe.length + vehicle.axle_offsets[-1] + RUN_OUT
        count = int(np.searchsorted(distance, end)) + 1
        speed, distance = speed[:count], distance[:count]
    else:
        run = float(travelled(speed, 0.0)[-1])
        first = float(track.s[0]) + vehicle.axle_offsets[-1] + 1.0 + scenario.position.largest_offset
        room = float(track.s[-1]) - 1.0 - first - run
        if room < 0.0:
            raise ScenarioError(
                f"campaign {campaign + 1} of {vehicle.code} needs {run:.0f} m, the section has {track.length:.0f} m",
                field="sessions.minutes_each",
            )
        distance = travelled(speed, first + min(room, scenario.sessions.start_within) * float(rng.uniform()))
    if runs_rear_first(scenario, campaign):
        distance = distance - length_ahead(vehicle)  # the reference is at the other end of the train
    return VehicleRun(
        vehicle=vehicle,
        campaign=campaign,
        start_ns=scenario.start_ns(vehicle, campaign),
        odometer=scenario.odometer(campaign),
        speed=speed,
        distance=distance,
        reported=_reported(scenario, vehicle, campaign, distance),
    )


def _reported(scenario: Scenario, vehicle: VehiclePlan, campaign: int, distance: FloatArray) -> FloatArray:
    """Return the positions (n,) that a vehicle reports: off by the errors of this run, repeated in tunnels."""
    rng = generator(scenario.seed, Stream.POSITION, scenario.vehicles.index(vehicle), campaign)
    errors = scenario.position
    offset, scale = rng.uniform(-1.0, 1.0, 2) * (errors.offset, errors.scale)
    normal = np.clip(rng.standard_normal(2), -NORMAL_REACH, NORMAL_REACH) * (errors.offset_std, errors.scale_std)
    offset, scale = offset + normal[0], scale + normal[1]
    if errors.fixed_offset > 0.0:
        offset += errors.fixed_offset * rng.choice([-1.0, 1.0])
    reported = distance + offset + scale * (distance - distance[0])
    if errors.frozen_length > 0.0:
        entered = np.floor(distance / errors.frozen_every) * errors.frozen_every
        inside = distance - entered < errors.frozen_length
        last = np.maximum.accumulate(np.where(inside, -1, np.arange(len(distance))))
        reported = np.where(inside & (last >= 0), reported[np.maximum(last, 0)], reported)
    return np.asarray(reported)


def odometer_scale(scenario: Scenario, vehicle: VehiclePlan) -> float:
    """Return the factor on speed and odometer that a vehicle reports: its wheels are not what it takes them for."""
    rng = generator(scenario.seed, Stream.ODOMETER, scenario.vehicles.index(vehicle))
    return 1.0 + scenario.position.odometer_scale_std * float(rng.standard_normal())


def wheelset_record(scenario: Scenario, run: VehicleRun, axle: int, motion: WheelsetMotion) -> SensorRecord:
    """Return what the node of the wheelset at ``axle`` (from 0) measures of ``motion``."""
    order = scenario.vehicles.index(run.vehicle)
    offsets = draw_offsets(scenario.sensors, generator(scenario.seed, Stream.OFFSETS, order, axle))
    rng = generator(scenario.seed, Stream.SENSOR, order, axle, run.campaign)
    errors = None
    if scenario.sensors.errors != SensorErrors():
        node = generator(scenario.seed, Stream.NODE_ERRORS, order, axle)
        temperature = generator(scenario.seed, Stream.TEMPERATURE, order, axle, run.campaign)
        errors = draw_node_errors(scenario.sensors.errors, node, temperature)
    narrow = scenario.wheels.contact_step < CONTACT_STEP
    motion = _with_blows(scenario, run, axle, motion)
    return measure(motion, scenario.sensors, rng, offsets, errors, short_pulses=narrow)


def _with_blows(scenario: Scenario, run: VehicleRun, axle: int, motion: WheelsetMotion) -> WheelsetMotion:
    order, wheelset = scenario.vehicles.index(run.vehicle), run.vehicle.wheelsets[axle]
    for flat in scenario.wheels.flats:
        if flat.wheelset == wheelset.serial and run.campaign + 1 >= flat.from_campaign:
            rng = generator(scenario.seed, Stream.WHEEL_FLAT, order, axle, run.campaign)
            ahead = replace(flat, left=not flat.left) if runs_rear_first(scenario, run.campaign) else flat
            motion = with_flat(motion, ahead, wheelset.nominal_radius, rng)
    blows = scenario.section.blows
    return motion if blows is None else with_track_blows(motion, blows)


def failed(plan: WheelsetPlan, campaign: int) -> bool:
    """Whether the node of the wheelset has failed in ``campaign`` (from 0)."""
    return plan.fault is not None and campaign + 1 >= plan.fault.from_campaign


def _speed(scenario: Scenario, rng: np.random.Generator) -> FloatArray:
    """Return a speed (n,) that wanders within the scenario's range: three slow waves, squeezed smoothly into it."""
    plan, n = scenario.speed, round(scenario.sessions.duration / STEP) + 1
    t = STEP * np.arange(n, dtype=np.float64)
    if plan.steady:  # a mean of its own, and one slow wave of some per cent about it
        width = plan.highest - plan.lowest
        swing, period = rng.uniform(0.045, 0.18) * width, rng.uniform(60.0, 200.0)
        mean = rng.uniform(plan.lowest + 0.1 * width, plan.highest - 0.18 * width)
        slow = np.sin(2.0 * np.pi * t / period + rng.uniform(0.0, 2.0 * np.pi))
        return np.clip(mean + swing * slow, plan.lowest, plan.highest)
    wave = np.zeros(n)
    for order in (1.0, 1.7, 2.9):
        wave += (
            rng.uniform(0.5, 1.0) / order * np.sin(2.0 * np.pi * order * t / plan.period + rng.uniform(0, 2 * np.pi))
        )
    middle, half = 0.5 * (plan.lowest + plan.highest), 0.5 * (plan.highest - plan.lowest)
    speed = middle + half * np.tanh(wave)
    if plan.stop_every <= 0.0:
        return np.asarray(speed)
    from_stop = np.abs((t % plan.stop_every) - 0.5 * plan.stop_every)  # stops are in the middle of each period
    return np.minimum(speed, plan.braking * np.maximum(from_stop - 0.5 * plan.stop, 0.0))
