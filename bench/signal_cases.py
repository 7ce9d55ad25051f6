"""Windows of a wheelset with MEMS sensors on known track, by course of speed and by what goes wrong; with the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.ndimage import binary_dilation

from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import ContactTable, WheelsetOnTrack, contact_table, radius_difference_curve
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.wear import WearFamily, wear_course, worn
from estimation.motion.integration import standard_displacement
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.quantities import Status
from estimation.values.track import TrackAlignment, TrackLayout
from estimation.values.windows import Window, WindowQuality
from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.align.windows import CLIPPING_GUARD_S
from ingest.simulator.motion import STEP, WheelsetMotion, simulate_wheelset
from ingest.simulator.sensors import Channel, SensorNode, draw_offsets, measure
from ingest.simulator.track import Curve, TrackRecipe, TrackTruth, make_track

MINUTES = 10
WINDOW_S = 60.0
AMPLITUDES = np.arange(1.0, 3.01, 0.25) * 1e-3  # m
GRID: FloatArray = np.asarray(np.arange(-160, 161) * 0.05e-3)  # m
LENGTH = 16_000.0  # m
GOOD = WindowQuality(1.0, 0.0, 0, 0.0, 0.0, 5.0, 25.0, 1.0, sensor_fault=False)
NODE = SensorNode(  # 100 ug per root hertz, angular channels at twice that, offsets, drift
    Channel(1e-3, 0.2, 1e-3), Channel(2e-3, 0.2, 1e-3), Channel(2e-3, 0.2, 1e-3), Channel(1e-3, 0.2, 1e-3)
)
LIMIT = 2.5  # m/s2, of the lateral channel where it clips
GAPS_S = (0.008, 0.032, 0.1)
GAPS_PER_MINUTE = 6
COURSES = ("constant", "mixed", "stops", "gaps", "clipping", "curves")
CURVES = tuple(
    Curve(start, length, side * radius, side * cant, 80.0)
    for start, length, side, radius, cant in (
        (1200.0, 600.0, 1.0, 4000.0, 0.03),
        (3300.0, 500.0, -1.0, 3000.0, 0.04),
        (5600.0, 700.0, 1.0, 6000.0, 0.02),
        (8000.0, 500.0, -1.0, 5000.0, 0.025),
        (10_200.0, 600.0, 1.0, 3500.0, 0.035),
    )
)


@dataclass(frozen=True, slots=True)
class Wheelset:
    """A named wheelset with its contact geometry and its true conicity at ``AMPLITUDES``."""

    name: str
    table: ContactTable
    conicity: FloatArray


@dataclass(frozen=True, slots=True)
class SmoothTable:
    """An analytic pair of very low conicity, nothing but smooth."""

    lateral_displacement: FloatArray
    gauge_deviation: FloatArray
    rolling_radius_left: FloatArray
    rolling_radius_right: FloatArray
    contact_angle_left: FloatArray
    contact_angle_right: FloatArray
    roll: FloatArray


@dataclass(frozen=True, slots=True)
class Run:
    """One wheelset over one course: windows, where they are in the motion, and what is on file of the track."""

    wheelset: str
    windows: tuple[Window, ...]
    motion: WheelsetMotion
    track: TrackAlignment
    layout: TrackLayout | None
    conicity: FloatArray

    def truth(self, number: int) -> FloatArray:
        """Return y - d as EN 15302 means it, psi, psi' and rL - rR (4, n) at the samples of window ``number``."""
        n, m = len(self.windows[number].valid), self.motion
        part = slice(number * n * NODE.stride, (number + 1) * n * NODE.stride, NODE.stride)
        radius = VehicleParameters().nominal_radius
        standard = standard_displacement(m.relative_displacement, m.roll, radius, level=False)
        signals = (standard, m.yaw, m.yaw_rate, m.rolling_radius_left - m.rolling_radius_right)
        return np.stack([values[part] for values in signals])


@cache
def wheelsets() -> tuple[Wheelset, ...]:
    """Return little and badly worn wheelsets of both pairs, and a smooth one of conicity 0.05."""
    p8 = ("P8", "56E1", 1 / 20, WearFamily.P8_ON_56E1)
    s1002 = ("S1002", "60E1", 1 / 40, WearFamily.S1002_ON_60E1)
    return (
        _worn("P8/113A, little worn", *p8, 0.1e-3),
        _worn("P8/113A, badly worn", *p8, 1.6e-3),
        _worn("S1002/60E1, little worn", *s1002, 0.05e-3),
        _worn("S1002/60E1, badly worn", *s1002, 0.75e-3),
        _smooth(),
    )


def _worn(name: str, wheel: str, rail: str, inclination: float, family: WearFamily, depth: float) -> Wheelset:
    wheels = [worn(wheel_profile(wheel), wear_course(family, depth * side)) for side in (1.08, 0.92)]
    rails = rail_profile(rail)
    on_track = WheelsetOnTrack(wheels[0], wheels[1], rails, rails, inclination, 1.435)
    curve = radius_difference_curve(on_track, GRID)
    conicity = equivalent_conicity(curve.displacement, curve.difference, AMPLITUDES)
    return Wheelset(name, contact_table(on_track, GRID, outside="hold"), conicity)


def _smooth() -> Wheelset:
    x = GRID[:, None]
    even, odd = 0.45 + 3 * x**2, 0.05 * x + 200 * x**3
    left, right = even + odd, even - odd
    table = SmoothTable(
        lateral_displacement=GRID,
        gauge_deviation=np.zeros(1),
        rolling_radius_left=left,
        rolling_radius_right=right,
        contact_angle_left=0.06 + 6 * x + 600 * x**2,
        contact_angle_right=0.06 - 6 * x + 600 * x**2,
        roll=(left - right) / 1.5,
    )
    standard = standard_displacement(GRID, table.roll[:, 0], VehicleParameters().nominal_radius, level=False)
    return Wheelset("smooth, conicity 0.05", table, equivalent_conicity(standard, (left - right)[:, 0], AMPLITUDES))


def simulate(wheelset: Wheelset, course: str, seed: int) -> Run:
    """Run a wheelset over a course."""
    return on_track(wheelset, course, seed, CURVES if course == "curves" else ())


def on_track(wheelset: Wheelset, course: str, seed: int, curves: tuple[Curve, ...]) -> Run:
    """Run a wheelset over a course on a track with ``curves``."""
    track = _track(seed, curves)
    motion = simulate_wheelset(VehicleParameters(), wheelset.table, track, _speed(course, seed), 50.0)
    if motion.outside:
        raise RuntimeError(f"{wheelset.name} left its contact table {motion.outside} times")
    zero = np.zeros(len(track.s))
    known = TrackAlignment("S", 1, track.s, track.alignment, zero, zero, zero, zero.astype(np.int64), Status.ESTIMATED)
    layout = TrackLayout("S", 1, track.s, track.curves.curvature, track.curves.cant) if track.curves else None
    windows = tuple(_windows(motion, course, np.random.default_rng([seed, 3])))
    return Run(wheelset.name, windows, motion, known, layout, wheelset.conicity)


def _track(seed: int, curves: tuple[Curve, ...]) -> TrackTruth:
    return make_track(TrackRecipe(length=LENGTH, curves=curves), np.random.SeedSequence([seed, 5]))


def _speed(course: str, seed: int) -> FloatArray:
    t = np.arange(round(60 * MINUTES / STEP)) * STEP
    if course == "constant":
        return np.full(len(t), 20.0)
    if course == "stops":  # from the platform to 25 m/s at 0.25 m/s2, braking at 0.5 m/s2, half a minute of standing
        cycle = np.interp(t, [0, 100, 130, 180, 210], [0.0, 25.0, 25.0, 0.0, 0.0])
        return np.asarray(cycle[np.arange(len(t)) % round(210 / STEP)])
    rng = np.random.default_rng([seed, 11])
    return np.asarray(19.5 + 5.5 * np.sin(2 * np.pi * t / rng.uniform(60, 200) + rng.uniform(0, 6)))


def _windows(motion: WheelsetMotion, course: str, rng: np.random.Generator) -> Iterator[Window]:
    node = NODE if course != "clipping" else replace(NODE, lateral=replace(NODE.lateral, limit=LIMIT))
    record = measure(motion, node, rng, draw_offsets(node, rng))
    dt = STEP * node.stride
    n = round(WINDOW_S / dt)
    missing = _missing(course, rng, len(record.t), dt)
    clipped: BoolArray = np.asarray(record.clipped.any(axis=1))
    valid = ~missing & ~binary_dilation(clipped, iterations=round(CLIPPING_GUARD_S / dt))
    values = np.where(valid[:, None], record.values, np.nan)
    for k in range(len(record.t) // n):
        part = slice(k * n, (k + 1) * n)
        lateral, yaw, roll, mass = values[part].T
        yield Window(
            wheelset="W",
            vehicle="V",
            axle=1,
            start_ns=round(k * WINDOW_S * 1e9),
            length_ns=round(WINDOW_S * 1e9),
            sample_interval_s=dt,
            lateral_acceleration=lateral,
            yaw_acceleration=yaw,
            roll_acceleration=roll,
            mass_lateral_acceleration=mass,
            speed=motion.speed[:: node.stride][part],
            distance=motion.distance[:: node.stride][part],
            valid=valid[part],
            resolution=(1e-4, 1e-4, 1e-4, 1e-4),
            track_section="S",
            odometer_m=0.0,
            quality=GOOD,
        )


def _missing(course: str, rng: np.random.Generator, n: int, dt: float) -> BoolArray:
    missing = np.zeros(n, dtype=np.bool_)
    if course == "gaps":
        for at in rng.integers(0, n, GAPS_PER_MINUTE * MINUTES):
            missing[at : at + round(float(rng.choice(GAPS_S)) / dt)] = True
    return missing
