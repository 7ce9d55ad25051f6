"""One row of the adhesion bench for one seed: creep forces, friction and the geometry beside low friction."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from bench.adhesion_fleet import Fleet, SensedWindow, true_friction
from bench.scores import AMPLITUDES, compared_at
from estimation.adhesion.creep_forces import (
    ContactForces,
    FrictionParameters,
    forces_on,
    gear_segments,
)
from estimation.adhesion.friction import section_adhesion
from estimation.adhesion.window_adhesion import AdhesionInputs, contact_angles, creep_signals, window_adhesion
from estimation.filters import remove_wander
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.motion.checks import away_from_low_adhesion
from estimation.motion.integration import Gates, SignalParameters, WindowParameters
from estimation.motion.window_motion import window_motion
from estimation.tables.bin_table import bin_parameters, fill_cells, merge_all
from estimation.values.arrays import FloatArray, runs
from estimation.values.geometry import FilledCells, WheelsetGeometry
from estimation.values.opinions import SectionAdhesion, WindowAdhesion
from estimation.values.reasons import Reason
from estimation.values.track import TrackSectionRecord
from estimation.values.windows import Motion, Window
from estimation.vehicle.vehicle_class import VehicleClass
from ingest.simulator.axle_motion import contact_of, true_geometry
from ingest.simulator.running import CreepLaw
from ingest.simulator.scenario import Scenario


@dataclass(frozen=True, slots=True)
class StoredPasses:
    """What the windows of a case say of friction, and what is true."""

    section: str
    passes: tuple[WindowAdhesion, ...]
    distance: FloatArray  # (n,) m
    friction: FloatArray  # (n,) true coefficient there
    length: float  # m, of the section


LOW = 0.15
WITHIN = 200.0  # m from the start of a stretch within which it is to be found
STEP = 1.0  # m


@dataclass(slots=True)
class FrictionScore:
    """What is found of the friction of one case; plain numbers."""

    cells: list[dict[str, float | None]] = field(default_factory=list)
    stretches: list[tuple[float, float]] = field(default_factory=list)  # true ones that were passed
    found: list[bool] = field(default_factory=list)
    alarms: list[tuple[float, float, float]] = field(default_factory=list)  # begin, end, least friction in it
    left_out: list[str] = field(default_factory=list)  # vehicles and wheelsets that contradict the others


def judge(stored: StoredPasses) -> FrictionScore:
    """Pool the passes of a case and compare with the truth."""
    found = section_adhesion(stored.section, stored.passes, FrictionParameters(), stored.length)
    return FrictionScore() if found is None else compare(found, stored)


def compare(found: SectionAdhesion, stored: StoredPasses) -> FrictionScore:
    """Return the friction that was found beside the true one: places, stretches that are found, false alarms."""
    done = FrictionScore(left_out=[one.wheelset or one.vehicle for one in found.left_out])
    for cell in found.cells:
        along = _along(stored, cell.from_m, cell.to_m)
        done.cells.append(
            {
                "from": cell.from_m,
                "mean": float(along.mean()),
                "least": float(along.min()),
                "value": cell.friction.value,
                "low": cell.friction.low,
                "high": cell.friction.high,
                "at_least": cell.at_least,
            }
        )
    passed = [cell.from_m for cell in found.cells if cell.friction.value is not None or cell.at_least]
    if not passed:
        return done
    s = np.arange(max(min(passed), 0.0), min(max(passed), stored.length), STEP)
    friction = np.interp(s, stored.distance, stored.friction)
    for first, behind in runs(friction < LOW):
        begin, end = float(s[first]), float(s[behind - 1])
        done.stretches.append((begin, end))
        reach = min(begin + WITHIN, max(end, begin + STEP))
        done.found.append(any(a <= reach and b >= begin for a, b in found.low_stretches))
    done.alarms = [(a, b, float(_along(stored, a, b).min())) for a, b in found.low_stretches]
    return done


def _along(stored: StoredPasses, begin: float, end: float) -> FloatArray:
    s = np.arange(begin, end + STEP, STEP)
    return np.asarray(np.interp(s, stored.distance, stored.friction))


@dataclass(slots=True)
class Squares:
    """Sums of squares of the errors of a force and of the force."""

    error: float = 0.0
    force: float = 0.0

    def add(self, found: FloatArray, true: FloatArray) -> None:
        """Add samples (n,)."""
        self.error += float(((found - true) ** 2).sum())
        self.force += float((true**2).sum())


@dataclass(slots=True)
class AdhesionScore:
    """One row, one seed; plain numbers."""

    row: str
    seed: int
    lateral: Squares = field(default_factory=Squares)
    moment: Squares = field(default_factory=Squares)
    contact: Squares = field(default_factory=Squares)
    newton_contact: Squares = field(default_factory=Squares)  # integrals put into Newton's equations, without a filter
    newton_moment: Squares = field(default_factory=Squares)
    friction: FrictionScore = field(default_factory=FrictionScore)
    vehicle_km: float = 0.0
    conicity_all: list[float] = field(default_factory=list)  # errors, with every sample
    conicity_left_out: list[float] = field(default_factory=list)  # without samples on low friction
    force_seconds: float = 0.0
    wheelset_seconds: float = 0.0
    stored: StoredPasses | None = None  # None where there is no friction

    def as_json(self) -> dict[str, Any]:
        """Return everything but the passes as JSON values."""
        values = asdict(replace(self, stored=None))
        del values["stored"]
        return values | values.pop("friction")


def score(fleet: Fleet, row: str, *, left_out_too: bool = True) -> AdhesionScore:
    """Compare what is estimated of a fleet with the truth.

    ``left_out_too`` says that the geometry without the samples on low friction is estimated beside.
    """
    scenario = fleet.scenario
    done = AdhesionScore(row, scenario.seed, vehicle_km=vehicle_km(fleet))
    parameters = _parameters(fleet)
    motions = [window_motion(one.window, fleet.alignment, parameters[one.window.wheelset]) for one in fleet.windows]
    geometries = _geometries(fleet.windows, motions, parameters)
    done.conicity_all = _conicity_errors(scenario, fleet, geometries)
    passes = list(_passes(fleet, motions, parameters, geometries, done))
    if scenario.creep.law is CreepLaw.LINEAR:
        return done
    s = np.arange(fleet.track.s[0], fleet.track.s[-1], STEP)
    friction = true_friction(scenario, fleet.track, 0, s)
    done.stored = StoredPasses(scenario.section.code, tuple(passes), s, friction, _length(fleet))
    found = section_adhesion(scenario.section.code, passes, FrictionParameters(), done.stored.length)
    if found is None:
        return done
    done.friction = compare(found, done.stored)
    if not left_out_too:
        return done
    if not found.certain_stretches:
        done.conicity_left_out = done.conicity_all
        return done
    left_out = [away_from_low_adhesion(one.window, found.certain_stretches) for one in fleet.windows]
    again = [
        one if isinstance(one, Reason) else window_motion(one, fleet.alignment, parameters[one.wheelset])
        for one in left_out
    ]
    done.conicity_left_out = _conicity_errors(scenario, fleet, _geometries(fleet.windows, again, parameters))
    return done


def _parameters(fleet: Fleet) -> dict[str, WindowParameters]:
    plans = [plan for vehicle in fleet.scenario.vehicles for plan in vehicle.wheelsets]
    signals, gates = SignalParameters(), Gates()
    return {
        plan.serial: WindowParameters.of(fleet.vehicle_class, plan.nominal_radius, signals, gates) for plan in plans
    }


def _geometries(
    windows: Sequence[SensedWindow], motions: Sequence[Motion | Reason], parameters: Mapping[str, WindowParameters]
) -> dict[str, WheelsetGeometry]:
    tables: dict[str, list[FilledCells]] = defaultdict(list)
    for one, motion in zip(windows, motions, strict=True):
        if isinstance(motion, Motion):
            serial = one.window.wheelset
            tables[serial].append(fill_cells(motion, bin_parameters(parameters[serial])))
    bins = {serial: bin_parameters(parameters[serial]) for serial in tables}
    return {
        serial: estimate_geometry(merge_all(found, bins[serial]), bins[serial], GeometryParameters())
        for serial, found in tables.items()
    }


def _conicity_errors(scenario: Scenario, fleet: Fleet, geometries: Mapping[str, WheelsetGeometry]) -> list[float]:
    """Return the errors of every conicity that is published at 1 to 3 mm."""
    errors = []
    for plan in (one for vehicle in scenario.vehicles for one in vehicle.wheelsets if one.serial in geometries):
        truth = true_geometry(scenario, plan, contact_of(scenario, fleet.track, plan, scenario.odometer(0)))
        true = np.interp(AMPLITUDES, truth.amplitude, truth.equivalent_conicity)
        geometry = geometries[plan.serial]
        found = compared_at(AMPLITUDES, true, geometry.amplitude, geometry.conicity)
        errors += [one.error for one in found if one is not None]
    return errors


def _passes(
    fleet: Fleet,
    motions: Sequence[Motion | Reason],
    parameters: Mapping[str, WindowParameters],
    geometries: Mapping[str, WheelsetGeometry],
    done: AdhesionScore,
) -> list[WindowAdhesion]:
    plan = fleet.scenario.section
    section = TrackSectionRecord(
        plan.code, plan.number, plan.name, plan.rail_profile, plan.inclination, plan.nominal_gauge, fleet.track.length
    )
    profiles = {one.serial: one.wheel_profile for vehicle in fleet.scenario.vehicles for one in vehicle.wheelsets}
    found = []
    for gear in _gears(fleet.windows):
        windows = [fleet.windows[i].window for i in gear]
        first = parameters[windows[0].wheelset]
        began = time.process_time()
        forces = contact_forces(windows, fleet.vehicle_class, first.signals)
        done.force_seconds += time.process_time() - began
        done.wheelset_seconds += sum(1e-9 * window.length_ns for window in windows)
        for place, i in enumerate(gear):
            one, motion, serial = fleet.windows[i], motions[i], windows[place].wheelset
            force = forces if isinstance(forces, Reason) else forces[place]
            if isinstance(force, Reason) or isinstance(motion, Reason):
                continue
            inputs = AdhesionInputs(parameters[serial], geometries[serial], profiles[serial], section)
            found.append(window_adhesion(one.window, "", force, motion, inputs))
            _score_forces(one, force, motion, inputs, done)
    return found


def contact_forces(
    windows: Sequence[Window], vehicle_class: VehicleClass, signals: SignalParameters
) -> tuple[ContactForces, ...] | Reason:
    """Return the forces on each wheelset of a running gear, or why they cannot be had."""
    segments = gear_segments(windows, vehicle_class, signals)
    return segments if isinstance(segments, Reason) else forces_on(segments, vehicle_class)


def _gears(windows: Sequence[SensedWindow]) -> list[list[int]]:
    """Return the indices of the windows of one running gear and time, front axle first."""
    gears: dict[tuple[str, int, int], list[int]] = defaultdict(list)
    for i, one in enumerate(windows):
        bogie = (one.window.axle - 1) // 2 if one.window.frame_yaw_acceleration is not None else one.window.axle
        gears[one.window.vehicle, bogie, one.window.start_ns].append(i)
    return list(gears.values())


def vehicle_km(fleet: Fleet) -> float:
    """Return how far the vehicles of a fleet have run in its windows."""
    first = [one.window for one in fleet.windows if one.window.axle == 1]
    return float(sum(1e-3 * one.sample_interval_s * one.speed.sum() for one in first))


def _score_forces(
    one: SensedWindow, force: ContactForces, motion: Motion, inputs: AdhesionInputs, done: AdhesionScore
) -> None:
    """Compare forces with the truth in the band of the motion."""
    window, p = one.window, inputs.parameters.vehicle
    geometry = inputs.geometry
    curve = (geometry.bin_centres, geometry.rolling_radius_difference.value)
    angles = contact_angles(*curve, inputs.wheel_profile, inputs.section, p.nominal_radius)
    cutoff, dt = inputs.parameters.signals.cutoff_wavelength, window.sample_interval_s
    known = None if isinstance(angles, Reason) else angles
    signals = creep_signals(force, motion, p, dt, cutoff, known)
    run = np.concatenate([[0.0], np.cumsum(0.5 * dt * (window.speed[1:] + window.speed[:-1]))])
    true = np.stack([one.truth.lateral_creep, one.truth.yaw_creep, one.truth.contact])
    lateral, moment, contact = remove_wander(true, run, window.valid, cutoff)
    good = signals.valid
    if known is not None:
        done.lateral.add(signals.lateral[good], lateral[good])
    done.moment.add(signals.moment[good], moment[good])
    done.contact.add(signals.contact[good], contact[good])
    newton = p.wheelset_mass * motion.lateral_acceleration - p.lateral_stiffness * motion.suspension_deflection
    newton = newton - p.lateral_damping * motion.suspension_deflection_rate
    frame = (np.zeros(1) if one is None else one for one in (motion.frame_yaw, motion.frame_yaw_rate))
    yaw, yaw_rate = (own - other for own, other in zip((motion.yaw, motion.yaw_rate), frame, strict=True))
    turning = p.yaw_inertia * motion.yaw_acceleration + p.yaw_stiffness * yaw
    turning = turning + p.yaw_damping * yaw_rate
    turning = turning + p.pitch_inertia * motion.speed / p.nominal_radius * motion.roll_rate
    done.newton_contact.add(newton[good], contact[good])
    done.newton_moment.add(turning[good], moment[good])


def _length(fleet: Fleet) -> float:
    recipe = fleet.scenario.section.recipe
    return fleet.track.length if recipe is None else recipe.length
