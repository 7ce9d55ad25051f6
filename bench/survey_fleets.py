"""Drawn fleets on a section, for the bench of surveys: windows at their true positions, passes, and the truth.

No frames and no database: what the nodes of simulated wheelsets measure goes through the product's own functions.
A window here is a whole journey of a wheelset.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.drawn_journey import course, measured, worn_p8
from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import contact_table
from estimation.contact.method import ContactMethod
from estimation.jobs.settings import EstimationSettings
from estimation.motion.axle_distance import with_frame_yaw
from estimation.motion.integration import WindowParameters
from estimation.track.gridded_pass import resampled
from estimation.track.passes import Pass, ProfileLife, examine
from estimation.values.arrays import FloatArray
from estimation.values.units import HOUR_NS
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import (
    Arrangement,
    BogieParameters,
    SensorChannel,
    SensorLayout,
    VehicleClass,
    VehicleParameters,
)
from ingest.simulator.irregularity import Isolated, IsolatedKind
from ingest.simulator.running_gear import PreparedTable, RunningGear, simulate_gear
from ingest.simulator.track import TrackRecipe, TrackTruth, make_track

LENGTH, BEGIN = 4200.0, 100.0  # m, of the section, and where journeys begin and end
PASS_STEP = 0.2  # m
DEEPEST = 1.0e-3  # m of tread that the most worn wheelset has lost
AMPLITUDES = np.array([1.0e-3, 1.5e-3, 2.0e-3, 2.5e-3, 3.0e-3])  # m
GRID: FloatArray = np.asarray(np.arange(-180, 181) * 0.05e-3)  # m, of the contact tables
GAUGES = (-2e-3, 0.0, 2e-3, 4e-3, 6e-3, 8e-3, 10e-3)  # m, of those on a track with switches
SWITCH_EVERY = 1500.0  # m
SWITCH = Isolated(IsolatedKind.SWITCH, 12.0, 4.0e-3, 8.0e-3)
BLOW, BLOW_DECAY_S, BLOW_HZ = 60.0, 0.008, 40.0  # m/s2 on the axle box, once a turn of the wheel
SENSORS = SensorLayout(
    lateral=SensorChannel(1e-3, scale_std=0.005),
    yaw=SensorChannel(2e-3, scale_std=0.005),
    roll=SensorChannel(2e-3, scale_std=0.005),
    mass_lateral=SensorChannel(1e-3, scale_std=0.005),
    measures_gravity=False,
)
BOGIE = BogieParameters(
    wheelbase=2.5,
    frame_mass=2600.0,
    frame_yaw_inertia=2000.0,
    body_mass=16e3,
    secondary_lateral_stiffness=0.32e6,
    secondary_lateral_damping=64e3,
    secondary_yaw_stiffness=0.32e6,
)
SOFT = VehicleParameters(
    wheelset_mass=1813.0,
    yaw_inertia=1120.0,
    half_contact_distance=0.75,
    lateral_stiffness=5.0e6,
    lateral_damping=4.0e3,
    yaw_stiffness=2.5e6,
    longitudinal_creep_coefficient=9.4e6,
    lateral_creep_coefficient=8.7e6,
)
COACH = replace(SOFT, lateral_stiffness=7.768e6, yaw_stiffness=62.782e6, yaw_damping=30.0e3)
SPREAD = ("longitudinal_creep_coefficient", "lateral_creep_coefficient", "yaw_stiffness", "lateral_stiffness")
SPREAD_STD = 0.03  # relative, of the vehicles about their class


@dataclass(frozen=True, slots=True)
class FleetPlan:
    """What runs over the section, and how."""

    vehicles: int = 3
    journeys: int = 4  # of each vehicle
    parameters: VehicleParameters = SOFT
    bogies: bool = True  # else single wheelsets under masses that do not yaw
    speeds: tuple[float, float] = (14.0, 25.0)  # m/s, of the slowest and the fastest journey
    switches: bool = False
    flat: bool = False  # on one wheelset of the first vehicle


@dataclass(frozen=True, slots=True)
class Fleet:
    """What was measured of a fleet, at true positions, and the truth."""

    track: TrackTruth
    windows: tuple[Window, ...]
    passes: tuple[Pass, ...]
    conicity: Mapping[str, FloatArray]  # by serial, at ``AMPLITUDES``
    parameters: WindowParameters


@dataclass(frozen=True, slots=True)
class _Vehicle:
    code: str
    gear: RunningGear
    serials: Sequence[str]
    tables: Sequence[PreparedTable]


def drawn_track(seed: int, *, switches: bool = False) -> TrackTruth:
    """Return the track of a seed; with switches one stands every ``SWITCH_EVERY``."""
    at = tuple(float(s) for s in np.arange(0.5 * SWITCH_EVERY, LENGTH - BEGIN, SWITCH_EVERY))
    standing = (replace(SWITCH, at=at),) if switches else ()
    recipe = TrackRecipe(length=LENGTH, alignment_std=2e-3, isolated=standing)
    return make_track(recipe, np.random.SeedSequence([seed, 35]))


def drawn_fleet(plan: FleetPlan, seed: int) -> Fleet:
    """Return the fleet of a plan for one seed."""
    rng = np.random.default_rng([seed, 350])
    track = drawn_track(seed, switches=plan.switches)
    parameters = EstimationSettings().windows(_class_of(plan), None)
    windows: list[Window] = []
    conicity: dict[str, FloatArray] = {}
    for number in range(plan.vehicles):
        vehicle, true = _vehicle(plan, f"V{number}", rng)
        conicity |= true
        for journey in range(plan.journeys):
            start_ns = (1 + journey * plan.vehicles + number) * HOUR_NS
            windows += _journey(vehicle, track, float(rng.uniform(*plan.speeds)), start_ns, rng)
    if plan.flat:
        windows = [_with_flat(one, rng) if one.wheelset == "V0W0" else one for one in windows]
    if plan.bogies:
        windows = _joined(windows)
    return Fleet(track, tuple(windows), tuple(_passes(windows, parameters)), conicity, parameters)


def _class_of(plan: FleetPlan) -> VehicleClass:
    kind = Arrangement.BOGIE if plan.bogies else Arrangement.SINGLE_WHEELSET
    bogie = BOGIE if plan.bogies else None
    return VehicleClass("bench", "Of the bench", "bench", kind, plan.parameters, bogie, SENSORS)


def _vehicle(plan: FleetPlan, code: str, rng: np.random.Generator) -> tuple[_Vehicle, dict[str, FloatArray]]:
    own = {name: getattr(plan.parameters, name) * float(np.exp(SPREAD_STD * rng.standard_normal())) for name in SPREAD}
    gear = RunningGear(replace(plan.parameters, **own), BOGIE if plan.bogies else None)
    serials = [f"{code}W{axle}" for axle in range(4)]
    tables, conicity = [], {}
    for serial in serials:
        depth, skew = float(rng.uniform(0.0, DEEPEST)), float(rng.uniform(-0.1, 0.1))
        on_track = worn_p8(depth, skew)
        table = contact_table(on_track, GRID, GAUGES if plan.switches else (0.0,), outside="hold")
        standard = contact_table(on_track, GRID, (0.0,), outside="hold", method=ContactMethod.EN15302)
        conicity[serial] = equivalent_conicity(GRID, standard.rolling_radius_difference[:, 0], AMPLITUDES)
        tables.append(PreparedTable.of(table))
    return _Vehicle(code, gear, serials, tables), conicity


def _journey(
    vehicle: _Vehicle, track: TrackTruth, mean_speed: float, start_ns: int, rng: np.random.Generator
) -> list[Window]:
    speed = course(LENGTH - 2 * BEGIN, mean_speed, rng)
    found, count = [], vehicle.gear.axles
    for first in range(0, len(vehicle.serials), count):
        motions = simulate_gear(vehicle.gear, vehicle.tables[first : first + count], track, speed, BEGIN)
        for axle, motion in enumerate(motions, start=first):
            found.append(measured(motion, vehicle.serials[axle], start_ns, rng, vehicle=vehicle.code, axle=axle + 1))
    return found


def _with_flat(window: Window, rng: np.random.Generator) -> Window:
    """Return a window whose axle box is struck once a turn of the wheel."""
    turns = window.distance / (2.0 * np.pi * 0.45) + float(rng.uniform())
    since = (turns % 1.0) * 2.0 * np.pi * 0.45 / window.speed
    blow = BLOW * np.exp(-since / BLOW_DECAY_S) * np.sin(2.0 * np.pi * BLOW_HZ * since + float(rng.uniform(0, 6)))
    return replace(
        window,
        lateral_acceleration=window.lateral_acceleration + blow,
        yaw_acceleration=window.yaw_acceleration + blow,
        roll_acceleration=window.roll_acceleration + blow,
    )


def _joined(windows: Sequence[Window]) -> list[Window]:
    """Return the windows with the yaw of the frame between the two axles of a bogie."""
    by_axle = {(one.vehicle, one.start_ns, one.axle): one for one in windows}
    found = []
    for one in windows:
        front = one.axle % 2 == 1
        partner = by_axle[one.vehicle, one.start_ns, one.axle + (1 if front else -1)]
        found.append(with_frame_yaw(one, partner, BOGIE.wheelbase if front else -BOGIE.wheelbase))
    return found


def _passes(windows: Sequence[Window], parameters: WindowParameters) -> list[Pass]:
    return [
        resampled(item, ProfileLife(window.wheelset), PASS_STEP)
        for window in windows
        for item in examine(window, parameters)[0]
    ]
