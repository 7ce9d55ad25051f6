"""Windows of one drawn vehicle, with flats and with what resembles them, and what is found in each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from estimation.motion.hunting import find_hunting
from estimation.motion.without_blows import blows_unless_hunting
from estimation.values.arrays import FloatArray
from estimation.values.windows import TurnBlows
from ingest.simulator.axle_motion import axle_motions, contact_of
from ingest.simulator.campaign import scenario_track, vehicle_run
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.motion import STEP, WheelsetMotion
from ingest.simulator.running import TrackBlows, WheelFlat, with_flat, with_track_blows
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario
from ingest.simulator.sensor_errors import Vibration, draw_node_errors
from ingest.simulator.sensors import draw_offsets, measure

SCENARIOS = Path(__file__).parent / "vehicle_scenarios"
CLASSES = ("soft_known", "paper_known", "coach_known")
SPEEDS = ((9.0, 14.0), (14.0, 25.0), (20.0, 32.0))  # m/s
VIBRATIONS = (0.0, 2.0, 5.0, 10.0)  # m/s2, before the filter of the node
SIZES = (10.0, 20.0, 40.0, 60.0, 100.0)  # m/s2 at 20 m/s
RESEMBLING = ("joints", "switches", "polygon", "sleepers", "flange contact")
RANGE = np.array([40.95875, 32.767, 32.767, 8.19175])  # of the shipped catalogue, in the order of ACCELERATIONS
WINDOW_S = 60.0
NEAR = 0.1  # relative, from the turn of the wheel, within which the alert believes it


@dataclass(frozen=True, slots=True)
class Judged:
    """A window with one thing done to it."""

    window: str  # seed and wheelset
    what: str  # "flat", "nothing", or what resembles a flat
    size: float  # m/s2 at 20 m/s
    vibration: float
    speed: float  # m/s, mean
    found: bool
    side_right: bool | None  # None where no side is told
    clipped: float  # share of the samples


def judged_windows(seed: int) -> Iterator[Judged]:
    """Yield what is found of the wheelsets of one vehicle."""
    rng = np.random.default_rng(seed)
    scenario = with_seed(load_scenario(SCENARIOS / f"{CLASSES[seed % len(CLASSES)]}.toml"), seed)
    low, high = SPEEDS[int(rng.integers(len(SPEEDS)))]
    scenario = replace(scenario, speed=replace(scenario.speed, lowest=low, highest=high))
    scenario = replace(scenario, sessions=replace(scenario.sessions, duration=WINDOW_S))
    for axle, motion in _motions(scenario):
        vibration = float(rng.choice(VIBRATIONS))
        radius = scenario.vehicles[0].wheelsets[axle].nominal_radius
        for what, size, felt, left in _cases(motion, radius, rng):
            values = _measured(scenario, felt, vibration, rng)
            blows = judged(values, motion.speed[:: scenario.sensors.stride], 1.0 / scenario.sensors.rate_hz)
            believed = blows.sustained and abs(blows.turn_m / (2.0 * np.pi * radius) - 1.0) <= NEAR
            side = None if not believed or blows.side == 0 else (blows.side > 0) == left
            clipped = float((np.abs(values) >= RANGE).any(axis=1).mean())
            speed = float(motion.speed.mean())
            yield Judged(f"{seed} {axle}", what, size, vibration, speed, believed, side, clipped)


def judged(values: FloatArray, speed: FloatArray, interval_s: float) -> TurnBlows:
    """Return the blows of a window as ingest finds them.

    Args:
        values: (n, 4) in the order of ``ACCELERATIONS``.
        speed: (n,) m/s.
    """
    lateral, yaw, roll, _ = values.T
    return blows_unless_hunting(find_hunting(lateral, yaw, speed, interval_s), lateral, roll, speed, interval_s)


def _motions(scenario: Scenario) -> Iterator[tuple[int, WheelsetMotion]]:
    track, plan = scenario_track(scenario), scenario.vehicles[0]
    contacts = [contact_of(scenario, track, one, scenario.odometer(0)).table for one in plan.wheelsets]
    run = vehicle_run(scenario, track, plan, 0)
    together = 1 if scenario.bogie is None else 2
    for first in range(0, len(plan.wheelsets), together):
        group = tuple(range(first, first + together))
        yield from zip(group, axle_motions(scenario, track, run, group, [contacts[k] for k in group]), strict=True)


def _cases(
    motion: WheelsetMotion, radius: float, rng: np.random.Generator
) -> Iterator[tuple[str, float, WheelsetMotion, bool]]:
    """Yield what is done, its size, the motion as the sensors feel it, and whether the flat is on the left wheel."""
    yield "nothing", 0.0, motion, False
    left, size = bool(rng.integers(2)), float(rng.choice(SIZES))
    yield "flat", size, with_flat(motion, WheelFlat("", left, size), radius, rng), left
    for what in rng.choice(RESEMBLING, 2, replace=False):
        size = float(rng.choice(SIZES[1:]))
        yield str(what), size, _resembling(str(what), size, motion, radius, rng), False


def _resembling(
    what: str, size: float, motion: WheelsetMotion, radius: float, rng: np.random.Generator
) -> WheelsetMotion:
    if what == "joints":
        return with_track_blows(motion, TrackBlows(rng.uniform(12.0, 36.0), size))
    if what == "switches":
        return with_track_blows(motion, TrackBlows(rng.uniform(400.0, 1500.0), size))
    if what == "polygon":
        return _with_waves(motion, 2.0 * np.pi * radius / int(rng.integers(1, 9)), 0.2 * size)
    return _with_waves(motion, 0.6, 10.0) if what == "sleepers" else _with_flange(motion, rng)


def _with_waves(motion: WheelsetMotion, wavelength: float, size: float) -> WheelsetMotion:
    wave = size * np.sin(2.0 * np.pi * motion.distance / wavelength)
    return _added(motion, np.outer([1.0, 0.3, 0.5, 0.0], wave))


def _with_flange(motion: WheelsetMotion, rng: np.random.Generator) -> WheelsetMotion:
    """Return a motion that sways with 6 mm, and is pushed back by the flanges for 15 ms at every end of its way."""
    wavelength = rng.uniform(5.0, 14.0)
    phase = 2.0 * np.pi * motion.distance / wavelength
    omega = 2.0 * np.pi * motion.speed / wavelength
    lateral = -6e-3 * omega**2 * np.sin(phase)
    yaw = -6e-3 * omega**3 / motion.speed * np.cos(phase)
    narrow = np.abs(np.sin(phase)) > np.cos(np.minimum(0.0075 * omega, 1.0))
    lateral = lateral - 15.0 * np.sign(np.sin(phase)) * narrow
    return _added(motion, np.stack([lateral, yaw, np.zeros_like(lateral), np.zeros_like(lateral)]))


def _added(motion: WheelsetMotion, accelerations: FloatArray) -> WheelsetMotion:
    before = 0.0 if motion.path_accelerations is None else motion.path_accelerations
    return replace(motion, path_accelerations=before + accelerations)


def _measured(scenario: Scenario, motion: WheelsetMotion, vibration: float, rng: np.random.Generator) -> FloatArray:
    """Return what the node sends (n, 4)."""
    errors = None
    if vibration > 0.0:
        of_box = Vibration(lateral=vibration, angular=0.5 * vibration)
        errors = draw_node_errors(replace(scenario.sensors.errors, vibration=of_box), rng, rng)
    record = measure(motion, scenario.sensors, rng, draw_offsets(scenario.sensors, rng), errors)
    return np.clip(record.values[: round(WINDOW_S / STEP / scenario.sensors.stride)], -RANGE, RANGE)
