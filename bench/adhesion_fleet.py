"""Wheelsets of a scenario as windows of their sensors, each with the true forces on its wheels and the true friction.

The motion is the simulator's, the sensors its nodes; frames, receiver and store are left out, so that many seeds cost
little. The true forces follow from the true motion by Newton's equations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.signal import firwin

from bench.made_values import made_alignment, made_window
from bench.wheelset_motion import gears_of
from estimation.motion.axle_distance import with_frame_yaw
from estimation.values.arrays import FloatArray
from estimation.values.track import TrackAlignment
from estimation.values.windows import Window, WindowQuality
from estimation.vehicle.vehicle_class import Arrangement, SensorChannel, SensorLayout, VehicleClass, VehicleParameters
from ingest.simulator.axle_motion import contact_of
from ingest.simulator.campaign import (
    VehicleRun,
    friction_factor,
    scenario_track,
    vehicle_run,
    wheelset_record,
    with_stretches,
)
from ingest.simulator.drawn_fleet import vehicle_parameters
from ingest.simulator.fleet import surveyed
from ingest.simulator.motion import STEP, WheelsetMotion
from ingest.simulator.scenario import Scenario
from ingest.simulator.track import TrackTruth

WINDOW_S = 60.0
TAPS, PASSED = 32, 0.9  # of the filter before decimation: per sample, and its corner over the Nyquist frequency
GOOD = WindowQuality(1.0, 0.0, 0, 0.0, 0.0, 5.0, 40.0, 1.0, sensor_fault=False)


@dataclass(frozen=True, slots=True)
class TrueForces:
    """What acts on a wheelset at the samples of a window, (n,) each."""

    lateral_creep: FloatArray  # N
    yaw_creep: FloatArray  # N m
    contact: FloatArray  # N, lateral creep and gravitational stiffness together
    friction: FloatArray  # coefficient


@dataclass(frozen=True, slots=True)
class SensedWindow:
    """A window with what is true of it."""

    window: Window  # with the yaw of the bogie's frame
    campaign: int
    truth: TrueForces


@dataclass(frozen=True, slots=True)
class Fleet:
    """A scenario's track, its class on file, and the windows of all its wheelsets."""

    scenario: Scenario
    track: TrackTruth
    alignment: TrackAlignment
    vehicle_class: VehicleClass
    windows: tuple[SensedWindow, ...]


def true_friction(scenario: Scenario, track: TrackTruth, campaign: int, distance: FloatArray) -> FloatArray:
    """Return the true coefficient of friction (n,) at distances (n,), m, in a campaign (from 0)."""
    factor = min(friction_factor(scenario, campaign) * scenario.creep.friction, 1.0)
    track = with_stretches(track, scenario.creep, campaign, factor)
    if track.surface is None:
        return np.full(len(distance), factor)
    return np.asarray(factor * np.interp(distance, track.s, track.surface.friction))


def class_of(scenario: Scenario) -> VehicleClass:
    """Return the class of the scenario's vehicles as its registry has it."""
    node = scenario.sensors
    signals = (node.lateral, node.yaw, node.roll, node.mass_lateral)
    channels = [SensorChannel(signal.noise_density, 0.0, signal.limit) for signal in signals]
    sensors = SensorLayout(*channels, measures_gravity=node.measures_gravity, rate_hz=float(node.rate_hz))
    arrangement = Arrangement.SINGLE_WHEELSET if scenario.bogie is None else Arrangement.BOGIE
    source = f"scenario {scenario.name}"
    return VehicleClass("bench", "bench", source, arrangement, scenario.parameters, scenario.bogie, sensors)


def simulate(scenario: Scenario) -> Fleet:
    """Return the windows of every wheelset of a scenario in every campaign."""
    track = scenario_track(scenario)
    survey = surveyed(scenario, track)
    section = scenario.section
    alignment = made_alignment(survey.s, survey.alignment, section.survey_alignment_std, section.code)
    windows = tuple(_windows(scenario, track))
    return Fleet(scenario, track, alignment, class_of(scenario), windows)


def _windows(scenario: Scenario, track: TrackTruth) -> Iterator[SensedWindow]:
    for vehicle in scenario.vehicles:
        tables = [contact_of(scenario, track, plan, scenario.odometer(0)).table for plan in vehicle.wheelsets]
        for campaign in range(scenario.sessions.campaigns):
            run = vehicle_run(scenario, track, vehicle, campaign)
            for axles, motions in gears_of(scenario, track, run, tables):
                yield from _of_gear(scenario, track, run, axles, motions)


def _of_gear(
    scenario: Scenario, track: TrackTruth, run: VehicleRun, axles: tuple[int, ...], motions: tuple[WheelsetMotion, ...]
) -> Iterator[SensedWindow]:
    """Yield the windows of the wheelsets that move together."""
    parameters = vehicle_parameters(scenario, run.vehicle.code)
    cut = [tuple(_cut(scenario, run, axle, motion)) for axle, motion in zip(axles, motions, strict=True)]
    for place, (axle, motion) in enumerate(zip(axles, motions, strict=True)):
        radius = run.vehicle.wheelsets[axle].nominal_radius
        friction = true_friction(scenario, track, run.campaign, motion.distance)
        forces = true_forces(replace(parameters, nominal_radius=radius), motion, friction)
        forces = _sampled(forces, scenario.sensors.stride)
        for number, window in enumerate(cut[place]):
            if len(axles) > 1:
                offsets = run.vehicle.axle_offsets
                other = axles[1 - place]
                window = with_frame_yaw(window, cut[1 - place][number], offsets[other] - offsets[axle])  # noqa: PLW2901 - the window as its class reads it
            yield SensedWindow(window, run.campaign, _part(forces, number, len(window.valid)))


def true_forces(p: VehicleParameters, motion: WheelsetMotion, friction: FloatArray) -> TrueForces:
    """Return the forces and moments (n,) on a wheelset by Newton's equations from its true motion."""
    A = motion.contact_angle_left + motion.contact_angle_right
    D = motion.contact_angle_left - motion.contact_angle_right
    frame_yaw = np.zeros(len(motion)) if motion.frame_yaw is None else motion.frame_yaw
    spring = p.lateral_stiffness * (motion.mass_lateral_displacement - motion.lateral_displacement)
    suspension = spring + p.lateral_damping * (motion.mass_lateral_velocity - motion.lateral_velocity)
    contact = p.wheelset_mass * motion.lateral_acceleration - suspension
    turning = np.gradient(motion.yaw - frame_yaw, STEP)
    moment = (
        p.yaw_inertia * motion.yaw_acceleration
        + p.yaw_stiffness * (motion.yaw - frame_yaw)
        + p.yaw_damping * turning
        + p.pitch_inertia * motion.speed / p.nominal_radius * motion.roll_rate
        - 0.5 * p.half_contact_distance * p.load * A * motion.yaw
    )
    return TrueForces(contact + p.load * (0.5 * D + motion.roll), moment, contact, friction)


def _sampled(forces: TrueForces, stride: int) -> TrueForces:
    """Return the forces at the samples of a node, without what its anti-alias filter takes out of every signal."""
    taps = firwin(TAPS * stride + 1, PASSED / stride)

    def passed(values: FloatArray) -> FloatArray:
        return np.convolve(values, taps, mode="same")[::stride]

    creep, moment, contact = (passed(values) for values in (forces.lateral_creep, forces.yaw_creep, forces.contact))
    return TrueForces(creep, moment, contact, forces.friction[::stride])


def _part(forces: TrueForces, number: int, n: int) -> TrueForces:
    part = slice(number * n, (number + 1) * n)
    return TrueForces(*(getattr(forces, item.name)[part].copy() for item in fields(forces)))


def _cut(scenario: Scenario, run: VehicleRun, axle: int, motion: WheelsetMotion) -> Iterator[Window]:
    record = wheelset_record(scenario, run, axle, motion)
    dt = STEP * scenario.sensors.stride
    n = round(WINDOW_S / dt)
    reported = run.reported - run.distance + motion.distance
    for k in range(len(record.t) // n):
        part, stride = slice(k * n, (k + 1) * n), scenario.sensors.stride
        sampled = slice(part.start * stride, part.stop * stride, stride)
        begin_ns = run.start_ns - run.start_ns % round(WINDOW_S * 1e9) + round(k * WINDOW_S * 1e9)
        yield made_window(
            *(record.values[part], run.vehicle.wheelsets[axle].serial, begin_ns, dt),
            vehicle=run.vehicle.code,
            axle=axle + 1,
            length_ns=round(WINDOW_S * 1e9),
            speed=motion.speed[sampled],
            distance=reported[sampled],
            valid=np.asarray(~record.clipped[part].any(axis=1)),
            track_section=scenario.section.code,
            odometer_m=run.odometer,
            quality=GOOD,
            measures_gravity=scenario.sensors.measures_gravity,
        )
