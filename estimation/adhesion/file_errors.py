"""What file and sensors leave open of the friction, alike for all vehicles and places: no acceleration shows it.

Creep coefficient, yaw spring and load on file scale 1/mu. The scale of a sensor adds to it: yaw and lateral motion that
do not belong together look like creep that grows with the force, at every friction alike. It does what an error of the
linear creep does that is left when the passes have been put together, and is given as such: in parts of b, as measured
with sensors that are 5 % too large or too small (``python -m bench adhesion --rows wrong_file``).
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Self

from estimation.vehicle.vehicle_class import (
    CREEP_STD,
    LOAD_STD,
    STIFFNESS_STD,
    UNSTATED_SCALE_STD,
    SensorLayout,
    VehicleClass,
)

YAW_AS_CREEP = 0.55  # b that a scale of the yaw sensors leaves, over its error
LATERAL_AS_CREEP = 0.35  # the same of the lateral sensors


@dataclass(frozen=True, slots=True)
class FileErrors:
    """Relative stds of what all vehicles of a class have in common."""

    creep: float = CREEP_STD  # coefficient
    spring: float = STIFFNESS_STD  # in yaw
    load: float = LOAD_STD
    yaw_scale: float = UNSTATED_SCALE_STD  # of the yaw sensors
    lateral_scale: float = UNSTATED_SCALE_STD  # of the lateral sensors

    @classmethod
    def of(cls, classes: Collection[VehicleClass]) -> Self:
        """Return the largest std that any of some classes has; the defaults where there is none."""
        if not classes:
            return cls()
        return cls(
            max(one.std_of("longitudinal_creep_coefficient") for one in classes),
            max(one.std_of("yaw_stiffness") for one in classes),
            max(one.std_of("load") for one in classes),
            max(one.sensors.yaw.usual_scale_std for one in classes),
            max(lateral_scale_std(one.sensors) for one in classes),
        )

    @property
    def factor_std(self) -> float:
        """Relative std of 1/mu of all places."""
        return math.hypot(self.creep, self.spring, self.load)

    @property
    def creep_std(self) -> float:
        """Std of what the scales of the sensors leave, as a b of all vehicles."""
        return math.hypot(YAW_AS_CREEP * self.yaw_scale, LATERAL_AS_CREEP * self.lateral_scale)


@dataclass(frozen=True, slots=True)
class ForceErrors:
    """Relative stds that file and sensors leave to the forces of a window."""

    lateral: float  # of forces across the track: masses, springs and lateral sensors
    moment: float  # of the moment in yaw: yaw spring and yaw sensor
    load: float  # of what gravity is, and what is over the normal force

    @classmethod
    def of(cls, vehicle_class: VehicleClass) -> Self:
        """Return what is not known of the vehicles of a class."""
        std_of, sensors = vehicle_class.std_of, vehicle_class.sensors
        return cls(
            math.hypot(std_of("wheelset_mass"), std_of("lateral_stiffness"), lateral_scale_std(sensors)),
            math.hypot(std_of("yaw_stiffness"), sensors.yaw.usual_scale_std),
            std_of("load"),
        )


def lateral_scale_std(sensors: SensorLayout) -> float:
    """Return the relative std of the scale of the lateral sensors: the larger one of axle boxes and what is above."""
    return max(sensors.lateral.usual_scale_std, sensors.mass_lateral.usual_scale_std)
