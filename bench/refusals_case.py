"""A vehicle of the bench of refusals: drawn by its seed, run over a track, and what its nodes measure.

Arrangement, sensors, vibration, profiles, speed and track are drawn by the seed, each independently of the others, so
that every pair of them occurs. One running gear is simulated: the first bogie, or the first wheelset.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from bench.made_scenario import Tables, changed_scenario
from bench.made_values import made_alignment, made_window
from bench.scores import AMPLITUDES, Compared, compared_at
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.rolling_radius import check_radius, rolling_radius
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.parameters import JOBS
from estimation.jobs.steps.estimated_geometry import CONTRADICTIONS
from estimation.motion.axle_distance import (
    bogie_runs_backwards,
    check_axle_distance,
    check_frame_sensors,
    turned_over,
    with_frame_yaw,
)
from estimation.motion.checks import runs_backwards
from estimation.motion.integration import Gates, SignalParameters, WindowParameters
from estimation.motion.rolling_sums import rolling_sums
from estimation.tables.bin_table import bin_parameters, cells_of_window, merge_all
from estimation.values.arrays import FloatArray
from estimation.values.geometry import WheelsetGeometry
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.roll_up import RollingSums
from estimation.values.track import TrackAlignment
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import Arrangement, VehicleClass
from ingest.simulator.axle_motion import axle_motions, contact_of, true_geometry
from ingest.simulator.campaign import scenario_track, vehicle_run, wheelset_record
from ingest.simulator.fleet import surveyed
from ingest.simulator.scenario import Scenario
from ingest.simulator.side_files import class_entry
from ingest.vehicle_class_schema import VehicleClassEntry

SCENARIOS = Path(__file__).parent / "vehicle_scenarios"
WINDOW_S = 60.0
RESOLUTION = (1e-3, 1e-3, 1e-3, 1e-3)  # of a count on the bus

DIMENSIONS: Mapping[str, tuple[str, ...]] = {
    "arrangement": ("single", "soft bogie", "coach", "push-pull single", "push-pull bogie", "push-pull coach"),
    "sensors": ("quiet", "mems", "gyroscopes"),
    "vibration": ("0", "2", "5", "10"),
    "pair": ("new P8", "hollow P8", "S1002 1:40", "unlike wheels", "worn S1002"),
    "speed": ("12", "20", "30"),
    "track": ("level", "cross level", "switches"),
    "survey": ("0.1", "0.3", "1.0"),
}
_SENSORS: Mapping[str, Tables] = {
    "quiet": {
        "lateral_noise_ug_per_root_hz": 10.0,
        "mass_noise_ug_per_root_hz": 10.0,
        "angular_noise_rad_s2_per_root_hz": 2e-4,
        "lateral_offset_mg": 2.0,
        "mass_offset_mg": 2.0,
    },
    "mems": {},
    "gyroscopes": {"gyroscopes": True},
}
_PAIRS = {  # wheel, rail, inclination, deepest wear in mm, asymmetry in percent
    "new P8": ("P8", "56E1", 20, 0.1, 8),
    "hollow P8": ("P8", "56E1", 20, 1.4, 8),
    "S1002 1:40": ("S1002", "60E1", 40, 0.2, 8),
    "unlike wheels": ("P8", "56E1", 20, 0.9, 45),
    "worn S1002": ("S1002", "60E1", 40, 0.75, 15),
}
_TRACKS: Mapping[str, Tables] = {
    "level": {},
    "cross level": {"cross_level": {"std_mm": 2.0}},
    "switches": {"switches": [{"per_km": 0.7}]},
}
_BASES = {"single": "paper_known", "bogie": "soft_known", "coach": "coach_known"}


@dataclass(frozen=True, slots=True)
class RefusalCase:
    """What a running gear measured, what is on file of it, and what is true.

    Attributes:
        drawn: What was drawn of each of ``DIMENSIONS``.
        windows: Of each axle, front first, in order of time: as the nodes measure, in the axes of the vehicle.
        offsets: Of the axles, m behind the reference of the position.
        conicity: True ones of each wheelset at ``AMPLITUDES``.
    """

    drawn: Mapping[str, str]
    windows: tuple[tuple[Window, ...], ...]
    offsets: tuple[float, ...]
    vehicle_class: VehicleClass
    track: TrackAlignment
    conicity: tuple[FloatArray, ...]


def drawn_case(seed: int, **fixed: str) -> dict[str, str]:
    """Return what the case of a seed is."""
    rng = np.random.default_rng([35, seed])
    return {name: str(rng.choice(kinds)) for name, kinds in DIMENSIONS.items()} | fixed


def simulated(seed: int, campaigns: int, **fixed: str) -> RefusalCase:
    """Return the case of a seed after two minutes of running in each campaign."""
    drawn = drawn_case(seed, **fixed)
    scenario = _scenario(drawn, seed, campaigns)
    track, plan = scenario_track(scenario), scenario.vehicles[0]
    axles = (0,) if scenario.bogie is None else (0, 1)
    contacts = [contact_of(scenario, track, plan.wheelsets[axle], scenario.odometer(0)) for axle in axles]
    vehicle_class = VehicleClassEntry.model_validate(class_entry(scenario, "C")).record()
    windows: list[list[Window]] = [[] for _ in axles]
    for campaign in range(campaigns):
        back = drawn["arrangement"].startswith("push-pull") and campaign % 2 == 1
        run = vehicle_run(scenario, track, plan, campaign)
        # the front axle of a train that runs backwards is the rear one by its registry
        order = axles[::-1] if back else axles
        motions = axle_motions(scenario, track, run, axles, [contacts[axle].table for axle in order])
        for place, motion in zip(order, motions, strict=True):
            record, stride = wheelset_record(scenario, run, place, motion), scenario.sensors.stride
            values = record.values * ([-1.0, 1.0, -1.0, -1.0] if back else 1.0)
            at = motion.distance[::stride] - (2.0 * plan.axle_offsets[place] if back else 0.0)  # as it is assembled
            windows[place] += _windows(place, values, run.start_ns, float(record.t[1]), run.speed[::stride], at)
    truths = [true_geometry(scenario, plan.wheelsets[axle], one) for axle, one in zip(axles, contacts, strict=True)]
    conicity = tuple(np.interp(AMPLITUDES, one.amplitude, one.equivalent_conicity) for one in truths)
    offsets, survey = tuple(plan.axle_offsets[axle] for axle in axles), surveyed(scenario, track)
    on_file = made_alignment(survey.s, survey.alignment, scenario.section.survey_alignment_std)
    return RefusalCase(drawn, tuple(map(tuple, windows)), offsets, vehicle_class, on_file, conicity)


def _windows(
    axle: int, values: FloatArray, start_ns: int, dt: float, speed: FloatArray, at: FloatArray
) -> list[Window]:
    size = round(WINDOW_S / dt)
    parts = [slice(k * size, (k + 1) * size) for k in range(len(values) // size)]
    return [
        made_window(
            *(
                np.round(values[part] / RESOLUTION) * RESOLUTION,
                f"W{axle + 1}",
                start_ns + round(1e9 * k * WINDOW_S),
                dt,
            ),
            axle=axle + 1,
            length_ns=round(1e9 * WINDOW_S),
            speed=speed[part],
            distance=at[part],
            resolution=RESOLUTION,
            measures_gravity=True,
        )
        for k, part in enumerate(parts)
    ]


def _scenario(drawn: Mapping[str, str], seed: int, campaigns: int) -> Scenario:
    wheel, rail, inclination, wear, asymmetry = _PAIRS[drawn["pair"]]
    speed, size = float(drawn["speed"]), float(drawn["vibration"])
    vibration = {"axle_box_vibration_m_s2": size, "axle_box_vibration_rad_s2": 0.5 * size} if size else {}
    pair = {"name": "P", "wheel_profile": wheel, "rail_profile": rail, "rail_inclination_1_in": float(inclination)}
    changes = {
        "seed": seed,
        "speed": {"lowest_m_s": round(0.8 * speed, 6), "highest_m_s": round(1.2 * speed, 6)},
        "section": {
            "survey_alignment_std_mm": float(drawn["survey"]),
            "alignment_std_mm": 1.8,
            **_TRACKS[drawn["track"]],
        },
        "sessions": {"campaigns": campaigns},
        "sensors": {**_SENSORS[drawn["sensors"]], **vibration},
        "drawn_fleet": {
            "vehicles": 1,
            "wheelsets_each": 2,
            "class": "C",
            "wear": {
                "distribution": "uniform",
                "lowest_mm": round(0.6 * wear, 6),
                "asymmetry_percent": float(asymmetry),
            },
            "pairs": [{**pair, "deepest_wear_mm": wear}],
        },
    }
    return changed_scenario(SCENARIOS / f"{_BASES[drawn['arrangement'].split()[-1]]}.toml", changes)


class OnFile(StrEnum):
    """What is wrong on file, or of the nodes."""

    RIGHT = "right"
    RADIUS_HIGH = "radius +10 %"
    RADIUS_LOW = "radius -10 %"
    WHEELBASE = "wheelbase -30 %"
    EXCHANGED = "nodes exchanged"
    DEAD_FRAME = "frame sensor dead"
    CLASS = "bogie as single wheelset"


WITHHELD = frozenset(
    (
        *CONTRADICTIONS,
        ReasonCode.FRAME_UNKNOWN,
        ReasonCode.YAW_SPRING_DIFFERS,
        ReasonCode.MOTION_UNEXPLAINED,
        ReasonCode.ROLLING_RADIUS_DIFFERS,
    )
)
IN_BOGIES = (OnFile.WHEELBASE, OnFile.EXCHANGED, OnFile.DEAD_FRAME, OnFile.CLASS)


@dataclass(frozen=True, slots=True)
class Judged:
    """What is said of one wheelset."""

    published: bool
    code: str  # why not, or what is in doubt; empty where nothing is
    errors: tuple[float, ...]  # of the conicity where it is published
    covered: tuple[bool, ...]
    values: tuple[float | None, ...] = ()  # of the conicity, over all amplitudes
    found: tuple[Compared, ...] = ()
    radius: tuple[float, float, float] | None = None  # error, std and bound of the std of that by the motion, relative

    @property
    def withheld(self) -> bool:
        """Whether nothing is published for what the data contradict; too little of them is no contradiction."""
        return not self.published and self.code in WITHHELD

    @property
    def doubted(self) -> bool:
        """Whether a number is published with a doubt beside it."""
        return self.published and bool(self.code)


def judged(case: RefusalCase, on_file: OnFile) -> tuple[Judged, ...]:
    """Return what is said of each wheelset of a case."""
    vehicle_class = registered(case.vehicle_class, on_file)
    nodes = _measured(case.windows, on_file)
    offsets = _offsets(case, vehicle_class)
    return tuple(_judged(case, vehicle_class, axle, nodes, offsets) for axle in range(len(nodes)))


def registered(vehicle_class: VehicleClass, on_file: OnFile) -> VehicleClass:
    """Return a class as it is on file."""
    factor = {OnFile.RADIUS_HIGH: 1.1, OnFile.RADIUS_LOW: 0.9}.get(on_file, 1.0)
    radius = factor * vehicle_class.parameters.nominal_radius
    changed = replace(vehicle_class, parameters=replace(vehicle_class.parameters, nominal_radius=radius))
    bogie = vehicle_class.bogie
    if bogie is not None and on_file is OnFile.WHEELBASE:
        return replace(changed, bogie=replace(bogie, wheelbase=0.7 * bogie.wheelbase))
    if on_file is OnFile.CLASS:
        return replace(changed, arrangement=Arrangement.SINGLE_WHEELSET, bogie=None, relative_std={})
    return changed


def _measured(windows: Sequence[Sequence[Window]], on_file: OnFile) -> list[list[Window]]:
    found = [list(of_axle) for of_axle in windows]
    if on_file is OnFile.EXCHANGED:
        names = ("lateral_acceleration", "yaw_acceleration", "roll_acceleration", "mass_lateral_acceleration")
        pairs = list(zip(*windows, strict=True))
        found = [
            [replace(pair[axle], **{name: getattr(pair[1 - axle], name) for name in names}) for pair in pairs]
            for axle in (0, 1)
        ]
    if on_file is OnFile.DEAD_FRAME:
        found[0] = [replace(one, mass_lateral_acceleration=np.zeros(len(one.valid))) for one in found[0]]
    return found


def _offsets(case: RefusalCase, vehicle_class: VehicleClass) -> tuple[float, ...]:
    if vehicle_class.bogie is None:
        return case.offsets
    return case.offsets[0], case.offsets[0] + vehicle_class.bogie.wheelbase


def _judged(
    case: RefusalCase,
    vehicle_class: VehicleClass,
    axle: int,
    nodes: Sequence[Sequence[Window]],
    offsets: Sequence[float],
) -> Judged:
    parameters = WindowParameters.of(vehicle_class, None, SignalParameters(), Gates())
    pairs = [(own, None if vehicle_class.bogie is None else nodes[1 - axle][k]) for k, own in enumerate(nodes[axle])]
    behind = offsets[axle]
    ahead = 0.0 if vehicle_class.bogie is None else offsets[1 - axle] - behind
    windows = [_loaded(own, other, ahead, behind) for own, other in pairs]
    tables = [one if isinstance(one, Reason) else cells_of_window(one, case.track, parameters) for one in windows]
    refused = Counter(one.code for one in tables if isinstance(one, Reason))
    against = sum(count for code, count in refused.items() if code in CONTRADICTIONS)
    good = [one for one in tables if not isinstance(one, Reason)]
    if not good or against > JOBS.most_refused_share * (against + len(good)):
        return Judged(published=False, code=str(refused.most_common(1)[0][0]), errors=(), covered=())
    bins = bin_parameters(parameters)
    uncertainty = ParameterUncertainty.of(vehicle_class).on([case.track])
    geometry = estimate_geometry(merge_all(good, bins), bins, GeometryParameters(uncertainty=uncertainty))
    if geometry.status is not Status.MODEL_MISMATCH:
        radius, std = vehicle_class.parameters.nominal_radius, vehicle_class.std_of("nominal_radius")
        used = [one for one in windows if not isinstance(one, Reason)]
        sums = [part for own in used for part in rolling_sums(own, vehicle_class, parameters.signals)]
        geometry = geometry.against(check_radius(sums, radius, std))
        return replace(_verdict(geometry, case, axle), radius=_radius(sums, case))
    return _verdict(geometry, case, axle)


def _radius(sums: Sequence[RollingSums], case: RefusalCase) -> tuple[float, float, float] | None:
    """Return error, std and bound of the std of the radius that the motion has, over the true one."""
    found, true = rolling_radius(sums), case.vehicle_class.parameters.nominal_radius
    return None if found is None else (found.value / true - 1.0, found.std / true, found.bound / true)


def _loaded(own: Window, other: Window | None, ahead: float, behind: float) -> Window | Reason:
    """Return a window as the jobs load it."""
    if other is None:
        return turned_over(own, behind) if runs_backwards(own) else own
    backwards = bogie_runs_backwards(own, other, ahead)
    reason = check_axle_distance(own, other, -ahead if backwards else ahead) or check_frame_sensors(own, other)
    if reason is not None:
        return reason
    framed = with_frame_yaw(own, other, ahead)
    return turned_over(framed, behind) if backwards else framed


def _verdict(geometry: WheelsetGeometry, case: RefusalCase, axle: int) -> Judged:
    found = compared_at(AMPLITUDES, case.conicity[axle], geometry.amplitude, geometry.conicity)
    published = tuple(one for one in found if one is not None)
    values = [None if one is None else one.error + true for one, true in zip(found, case.conicity[axle], strict=True)]
    reason = geometry.reason or (None if published else geometry.equivalent_conicity.reason)
    code, errors = "" if reason is None else str(reason.code), tuple(one.error for one in published)
    return Judged(
        bool(published), code, errors, tuple(one.covered for one in published), tuple(values), found=published
    )
