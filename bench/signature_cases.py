"""Simulated fleets for the library of wear signatures: windows of MEMS sensors, their signatures, and the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from bench.drawn_journey import course, measured, worn_p8
from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, contact_table, radius_difference_curve
from estimation.motion.integration import Gates, SignalParameters, WindowParameters
from estimation.signatures.window_signatures import SignatureParameters, window_signatures
from estimation.values.arrays import FloatArray
from estimation.values.reasons import Reason
from estimation.values.signatures import ConicitySource, LibraryEntry, Place, Signature
from estimation.values.units import DAY_NS
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import Arrangement, VehicleClass, VehicleParameters
from ingest.simulator.running_gear import PreparedTable, RunningGear, simulate_gear
from ingest.simulator.track import TrackRecipe, TrackTruth, make_track

GRID: FloatArray = np.asarray(np.arange(-160, 161) * 0.05e-3)  # m
AMPLITUDE = np.array([3e-3])  # m
LENGTH, BEGIN = 3100.0, 60.0  # m
CONDITIONS = tuple(0.25e-3 * k for k in range(7))  # m of tread worn away: seven conditions of the wheels
WITHIN = 0.03e-3  # m, by which wheelsets of one condition differ
LABEL_STD = 0.01  # of the conicities that the library has on file
SPREAD = {  # of the vehicles about their class, relative standard deviations
    "longitudinal_creep_coefficient": 0.06,
    "lateral_creep_coefficient": 0.06,
    "yaw_stiffness": 0.03,
    "lateral_stiffness": 0.03,
    "wheelset_mass": 0.015,
    "yaw_inertia": 0.015,
    "suspended_mass": 0.015,
}
POSITION_STD = 10.0  # m, of a run
SPEEDS_TRIED = 10  # until a wheelset stays within its contact table


class LeftTableError(RuntimeError):
    """A simulated wheelset moved farther than its contact table goes: its motion is not that of its wheels."""


@dataclass(frozen=True, slots=True)
class Wheelset:
    """A simulated wheelset."""

    serial: str
    condition: int
    conicity: float  # at 3 mm
    table: PreparedTable
    vehicle: VehicleParameters


@dataclass(frozen=True, slots=True)
class Pass:
    """Signatures of one wheelset over one section."""

    wheelset: Wheelset
    section: str
    signatures: tuple[Signature, ...]


@cache
def window_parameters() -> WindowParameters:
    """Return what windows are read with: the class, from which the vehicles differ."""
    assumed = VehicleClass("single", "single", "bench", Arrangement.SINGLE_WHEELSET, VehicleParameters())
    return WindowParameters.of(assumed, None, SignalParameters(), Gates())


def wheelset(serial: str, depth: float, condition: int, rng: np.random.Generator) -> Wheelset:
    """Return a P8 wheelset that has lost so much of its tread, on a vehicle that differs from its class."""
    return on_a_vehicle(serial, condition, worn_p8(depth, rng.uniform(-0.1, 0.1)), rng)


def on_a_vehicle(serial: str, condition: int, on_track: WheelsetOnTrack, rng: np.random.Generator) -> Wheelset:
    """Return a wheelset of these profiles on a vehicle that differs from its class."""
    table = contact_table(on_track, GRID, outside="hold")
    curve = radius_difference_curve(on_track, GRID)
    conicity = equivalent_conicity(curve.displacement, curve.difference, AMPLITUDE)
    base = VehicleParameters()
    own = {name: getattr(base, name) * float(np.exp(std * rng.standard_normal())) for name, std in SPREAD.items()}
    return Wheelset(serial, condition, float(conicity[0]), PreparedTable.of(table), replace(base, **own))


def wheelsets(count: int, name: str, rng: np.random.Generator) -> list[Wheelset]:
    """Return wheelsets of the seven conditions in turn."""
    found = []
    for number in range(count):
        condition = number % len(CONDITIONS)
        depth = max(0.0, CONDITIONS[condition] + float(rng.uniform(-WITHIN, WITHIN)))
        found.append(wheelset(f"{name}{number}", depth, condition, rng))
    return found


def tracks(count: int, seed: int, first: int = 0) -> dict[str, TrackTruth]:
    """Return the tracks of sections, of different roughness."""
    found = {}
    for number in range(first, first + count):
        sequence = np.random.SeedSequence([seed, 5, number])
        std = float(np.random.default_rng([seed, 6, number]).uniform(1.2e-3, 2.4e-3))
        found[f"S{number}"] = make_track(TrackRecipe(length=LENGTH, alignment_std=std), sequence)
    return found


def run(
    runs: Wheelset, section: str, track: TrackTruth, speed: float, rng: np.random.Generator, start_ns: int = 0
) -> Pass:
    """Run a wheelset over a section at a mean speed, m/s, and return its signatures."""
    window = window_of(runs, section, track, speed, rng, start_ns)
    found = window_signatures(window, window_parameters(), SignatureParameters())
    if isinstance(found, Reason):
        raise RuntimeError(found.text)  # noqa: TRY004 - a reason is a finding, not a wrong type
    return Pass(runs, section, found)


def run_within(
    runs: Wheelset, section: str, track: TrackTruth, limits: tuple[float, float], rng: np.random.Generator
) -> Pass:
    """Run a wheelset at a speed, m/s, between limits at which it stays within its contact table, on some day."""
    for _ in range(SPEEDS_TRIED):
        try:
            speed, day = float(rng.uniform(*limits)), int(rng.integers(1, 300))
            return run(runs, section, track, speed, rng, DAY_NS * day)
        except LeftTableError:
            continue
    raise LeftTableError(f"{runs.serial} left its contact table at {SPEEDS_TRIED} speeds")


def window_of(
    runs: Wheelset, section: str, track: TrackTruth, speed: float, rng: np.random.Generator, start_ns: int = 0
) -> Window:
    """Return one window of a run over a whole section, as its node measures it, at positions some metres off."""
    speeds = course(LENGTH - 2 * BEGIN, speed, rng)
    motion = simulate_gear(RunningGear(runs.vehicle), [runs.table], track, speeds, BEGIN)[0]
    if motion.outside:
        raise LeftTableError(f"{runs.serial} left its contact table {motion.outside} times")
    window = measured(motion, runs.serial, start_ns, rng, track_section=section)
    offset = float(np.clip(rng.normal(0.0, POSITION_STD), -2 * POSITION_STD, 2 * POSITION_STD))
    return replace(window, distance=window.distance + offset)


def entries(
    passes: Sequence[Pass],
    rng: np.random.Generator,
    label_std: float = LABEL_STD,
    source: ConicitySource = ConicitySource.MEASURED_PROFILES,
) -> list[LibraryEntry]:
    """Return the library of passes, with conicities on file that are off by so much.

    Measured profiles are off wheelset by wheelset; of the variance of estimates half is the same of all.
    """
    own = 1.0 if source is ConicitySource.MEASURED_PROFILES else float(np.sqrt(0.5))
    common = label_std * float(np.sqrt(1.0 - own**2)) * float(rng.standard_normal())
    labels = {
        one.wheelset.serial: one.wheelset.conicity + common + own * label_std * rng.standard_normal() for one in passes
    }
    return [
        LibraryEntry(signature, 0, float(labels[one.wheelset.serial]), label_std, source)
        for one in passes
        for signature in one.signatures
    ]


@dataclass(frozen=True, slots=True)
class SimulatedFleet:
    """Passes that teach, and passes of other wheelsets over the same and over other sections."""

    teaching: tuple[Pass, ...]
    same: tuple[Pass, ...]
    other: tuple[Pass, ...]
    tracks: dict[str, TrackTruth] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Foreign:
    """A pass of a wheelset whose wheels or rails are none of the library's; None where it has no signatures."""

    kind: str
    made: Pass | None


@dataclass(frozen=True, slots=True)
class Simulated:
    """All passes of one seed; what is judged by which library is decided afterwards."""

    main: SimulatedFleet
    speeds: SimulatedFleet
    foreign: tuple[Foreign, ...]
    retracked: tuple[Pass, ...]
    tamped: frozenset[Place]
