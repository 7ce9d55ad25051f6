"""A vehicle class: what all vehicles of one type have in common, each parameter with what is not known of it.

The equations of motion of ``equations_of_motion`` are those of one wheelset and what its suspension carries. In a
bogie two wheelsets share a frame; its yaw follows from what the nodes measure on it above their axles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Annotated

from annotated_types import Ge, Gt, Interval

from estimation.errors import ParameterError
from estimation.vehicle.equations_of_motion import VehicleParameters

AXLES_OF_A_BOGIE = 2


class Arrangement(StrEnum):
    """What the yaw spring of a wheelset is tied to."""

    SINGLE_WHEELSET = "single_wheelset"  # a body that does not yaw, as in the paper
    BOGIE = "bogie"  # the frame that it shares with one more wheelset


@dataclass(frozen=True, slots=True)
class BogieParameters:
    """A bogie frame, what it carries, and its suspension to the body.

    Raises:
        ParameterError: A parameter is not finite, is negative, or is zero where it must not be.
    """

    wheelbase: Annotated[float, Interval(ge=0.5, le=10.0)]  # m, between its two axles
    frame_mass: Annotated[float, Gt(0.0)]  # kg
    frame_yaw_inertia: Annotated[float, Gt(0.0)]  # kg m2
    body_mass: Annotated[float, Gt(0.0)]  # kg, of the body that rests on one bogie
    secondary_lateral_stiffness: Annotated[float, Ge(0.0)] = 0.0  # N/m, of one bogie
    secondary_lateral_damping: Annotated[float, Ge(0.0)] = 0.0  # N s/m
    secondary_yaw_stiffness: Annotated[float, Ge(0.0)] = 0.0  # N m/rad
    secondary_yaw_damping: Annotated[float, Ge(0.0)] = 0.0  # N m s/rad

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            least_is_zero = item.name.startswith("secondary")
            if not math.isfinite(value) or value < 0.0 or (value == 0.0 and not least_is_zero):
                raise ParameterError(f"{value!r} is not a possible value", field=item.name)


@dataclass(frozen=True, slots=True)
class SensorChannel:
    """One signal of a node, in its SI unit u (m/s2, rad/s2; of a gyroscope rad/s)."""

    noise_density: float = 0.0  # u per root hertz, one-sided
    scale_std: float = 0.0  # relative std of its scale
    limit: float = math.inf  # u, largest magnitude that it measures

    @property
    def usual_scale_std(self) -> float:
        """Relative std of its scale; where none is on file, that of a sensor that nobody calibrated."""
        return self.scale_std or UNSTATED_SCALE_STD


@dataclass(frozen=True, slots=True)
class SensorLayout:
    """The sensors of a node. The wheelset's own are on an axle box, at the height of the axle.

    ``measures_gravity`` says that the lateral accelerometers measure specific force, as every real one does: of a node
    that rolls by phi they give y'' + g phi. The mass sensor is on the suspended mass above the axle: in a bogie on
    its frame.
    """

    lateral: SensorChannel = field(default_factory=SensorChannel)
    yaw: SensorChannel = field(default_factory=SensorChannel)
    roll: SensorChannel = field(default_factory=SensorChannel)
    mass_lateral: SensorChannel = field(default_factory=SensorChannel)
    yaw_is_gyroscope: bool = False
    roll_is_gyroscope: bool = False
    measures_gravity: bool = True
    rate_hz: float = 250.0

    @property
    def channels(self) -> Mapping[str, SensorChannel]:
        """Channels under their names."""
        return {
            "lateral": self.lateral,
            "yaw": self.yaw,
            "roll": self.roll,
            "mass_lateral": self.mass_lateral,
        }


@dataclass(frozen=True, slots=True)
class VehicleClass:
    """Parameters of all vehicles of one type.

    ``parameters`` are those of one wheelset: in a bogie its stiffness and damping are those of the primary
    suspension of one wheelset, its suspended mass is what one wheelset carries laterally, and its load the axle load.
    ``relative_std`` holds for fields of ``parameters`` or ``bogie`` how well each is known; a field that is
    missing has the default of its kind (``default_relative_std``).

    Raises:
        ParameterError: A bogie without its parameters, or the reverse; a standard deviation of an unknown field, or an
            impossible one.
    """

    code: str
    name: str
    source: str  # where the numbers come from
    arrangement: Arrangement
    parameters: VehicleParameters
    bogie: BogieParameters | None = None
    sensors: SensorLayout = field(default_factory=SensorLayout)
    relative_std: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if (self.arrangement is Arrangement.BOGIE) != (self.bogie is not None):
            raise ParameterError("parameters of a bogie are needed for bogies, and only for them", field="bogie")
        known = {item.name for item in fields(VehicleParameters)} | {item.name for item in fields(BogieParameters)}
        for name, std in self.relative_std.items():
            if name not in known:
                raise ParameterError(f"no parameter is called {name!r}", field="relative_std")
            if not (math.isfinite(std) and std >= 0.0):
                raise ParameterError(f"{std!r} is not a possible standard deviation", field=f"relative_std.{name}")

    def std_of(self, name: str) -> float:
        """Return the relative standard deviation of a parameter by the name of its field."""
        return self.relative_std.get(name, default_relative_std(name))

    def partner(self, axle: int) -> int | None:
        """Return the other axle in the bogie of ``axle`` (1, 2, ...); None where there is no bogie."""
        if self.bogie is None:
            return None
        return axle + 1 if axle % AXLES_OF_A_BOGIE else axle - 1


CREEP_STD, STIFFNESS_STD, DAMPING_STD, MASS_STD, LENGTH_STD = 0.10, 0.05, 0.10, 0.025, 0.002
LOAD_STD = 0.12  # an axle carries 11 t empty and 17 t full, with the passengers that no file has: anything between
UNSTATED_SCALE_STD = 0.03  # of a sensor whose scale has no std on file


def default_relative_std(name: str) -> float:
    """Return the relative standard deviation of a parameter of which none is on file.

    Args:
        name: Of a field of :class:`VehicleParameters` or :class:`BogieParameters`.
    """
    ends = {
        "_coefficient": CREEP_STD,
        "_stiffness": STIFFNESS_STD,
        "_damping": DAMPING_STD,
        "_mass": MASS_STD,
        "_inertia": MASS_STD,
        "load": LOAD_STD,
    }
    return next((std for end, std in ends.items() if name.endswith(end)), LENGTH_STD)
