"""Rows of the adhesion bench whose file is another one: masses and load of the class, scales of sensors, the survey.

A seed of the row ``low`` is simulated once; its windows are estimated again with each error. In the rows ``one_...``
the first vehicle alone has the error: the passes of the others are those of the row ``low``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bench.adhesion_stored import StoredPasses
from estimation.values.track import TrackAlignment
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import BogieParameters, VehicleClass

if TYPE_CHECKING:  # it loads compiled code
    from bench.adhesion_fleet import Fleet, SensedWindow


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
