"""When friction is published, and what file and sensors leave open of it, alike for all vehicles and places.

Creep coefficient, yaw spring and load on file scale 1/mu. The scale of a sensor adds to it: yaw and lateral motion that
do not belong together look like creep that grows with the force, at every friction alike. It does what an error of the
linear creep does that is left when the passes have been put together, and is given as such: in parts of b, as measured
with sensors that are 5 % too large or too small (``python -m bench adhesion --rows wrong_file``).
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
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


def lateral_scale_std(sensors: SensorLayout) -> float:
    """Return the relative std of the scale of the lateral sensors: the larger one of axle boxes and what is above."""
    return max(sensors.lateral.usual_scale_std, sensors.mass_lateral.usual_scale_std)


def force_errors(vehicle_class: VehicleClass) -> tuple[float, float, float]:
    """Return the relative stds that file and sensors leave to forces across the track, the moment in yaw, and load."""
    std_of, sensors = vehicle_class.std_of, vehicle_class.sensors
    return (
        math.hypot(std_of("wheelset_mass"), std_of("lateral_stiffness"), lateral_scale_std(sensors)),
        math.hypot(std_of("yaw_stiffness"), sensors.yaw.usual_scale_std),
        std_of("load"),
    )


@dataclass(frozen=True, slots=True)
class FrictionParameters:
    """When friction is published, and when it is low."""

    low: float = 0.15  # limit of low adhesion
    likely: float = 0.45  # probability of a friction below the limit from which a place has low adhesion
    at_ends: float = 0.3  # the same of the places around it, to which its stretch reaches
    good: float = 0.4  # friction of good rails: an interval that holds it shows no low friction
    certain: float = 0.9  # that probability where a vehicle is alone, and from which samples are left out elsewhere
    beside_others: float = 0.7  # the same of a place that one vehicle met, where others have passed the section
    fewest_vehicles: int = 2  # that agree, where the probability is less
    fewest_passes: int = 3  # of wheelsets
    creep_error_std: float = 0.1  # of b, relative
    usual: float = 3.3  # 1/mu of rails that nothing is known of: a friction of 0.3
    usual_std: float = 3.0  # of it, at a place
    most_usual: float = 6.7  # 1/mu of a place that is usual yet
    level_std: float = 1.0  # of it, of the middle one of all places of a section
    law_std: float = 0.1  # of 1/mu, relative: creep laws differ
    file: FileErrors = field(default_factory=FileErrors)  # what file and sensors leave open of all vehicles alike
    track_std: float = 0.45  # of 1/mu of a place, at least: the error of the alignment is the same in all passes
    smoothed_std: float = 1.0  # the same of what forces have lost with the vibration of axle boxes
    change_std: float = 0.2  # of the logarithm of 1/mu from a place to the next
    fresh: float = 0.05  # share of places whose friction has nothing to do with that of the place before
    least_upper: float = 0.6  # an interval that reaches beyond says no more than a lower bound
    rounds: int = 12
