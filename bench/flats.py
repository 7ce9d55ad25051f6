"""Wheel flats: ``python -m bench flats [--wheelsets 320] [--first-seed 200] [--write-docs]``.

Wheelsets of drawn class, wear, speed and vibration run for a minute each on drawn track. Every one is measured without
a flat, with a flat of drawn size, and with two of what resembles flats: joints, switches, polygons, sleepers, flange
contact. The window is judged as ingest judges it. Constants were chosen on seeds 1 and 113.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.report import Bench, BenchRow, Columns, Part, ResultTable, row_table
from bench.wheelset_motion import gears_of
from estimation.motion.hunting import find_hunting
from estimation.motion.without_blows import blows_unless_hunting
from estimation.values.arrays import FloatArray
from estimation.values.windows import TurnBlows
from ingest.simulator.axle_motion import DerailmentError, contact_of
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
    side_right: bool | None  # None where no side is shown
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
        for what, size, shaken, left in _cases(motion, radius, rng):
            values = _measured(scenario, shaken, vibration, rng)
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
    tables = [contact_of(scenario, track, one, scenario.odometer(0)).table for one in plan.wheelsets]
    for axles, motions in gears_of(scenario, track, vehicle_run(scenario, track, plan, 0), tables):
        yield from zip(axles, motions, strict=True)


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


FALSE_ALARMS = 0.003  # share of the windows without a flat
POWER = 0.99  # from 40 m/s2 on, of vibration up to 5 m/s2
POWER_OF_ROUGH = 0.95  # from 60 m/s2 on, of 10 m/s2
SLOW = 15.0  # m/s
EXPLANATION = (
    "Share of the windows of a minute in which a flat is found (blows once a turn for half of the time, at a turn"
    " within 10 % of the wheel's), by the size of its blows before the filter of the node, at 20 m/s; they grow with"
    " the speed."
)


def _sides(flats: Sequence[Judged]) -> str:
    sided = [one.side_right for one in flats if one.side_right is not None]
    return f"{len(sided)} of {sum(one.found for one in flats)}, {sum(sided)}"


SIZE_COLUMNS: Columns = {
    "blows at 20 m/s": lambda size, _: f"{size:g} m/s2",
    **{
        f"vibration {size:g} m/s2": lambda _, flats, size=size: _share([one for one in flats if one.vibration == size])
        for size in VIBRATIONS
    },
    "below 15 m/s": lambda _, flats: _share([one for one in flats if one.speed < SLOW]),
    "faster": lambda _, flats: _share([one for one in flats if one.speed >= SLOW]),
    "side known, right": lambda _, flats: _sides(flats),
}


def bench_rows(found: Sequence[Judged]) -> Iterator[BenchRow]:
    """Yield what has to be reached."""
    smooth = [one for one in found if one.what == "flat" and one.size >= SIZES[2] and one.vibration < VIBRATIONS[3]]
    rough = [one for one in found if one.what == "flat" and one.size >= SIZES[3] and one.vibration == VIBRATIONS[3]]
    yield _power("flats from 40 m/s2 on, vibration up to 5 m/s2", smooth, POWER)
    yield _power("flats from 60 m/s2 on, vibration of 10 m/s2", rough, POWER_OF_ROUGH)
    others = [one for one in found if one.what != "flat"]
    for what in dict.fromkeys(one.what for one in others):
        yield _false(what, [one for one in others if one.what == what])
    yield _false("all without a flat", others)
    sided = [one.side_right for one in found if one.side_right is not None]
    right = sum(sided) / len(sided) if sided else 0.0
    yield BenchRow("side, where it is known", f"right in {right:.1%} of {len(sided)}", "99.0%", right >= POWER)


def _power(what: str, flats: Sequence[Judged], reach: float) -> BenchRow:
    share = sum(one.found for one in flats) / max(len(flats), 1)
    return BenchRow(what, f"{share:.1%} of {len(flats)} found", f">= {reach:.0%}", share >= reach)


def _false(what: str, windows: Sequence[Judged]) -> BenchRow:
    false = sum(one.found for one in windows)
    reach = FALSE_ALARMS * len(windows)
    clipped = sum(one.clipped > 0.0 for one in windows)
    measured = f"{false} of {len(windows)} taken for a flat; {clipped} with clipped samples"
    return BenchRow(f"{what}: false alarms", measured, f"<= {FALSE_ALARMS:.1%}", false <= reach)


def _share(windows: Sequence[Judged]) -> str:
    return f"{sum(one.found for one in windows)} of {len(windows)}"


def _parts(options: argparse.Namespace, _folder: Path) -> Iterator[Part]:
    found, seed = list[Judged](), options.first_seed
    while len({one.window for one in found}) < options.wheelsets:
        with suppress(DerailmentError):  # a drawn wheelset that climbs its rail at the drawn speed is no case
            found += list(judged_windows(seed))
        seed += 1
    yield EXPLANATION
    sizes = ((size, [one for one in found if one.what == "flat" and one.size == size]) for size in SIZES)
    yield ResultTable.of(SIZE_COLUMNS, sizes, range(1, 7))
    yield row_table(bench_rows(found))


main = Bench(
    "flats",
    "Wheel flats",
    __doc__ or "",
    _parts,
    {"wheelsets": (320, "windows of wheelsets"), "first-seed": (200, "seeds go up from here")},
).run
