"""Rows of the adhesion bench whose vehicles are not as their class has them: masses and load, scales of sensors.

A seed of the row ``low`` is simulated once; its windows are estimated again with each error. In the rows ``one_...``
the first vehicle alone has the error: its passes are those of the row of that name, the others' those without any.
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
ONE = {f"one_{name}": name for name in ("masses_large", "masses_small", "yaw_large", "yaw_small")}


def as_on_file(fleet: Fleet, wrong: WrongFile) -> Fleet:
    """Return a fleet as one sees it whose file and sensors are wrong; the truth of its windows stays."""
    windows = tuple(replace(one, window=_scaled(one, wrong)) for one in fleet.windows)
    return replace(fleet, vehicle_class=_heavier(fleet.vehicle_class, wrong.masses), windows=windows)


def of_one_vehicle(right: StoredPasses, wrong: StoredPasses) -> StoredPasses:
    """Return the passes of a fleet whose first vehicle alone is wrong."""
    first = min(one.vehicle for one in right.passes)
    own = tuple(one for one in wrong.passes if one.vehicle == first)
    return replace(right, passes=own + tuple(one for one in right.passes if one.vehicle != first))


def _scaled(one: SensedWindow, wrong: WrongFile) -> Window:
    window, turned = one.window, one.window.frame_yaw_acceleration
    return replace(
        window,
        lateral_acceleration=wrong.lateral * window.lateral_acceleration,
        yaw_acceleration=wrong.yaw * window.yaw_acceleration,
        mass_lateral_acceleration=wrong.lateral * window.mass_lateral_acceleration,
        frame_yaw_acceleration=None if turned is None else wrong.lateral * turned,
    )


def _heavier(vehicle_class: VehicleClass, factor: float) -> VehicleClass:
    p, bogie = vehicle_class.parameters, vehicle_class.bogie
    parameters = replace(
        p,
        wheelset_mass=factor * p.wheelset_mass,
        suspended_mass=factor * p.suspended_mass,
        yaw_inertia=factor * p.yaw_inertia,
        pitch_inertia=factor * p.pitch_inertia,
        load=factor * p.load,
    )
    return replace(vehicle_class, parameters=parameters, bogie=None if bogie is None else _heavier_bogie(bogie, factor))


def _heavier_bogie(bogie: BogieParameters, factor: float) -> BogieParameters:
    return replace(
        bogie,
        frame_mass=factor * bogie.frame_mass,
        frame_yaw_inertia=factor * bogie.frame_yaw_inertia,
        body_mass=factor * bogie.body_mass,
    )
