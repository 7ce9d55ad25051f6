"""A fleet on one section: 16 wheelsets of mixed wear, 3 passes each, felt by MEMS sensors; with its truth."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from estimation.arrays import FloatArray
from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.wear import WearFamily, wear_course, worn
from estimation.signals import SignalParameters
from estimation.track.passes import Pass, passes
from estimation.types import Window, WindowQuality
from estimation.vehicle import VehicleParameters
from ingest.simulator.motion import STEP, WheelsetMotion, simulate_wheelset
from ingest.simulator.sensors import Channel, SensorNode, draw_offsets, measure
from ingest.simulator.track import TrackRecipe, TrackTruth, make_track

VEHICLES, AXLES, RUNS = 4, 4, 3
LENGTH = 12_000.0  # m
MARGIN = 200.0  # m of track beyond both ends
WINDOW_S = 60.0
AMPLITUDES = np.arange(1.0, 3.01, 0.25) * 1e-3  # m
NODE = SensorNode(  # MEMS: 100 ug per root hertz, angular channels at twice that, offsets, drift
    Channel(1e-3, 0.2, 1e-3), Channel(2e-3, 0.2, 1e-3), Channel(2e-3, 0.2, 1e-3), Channel(1e-3, 0.2, 1e-3)
)
GOOD = WindowQuality(1.0, 0.0, 0, 0.0, 0.0, 14.0, 25.0, 1.0, sensor_fault=False)


@dataclass(frozen=True, slots=True)
class Pair:
    """Wheel and rail of a fleet, and how far its wheels are worn at most."""

    name: str
    family: WearFamily
    wheel: str
    rail: str
    inclination: float
    deepest: float  # m


PAIRS = (
    Pair("P8/113A", WearFamily.P8_ON_56E1, "P8", "56E1", 1 / 20, 1.8e-3),
    Pair("S1002/60E1", WearFamily.S1002_ON_60E1, "S1002", "60E1", 1 / 40, 0.85e-3),
)


@dataclass(frozen=True, slots=True)
class Fleet:
    """All passes of a fleet with positions as measured, the track, and the true conicity by wheelset."""

    pair: Pair
    passes: tuple[Pass, ...]
    track: TrackTruth
    conicity: dict[str, FloatArray]  # at AMPLITUDES


def fleet(pair: Pair, seed: int, position_error: bool) -> Fleet:  # noqa: FBT001 - on or off
    """Simulate a fleet on two processes."""
    with ProcessPoolExecutor(2) as pool:
        parts = list(pool.map(_wheelset, [(pair, seed, number, position_error) for number in range(VEHICLES * AXLES)]))
    return Fleet(
        pair,
        tuple(item for _, found, _ in parts for item in found),
        _track(seed),
        {serial: conicity for serial, _, conicity in parts},
    )


def _track(seed: int) -> TrackTruth:
    made = make_track(TrackRecipe(length=LENGTH + 2 * MARGIN, alignment_std=2e-3), np.random.SeedSequence([seed, 99]))
    return TrackTruth(made.s - MARGIN, made.alignment, made.gauge_deviation)


def _wheelset(task: tuple[Pair, int, int, bool]) -> tuple[str, list[Pass], FloatArray]:
    pair, seed, number, position_error = task
    rng = np.random.default_rng([seed, number, 7])
    depth = pair.deepest * (number + rng.uniform()) / (VEHICLES * AXLES)
    apart = rng.normal(0.0, 0.08)
    wheels = [worn(wheel_profile(pair.wheel), wear_course(pair.family, depth * (1 + s))) for s in (apart, -apart)]
    rail = rail_profile(pair.rail)
    grid = np.arange(-160, 161) * 0.05e-3
    table = contact_table(WheelsetOnTrack(*wheels, rail, rail, pair.inclination, 1.435), grid, outside="hold")
    serial, found = f"{pair.name} {number:02d}", []
    for run in range(RUNS):
        shared = np.random.default_rng([seed, number % VEHICLES, run, 3])  # the vehicle's speed and odometer
        speed = _speed(shared)
        offset, scale = shared.uniform(-20, 20), 1e-3 * shared.uniform(-1, 1)
        motion = simulate_wheelset(VehicleParameters(), table, _track(seed), speed, -0.8 * MARGIN)
        if motion.outside:
            raise RuntimeError(f"{serial} left the contact table: {motion.outside} samples")
        noise = np.random.default_rng([seed, number, run, 5])
        for window in _windows(motion, noise, serial, f"V{number % VEHICLES}", run):
            found += [
                Pass(
                    item.wheelset,
                    item.vehicle,
                    item.start_ns,
                    item.at + position_error * (offset + scale * (item.at - LENGTH / 2)),
                    item.displacement,
                    item.difference,
                )
                for item in passes(window, VehicleParameters(), SignalParameters())
            ]
    true = equivalent_conicity(grid, table.rolling_radius_difference[:, 0], AMPLITUDES)
    return serial, found, true


def _speed(rng: np.random.Generator) -> FloatArray:
    """Return a speed profile, 14-25 m/s, every step until the section has been run through."""
    t = np.arange(900_000) * STEP
    swing = rng.uniform(0.5, 2.0) * np.sin(2 * np.pi * t / rng.uniform(60, 200) + rng.uniform(0, 6))
    speed = np.clip(rng.uniform(15, 23) + swing, 14.0, 25.0)
    return np.asarray(speed[: int(np.searchsorted(np.cumsum(speed) * STEP, LENGTH + 1.6 * MARGIN))])


def _windows(motion: WheelsetMotion, rng: np.random.Generator, serial: str, vehicle: str, run: int) -> Iterator[Window]:
    record = measure(motion, NODE, rng, draw_offsets(NODE, rng))
    stride, dt = NODE.stride, STEP * NODE.stride
    n = round(WINDOW_S / dt)
    for k in range(len(record.t) // n):
        part = slice(k * n, (k + 1) * n)
        lateral, yaw, roll, mass = record.values[part].T
        yield Window(
            wheelset=serial,
            vehicle=vehicle,
            axle=1,
            start_ns=round((run * 100_000 + k * WINDOW_S) * 1e9),
            length_ns=round(WINDOW_S * 1e9),
            sample_interval_s=dt,
            lateral_acceleration=lateral,
            yaw_acceleration=yaw,
            roll_acceleration=roll,
            mass_lateral_acceleration=mass,
            speed=motion.speed[::stride][part],
            distance=motion.distance[::stride][part],
            valid=np.ones(n, dtype=np.bool_),
            resolution=(1e-4, 1e-4, 1e-4, 1e-4),
            track_section="S",
            odometer_m=0.0,
            quality=GOOD,
        )
