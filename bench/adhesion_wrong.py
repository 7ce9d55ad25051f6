"""Rows of the adhesion bench whose vehicles are not as their class has them: masses and load, scales of sensors.

A seed of the row ``low`` is simulated once; its windows are estimated again with each error. In the rows ``one_...``
the first vehicle alone has the error: the passes of the others are those of the row ``low``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from bench.adhesion_stored import StoredPasses
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import BogieParameters, VehicleClass

if TYPE_CHECKING:  # it loads compiled code
    from bench.adhesion_fleet import Fleet, SensedWindow


@dataclass(frozen=True, slots=True)
class WrongFile:
    """What is on file or measured over what is true."""

    masses: float = 1.0  # masses, inertias and load on file
    spring: float = 1.0  # yaw spring on file
    yaw: float = 1.0  # scale of the yaw sensors
    lateral: float = 1.0  # scale of the lateral sensors, on axle boxes and frame


OF = "low"  # the row whose fleet they have
WRONG = {
    "masses_large": WrongFile(masses=1.2),
    "masses_small": WrongFile(masses=0.8),
    "yaw_large": WrongFile(yaw=1.05),
    "yaw_small": WrongFile(yaw=0.95),
    "lateral_large": WrongFile(lateral=1.05),
    "lateral_small": WrongFile(lateral=0.95),
}
ONE = {f"one_{name}": WRONG[name] for name in ("masses_large", "masses_small", "yaw_large", "yaw_small")} | {
    "one_spring_small": WrongFile(spring=0.5)
}


def as_on_file(fleet: Fleet, wrong: WrongFile) -> Fleet:
    """Return a fleet as one sees it whose file and sensors are wrong; the truth of its windows stays."""
    windows = tuple(replace(one, window=_scaled(one, wrong)) for one in fleet.windows)
    return replace(fleet, vehicle_class=_on_file(fleet.vehicle_class, wrong), windows=windows)


def first_vehicle(fleet: Fleet) -> Fleet:
    """Return a fleet with the windows of its first vehicle alone."""
    first = fleet.scenario.vehicles[0].code
    return replace(fleet, windows=tuple(one for one in fleet.windows if one.window.vehicle == first))


def with_others(own: StoredPasses, right: StoredPasses) -> StoredPasses:
    """Return the passes of a vehicle that is wrong together with those of the others, which are right."""
    wrong = {one.vehicle for one in own.passes}
    return replace(right, passes=own.passes + tuple(one for one in right.passes if one.vehicle not in wrong))


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
    p, bogie, factor = vehicle_class.parameters, vehicle_class.bogie, wrong.masses
    parameters = replace(
        p,
        wheelset_mass=factor * p.wheelset_mass,
        suspended_mass=factor * p.suspended_mass,
        yaw_inertia=factor * p.yaw_inertia,
        pitch_inertia=factor * p.pitch_inertia,
        load=factor * p.load,
        yaw_stiffness=wrong.spring * p.yaw_stiffness,
    )
    return replace(vehicle_class, parameters=parameters, bogie=None if bogie is None else _heavier_bogie(bogie, factor))


def _heavier_bogie(bogie: BogieParameters, factor: float) -> BogieParameters:
    return replace(
        bogie,
        frame_mass=factor * bogie.frame_mass,
        frame_yaw_inertia=factor * bogie.frame_yaw_inertia,
        body_mass=factor * bogie.body_mass,
    )
