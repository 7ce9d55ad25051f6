"""Sensors that are turned: what that does to the conicity, on the three vehicles of the bench, known track.

Track with 2 mm of cross level and 2 mm of vertical irregularity, which a sensor that is turned measures too; the axle
box pitches with its bogie. The nodes of front and rear are turned the opposite way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from bench.report import BenchRow
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.motion.axle_distance import with_frame_yaw
from estimation.motion.integration import WindowParameters
from estimation.tables.bin_table import bin_parameters, cells_of_window, merge_all
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.reasons import Reason
from estimation.values.track import TrackAlignment
from estimation.values.units import GRAVITY
from estimation.values.windows import Window, WindowQuality
from estimation.vehicle.vehicle_class import VehicleClass
from ingest.simulator.axle_motion import axle_motions, contact_of, true_geometry
from ingest.simulator.campaign import scenario_track, vehicle_run, wheelset_record
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.fleet import surveyed
from ingest.simulator.irregularity import Waves, synthesise
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario
from ingest.simulator.sensor_errors import turned_axes
from ingest.simulator.side_files import class_entry
from ingest.vehicle_class_schema import VehicleClassEntry

SCENARIOS = Path(__file__).parent / "vehicle_scenarios"
VEHICLES = ("paper_known", "soft_known", "coach_known")
CROSS_LEVEL = Waves("gauge", 2e-3, (3.0, 70.0))
VERTICAL = 2e-3  # m, std
WINDOW_S = 60.0
AMPLITUDES: FloatArray = np.asarray(np.arange(4, 13) * 0.25e-3)  # m
COVERS = 0.9  # share of the intervals, from which on a row is as it should be
GOOD = WindowQuality(1.0, 0.0, 0, 0.0, 0.0, 5.0, 25.0, 1.0, sensor_fault=False)

Angles = tuple[FloatArray, FloatArray]
"""Of the transducers on axle box and mass, (3,) rad each about x, y and z."""


@dataclass(frozen=True, slots=True)
class Pass:
    """What a node measures in one campaign, and what it would if it were turned; (n,) each."""

    start_ns: int
    dt: float
    measured: FloatArray  # (n, 4) in the order of ACCELERATIONS
    speed: FloatArray
    distance: FloatArray
    longitudinal: FloatArray  # m/s2
    vertical: FloatArray  # m/s2
    pitch: FloatArray  # rad/s2


@dataclass(frozen=True, slots=True)
class Wheelset:
    """A wheelset with all its passes and its true conicity at ``AMPLITUDES``."""

    axle: int  # from 0
    ahead: float  # m, of the other axle of its bogie
    passes: tuple[Pass, ...]
    conicity: FloatArray


def rows() -> Iterator[BenchRow]:
    """Yield a row per vehicle and angle."""
    for name in VEHICLES:
        scenario = _scenario(name)
        vehicle_class = VehicleClassEntry.model_validate(class_entry(scenario, name)).record()
        gears, track = _gears(scenario), _on_file(scenario)
        for what, angles in _angles().items():
            yield _row(f"{name}: {what}", gears, vehicle_class, track, angles)


def _row(
    what: str,
    gears: list[tuple[Wheelset, ...]],
    vehicle_class: VehicleClass,
    track: TrackAlignment,
    angles: Callable[[int], Angles],
) -> BenchRow:
    errors, covered, reasons, wheelsets = [], [], set[str](), 0
    for gear in gears:
        windows = [_windows(one, angles(one.axle), vehicle_class) for one in gear]
        for place, one in enumerate(gear):
            wheelsets += 1
            own = windows[place]
            if vehicle_class.bogie is not None:
                own = [with_frame_yaw(*pair, one.ahead) for pair in zip(own, windows[1 - place], strict=True)]
            found = _estimated(own, one, vehicle_class, track)
            if isinstance(found, str):
                reasons.add(found)
            else:
                errors.append(float(np.mean(np.abs(found[0]))))
                covered += list(found[1])
    figures = f"error {np.median(errors):.4f}, worst {max(errors):.4f}" if errors else "nothing published"
    share = float(np.mean(covered)) if covered else 1.0
    text = f"{figures}; {len(errors)} of {wheelsets} published, {100 * share:.0f} % cover; {', '.join(sorted(reasons))}"
    return BenchRow(what, text.rstrip("; "), "covered, or refused", share >= COVERS)


def _estimated(
    windows: list[Window], wheelset: Wheelset, vehicle_class: VehicleClass, track: TrackAlignment
) -> tuple[FloatArray, FloatArray] | str:
    """Return errors of the conicity and whether the intervals cover, or the code for which nothing is published."""
    parameters = WindowParameters(vehicle_class)
    bins = bin_parameters(parameters)
    found = [cells_of_window(window, track, parameters) for window in windows]
    refused = [one for one in found if isinstance(one, Reason)]
    if len(refused) == len(found):
        return str(refused[0].code)
    table = merge_all([one for one in found if not isinstance(one, Reason)], bins)
    uncertainty = ParameterUncertainty.of(vehicle_class).on([track])
    geometry = estimate_geometry(table, bins, GeometryParameters(uncertainty=uncertainty))
    errors, covered = [], []
    for amplitude, true in zip(AMPLITUDES, wheelset.conicity, strict=True):
        one = geometry.conicity[int(np.argmin(np.abs(geometry.amplitude - amplitude)))]
        if one.value is not None and one.low is not None and one.high is not None:
            errors.append(one.value - true)
            covered.append(one.low <= true <= one.high)
    if not errors:
        return str(geometry.reason.code) if geometry.reason is not None else "conicity_open"
    return np.array(errors), np.array(covered)


def _angles() -> Mapping[str, Callable[[int], Angles]]:
    """Return the angles by axle, by what they are."""
    cases: dict[str, Callable[[int], Angles]] = {"as on file": lambda _: (np.zeros(3), np.zeros(3))}
    for degrees in (2.0, 10.0, 90.0):
        for place, axis in enumerate(("x", "y", "z")):
            cases[f"axle box about {axis}, {degrees:g} degrees"] = _of_one(0, place, degrees)
        cases[f"frame about x, {degrees:g} degrees"] = _of_one(1, 0, degrees)
    drawn = np.random.default_rng(7).standard_normal((4, 2, 3)) * np.radians(2.0)
    cases["all drawn, 2 degrees (std)"] = lambda axle: (drawn[axle, 0], drawn[axle, 1])
    return cases


def _of_one(transducer: int, axis: int, degrees: float) -> Callable[[int], Angles]:
    def angles(axle: int) -> Angles:
        both = np.zeros((2, 3))
        both[transducer, axis] = np.radians(degrees) * (1 if axle % 2 == 0 else -1)
        return both[0], both[1]

    return angles


def _windows(wheelset: Wheelset, angles: Angles, vehicle_class: VehicleClass) -> list[Window]:
    found = []
    for one in wheelset.passes:
        values, size = _turned(one, angles), round(WINDOW_S / one.dt)
        for k in range(len(values) // size):
            part = slice(k * size, (k + 1) * size)
            lateral, yaw, roll, mass = values[part].T
            found.append(
                Window(
                    wheelset="W",
                    vehicle="V",
                    axle=wheelset.axle + 1,
                    start_ns=one.start_ns + round(1e9 * k * WINDOW_S),
                    length_ns=round(1e9 * WINDOW_S),
                    sample_interval_s=one.dt,
                    lateral_acceleration=lateral,
                    yaw_acceleration=yaw,
                    roll_acceleration=roll,
                    mass_lateral_acceleration=mass,
                    speed=one.speed[part],
                    distance=one.distance[part],
                    valid=np.ones(size, dtype=np.bool_),
                    resolution=(1e-4, 1e-4, 1e-4, 1e-4),
                    track_section="S",
                    odometer_m=0.0,
                    quality=GOOD,
                    measures_gravity=vehicle_class.sensors.measures_gravity,
                )
            )
    return found


def _turned(one: Pass, angles: Angles) -> FloatArray:
    """Return what the node measures (n, 4) with its transducers turned."""
    lateral, yaw, roll, mass = one.measured.T
    axle_box, above = (turned_axes(item) for item in angles)
    upwards = GRAVITY + one.vertical
    angular = np.stack([roll, one.pitch, yaw])
    return np.column_stack(
        [
            axle_box[1] @ np.stack([one.longitudinal, lateral, upwards]),
            axle_box[2] @ angular,
            axle_box[0] @ angular,
            above[1] @ np.stack([one.longitudinal, mass, upwards]),
        ]
    )


def _gears(scenario: Scenario) -> list[tuple[Wheelset, ...]]:
    """Return the wheelsets of every vehicle's first bogie, or of its first two axles, with what they run over."""
    track = scenario_track(scenario)
    height = synthesise(
        "alignment",
        length=track.length,
        interval=track.interval,
        target_std=VERTICAL,
        wavelengths=CROSS_LEVEL.wavelengths,
        rng=np.random.default_rng([scenario.seed, 99]),
    )
    bend = CubicSpline(track.s, height).derivative(2)
    base = 2.5 if scenario.bogie is None else scenario.bogie.wheelbase
    groups = [(0, 1)] if scenario.bogie is not None else [(0,), (1,)]
    found = []
    for plan in scenario.vehicles:
        for axles in groups:
            contacts = [contact_of(scenario, track, plan.wheelsets[axle], scenario.odometer(0)) for axle in axles]
            passes: list[list[Pass]] = [[] for _ in axles]
            for campaign in range(scenario.sessions.campaigns):
                run = vehicle_run(scenario, track, plan, campaign)
                motions = axle_motions(scenario, track, run, axles, [one.table for one in contacts])
                for own, axle, motion in zip(passes, axles, motions, strict=True):
                    record, stride = wheelset_record(scenario, run, axle, motion), scenario.sensors.stride
                    speed, at = run.speed[::stride], motion.distance[::stride]
                    dt = float(record.t[1])
                    bent = speed**2 * bend(at)
                    pitch = -(bent - speed**2 * bend(at - base)) / base
                    own.append(Pass(run.start_ns, dt, record.values, speed, at, np.gradient(speed, dt), bent, pitch))
            truths = [
                true_geometry(scenario, plan.wheelsets[axle], one) for axle, one in zip(axles, contacts, strict=True)
            ]
            found.append(
                tuple(
                    Wheelset(
                        axle,
                        base if axle == 0 else -base,
                        tuple(own),
                        np.interp(AMPLITUDES, truth.amplitude, truth.equivalent_conicity),
                    )
                    for axle, own, truth in zip(axles, passes, truths, strict=True)
                )
            )
    return found


def _scenario(name: str) -> Scenario:
    scenario = with_seed(load_scenario(SCENARIOS / f"{name}.toml"), 0)
    return replace(scenario, running=replace(scenario.running, cross_level=CROSS_LEVEL))


def _on_file(scenario: Scenario) -> TrackAlignment:
    found = surveyed(scenario, scenario_track(scenario))
    zero = np.zeros(len(found.s))
    std = zero + scenario.section.survey_alignment_std
    return TrackAlignment("S", 1, found.s, found.alignment, std, zero, zero, zero.astype(np.int64), Status.ESTIMATED)
