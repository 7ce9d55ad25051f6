"""Rows of the adhesion bench beside those of scenario files: the file is wrong, or the sensors hide nothing.

In the rows ``WRONG`` masses and load of the class, scales of sensors or the survey are others. A seed of the row
``low`` is simulated once; its windows are estimated again with each error. In the rows ``one_...`` the first vehicle
alone has the error: the passes of the others are those of the row ``low``.

In most of the rows around ``quiet`` the rails are dry, so that every alarm is false. What each row puts beside is what
creep was once taken for low friction with: small forces, errors of survey and gauge, cross level, curves that nobody
registered, a load that is wrong, sensors, other profiles, speed. ``..._leaves`` have two stretches of low friction,
which are due.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.adhesion_case import StoredPasses
from bench.adhesion_fleet import Fleet, SensedWindow
from bench.made_scenario import changed_scenario
from estimation.values.track import TrackAlignment
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import BogieParameters, VehicleClass
from ingest.simulator.scenario import Scenario


@dataclass(frozen=True, slots=True)
class WrongFile:
    """What is on file or measured over what is true."""

    masses: float = 1.0  # masses, inertias and load on file
    load: float = 1.0  # load and the mass of the body on file, beside
    yaw: float = 1.0  # scale of the yaw sensors
    lateral: float = 1.0  # scale of the lateral sensors, on axle boxes and frame
    survey_exact: bool = False  # the track as it is in place of its survey


OF = "low"  # the row whose fleet they have
WRONG = {
    "masses_large": WrongFile(masses=1.2),
    "masses_small": WrongFile(masses=0.8),
    "yaw_large": WrongFile(yaw=1.05),
    "yaw_small": WrongFile(yaw=0.95),
    "lateral_large": WrongFile(lateral=1.05),
    "lateral_small": WrongFile(lateral=0.95),
    "survey_exact": WrongFile(survey_exact=True),  # what the error of the survey costs: none of its own is left
}
ONE = {f"one_{name}": WRONG[name] for name in ("masses_large", "masses_small", "yaw_large", "yaw_small")} | {
    "one_load_small": WrongFile(load=0.4)  # a full wagon with the load of an empty one on file
}


def as_on_file(fleet: Fleet, wrong: WrongFile) -> Fleet:
    """Return a fleet as one sees it whose file and sensors are wrong; the truth of its windows stays."""
    windows = tuple(replace(one, window=_scaled(one, wrong)) for one in fleet.windows)
    alignment = _exact(fleet) if wrong.survey_exact else fleet.alignment
    return replace(fleet, vehicle_class=_on_file(fleet.vehicle_class, wrong), windows=windows, alignment=alignment)


def first_vehicle(fleet: Fleet) -> Fleet:
    """Return a fleet with the windows of its first vehicle alone."""
    first = fleet.scenario.vehicles[0].code
    return replace(fleet, windows=tuple(one for one in fleet.windows if one.window.vehicle == first))


def with_others(own: StoredPasses, right: StoredPasses) -> StoredPasses:
    """Return the passes of a vehicle that is wrong together with those of the others, which are right."""
    wrong = {one.vehicle for one in own.passes}
    return replace(right, passes=own.passes + tuple(one for one in right.passes if one.vehicle not in wrong))


def _exact(fleet: Fleet) -> TrackAlignment:
    s = fleet.alignment.s
    return replace(fleet.alignment, alignment=np.interp(s, fleet.track.s, fleet.track.alignment))


def _scaled(one: SensedWindow, wrong: WrongFile) -> Window:
    window, turned = one.window, one.window.frame_yaw_acceleration
    return replace(
        window,
        lateral_acceleration=wrong.lateral * window.lateral_acceleration,
        yaw_acceleration=wrong.yaw * window.yaw_acceleration,
        mass_lateral_acceleration=wrong.lateral * window.mass_lateral_acceleration,
        frame_yaw_acceleration=None if turned is None else wrong.lateral * turned,
    )


def _on_file(vehicle_class: VehicleClass, wrong: WrongFile) -> VehicleClass:
    p, bogie, body = vehicle_class.parameters, vehicle_class.bogie, wrong.masses * wrong.load
    parameters = replace(
        p,
        wheelset_mass=wrong.masses * p.wheelset_mass,
        suspended_mass=body * p.suspended_mass,
        yaw_inertia=wrong.masses * p.yaw_inertia,
        pitch_inertia=wrong.masses * p.pitch_inertia,
        load=body * p.load,
    )
    return replace(vehicle_class, parameters=parameters, bogie=None if bogie is None else _bogie_on_file(bogie, wrong))


def _bogie_on_file(bogie: BogieParameters, wrong: WrongFile) -> BogieParameters:
    return replace(
        bogie,
        frame_mass=wrong.masses * bogie.frame_mass,
        frame_yaw_inertia=wrong.masses * bogie.frame_yaw_inertia,
        body_mass=wrong.masses * wrong.load * bogie.body_mass,
    )


QUIET_OF = "quiet"  # the scenario that the quiet rows change


@dataclass(frozen=True, slots=True)
class QuietRow:
    """What a row changes of the scenario, by table, and what is wrong on file."""

    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    wrong: WrongFile = field(default_factory=WrongFile)
    gravity_on_file: bool = True  # whether the class says that its accelerometers measure gravity


LEAVES: dict[str, Any] = {
    "stretches": [
        {"from_m": 900.0, "to_m": 1200.0, "friction": 0.08},
        {"from_m": 2400.0, "to_m": 2600.0, "friction": 0.06},
    ]
}
GENTLE = [
    {"start_m": 600.0, "length_m": 700.0, "radius_m": 6000.0, "cant_mm": 20.0},
    {"start_m": 2000.0, "length_m": 800.0, "radius_m": -5000.0, "cant_mm": -25.0},
]
ALONE: dict[str, dict[str, Any]] = {"drawn_fleet": {"vehicles": 1}}
S1002 = {
    "name": "S1002/60E1",
    "wheel_profile": "S1002",
    "rail_profile": "60E1",
    "rail_inclination_1_in": 40.0,
    "deepest_wear_mm": 1.0,
}
QUIET = {
    QUIET_OF: QuietRow(),
    "quiet_alone": QuietRow(ALONE),
    "quiet_wet": QuietRow({"creep": {"friction": 0.2}}),
    "quiet_wet_alone": QuietRow({"creep": {"friction": 0.2}} | ALONE),
    "quiet_smooth": QuietRow({"section": {"alignment_std_mm": 1.0}}),
    "quiet_survey": QuietRow({"section": {"survey_alignment_std_mm": 0.5}}),
    "quiet_gauge": QuietRow({"section": {"gauge_std_mm": 1.5, "gauge_surveyed": False}}),
    "quiet_level": QuietRow({"section": {"cross_level": {"std_mm": 5.0}}}),
    "quiet_twist": QuietRow({"section": {"cross_level": {"std_mm": 8.0, "shortest_wavelength_m": 30.0}}}),
    "quiet_curves": QuietRow({"section": {"curves": GENTLE}}),
    "quiet_load": QuietRow(wrong=WrongFile(load=1.12)),
    "quiet_scales": QuietRow({"sensors": {"scale_error_std_percent": 3.0}}),
    "quiet_gravity": QuietRow(gravity_on_file=False),
    "quiet_fast": QuietRow({"speed": {"lowest_m_s": 30.0, "highest_m_s": 40.0}, "section": {"length_m": 10500.0}}),
    "quiet_s1002": QuietRow({"drawn_fleet": {"pairs": [S1002]}}),
    "quiet_leaves": QuietRow({"creep": LEAVES}),
    "quiet_leaves_alone": QuietRow({"creep": LEAVES} | ALONE),
}


def quiet_scenario(folder: Path, row: QuietRow) -> Scenario:
    """Return the scenario of a row; the folder has the file of that which rows change."""
    return changed_scenario(folder / f"{QUIET_OF}.toml", row.tables)


def as_seen(fleet: Fleet, row: QuietRow) -> Fleet:
    """Return a fleet as one sees it whose file is that of a row; the truth of its windows stays."""
    seen = as_on_file(fleet, row.wrong)
    if row.gravity_on_file:
        return seen
    windows = tuple(replace(one, window=replace(one.window, measures_gravity=False)) for one in seen.windows)
    return replace(seen, windows=windows)
