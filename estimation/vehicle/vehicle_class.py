"""A vehicle class: what all vehicles of one type have in common, each parameter with what is not known of it.

The equations of motion of ``regressors`` are those of one wheelset and what its suspension carries. In a
bogie two wheelsets share a frame; its yaw follows from what the nodes measure on it above their axles.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from enum import StrEnum
from typing import Annotated, Any, cast

import numpy as np
from annotated_types import Ge, Gt, Interval

from estimation.errors import ParameterError
from estimation.values.arrays import FloatArray
from estimation.values.units import GRAVITY
from estimation.vehicle.parameters import VEHICLE

AXLES_OF_A_BOGIE = 2


class Arrangement(StrEnum):
    """What the yaw spring of a wheelset is tied to."""

    SINGLE_WHEELSET = "single_wheelset"  # a body that does not yaw, as in the paper
    BOGIE = "bogie"  # the frame that it shares with one more wheelset


@dataclass(frozen=True, slots=True)
class BogieParameters:
    """A bogie frame, what it carries, and its suspension to the body."""

    wheelbase: Annotated[float, Interval(ge=0.5, le=10.0)]  # m, between its two axles
    frame_mass: Annotated[float, Gt(0.0)]  # kg
    frame_yaw_inertia: Annotated[float, Gt(0.0)]  # kg m2
    body_mass: Annotated[float, Gt(0.0)]  # kg, of the body that rests on one bogie
    secondary_lateral_stiffness: Annotated[float, Ge(0.0)] = 0.0  # N/m, of one bogie
    secondary_lateral_damping: Annotated[float, Ge(0.0)] = 0.0  # N s/m
    secondary_yaw_stiffness: Annotated[float, Ge(0.0)] = 0.0  # N m/rad
    secondary_yaw_damping: Annotated[float, Ge(0.0)] = 0.0  # N m s/rad

    def __post_init__(self) -> None:
        check_possible(self, ("secondary",))


@dataclass(frozen=True, slots=True)
class SensorChannel:
    """One signal of a node, in its SI unit u (m/s2, rad/s2; of a gyroscope rad/s)."""

    noise_density: float = 0.0  # u per root hertz, one-sided
    scale_std: float = 0.0  # relative std of its scale
    limit: float = math.inf  # u, largest magnitude that it measures

    @property
    def usual_scale_std(self) -> float:
        """Relative std of its scale; where none is on file, that of a sensor that nobody calibrated."""
        return self.scale_std or VEHICLE.unstated_scale_std


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
        return {"lateral": self.lateral, "yaw": self.yaw, "roll": self.roll, "mass_lateral": self.mass_lateral}


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


def default_relative_std(name: str) -> float:
    """Return the relative standard deviation of a parameter of which none is on file."""
    ends = {
        "_coefficient": VEHICLE.creep_std,
        "_stiffness": VEHICLE.stiffness_std,
        "_damping": VEHICLE.damping_std,
        "_mass": VEHICLE.mass_std,
        "_inertia": VEHICLE.mass_std,
        "load": VEHICLE.load_std,
    }
    return next((std for end, std in ends.items() if name.endswith(end)), VEHICLE.length_std)


SHIPPED_VERSION = 0  # of a class that the package holds and the registry does not
_CHANNELS = ("lateral", "yaw", "roll", "mass_lateral")


@dataclass(frozen=True, slots=True)
class ClassOnFile:
    """A version of a vehicle class."""

    vehicle_class: VehicleClass  # its value
    version: int = SHIPPED_VERSION  # from 1, as registered; ``SHIPPED_VERSION`` for a class of the package
    recorded_ns: int | None = None  # when this version was registered, ns UTC; None for a class of the package

    @property
    def digest(self) -> str:
        """Digest of the whole value."""
        return class_digest(self.vehicle_class)


def class_document(vehicle_class: VehicleClass) -> dict[str, Any]:
    """Return a class as JSON can hold it: a limit that is infinite is None."""
    document = asdict(vehicle_class)
    document["relative_std"] = dict(sorted(vehicle_class.relative_std.items()))
    for name in _CHANNELS:
        if math.isinf(document["sensors"][name]["limit"]):
            document["sensors"][name]["limit"] = None
    return document


def class_of_document(document: Mapping[str, Any]) -> VehicleClass:
    """Return the class that :func:`class_document` described; a TypeError where it has other fields."""
    bogie, sensors = document["bogie"], dict(document["sensors"])
    for name in _CHANNELS:
        limit = sensors[name]["limit"]
        sensors[name] = SensorChannel(**{**sensors[name], "limit": math.inf if limit is None else limit})
    return VehicleClass(
        **{
            **document,
            "arrangement": Arrangement(document["arrangement"]),
            "parameters": VehicleParameters(**document["parameters"]),
            "bogie": None if bogie is None else BogieParameters(**bogie),
            "sensors": SensorLayout(**sensors),
        }
    )


def same_motion(first: VehicleClass, second: VehicleClass) -> bool:
    """Return whether two classes turn a window into the same motion; their standard deviations may differ."""
    return all(
        getattr(first, name) == getattr(second, name) for name in ("arrangement", "parameters", "bogie", "sensors")
    )


def class_digest(vehicle_class: VehicleClass) -> str:
    """Return the digest of the whole value of a class."""
    text = json.dumps(class_document(vehicle_class), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def difference_noise(vehicle_class: VehicleClass, cutoff_wavelength: float) -> float:
    """Return the variance of rL - rR by the noise of the sensors, times the cube of the speed, m2 (m/s)3."""
    # The moment of the yaw spring takes nearly all of it: white noise of an acceleration, of density n, integrated
    # twice and without what is slower than f_c = V / L, L the cut-off, has the variance n^2 / (3 (2 pi)^4 f_c^3); that
    # of a gyroscope, integrated once, n^2 / ((2 pi)^2 f_c), which is taken at 20 m/s. In a bogie the two sensors of the
    # frame add theirs.
    p, sensors = vehicle_class.parameters, vehicle_class.sensors
    per_yaw = p.yaw_stiffness * p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient)
    twice = cutoff_wavelength**3 / (3.0 * (2.0 * math.pi) ** 4)
    once = cutoff_wavelength * VEHICLE.usual_speed**2 / (2.0 * math.pi) ** 2
    variance = (once if sensors.yaw_is_gyroscope else twice) * sensors.yaw.noise_density**2
    if vehicle_class.bogie is not None:
        variance += 2.0 * twice * (sensors.mass_lateral.noise_density / vehicle_class.bogie.wheelbase) ** 2
    return per_yaw**2 * variance


def usable_cutoff(vehicle_class: VehicleClass, longest: float) -> float:
    """Return the longest cut-off wavelength, m, at which the noise of the sensors leaves something of rL - rR.

    A stiff yaw spring turns the slow noise of the yaw sensor into rolling radius difference. Where that is large,
    longer waves hold noise alone. Waves shorter than ``shortest_cutoff`` would not hold the displacement.
    """
    cutoff = longest
    while cutoff - VEHICLE.cutoff_step >= VEHICLE.shortest_cutoff:
        if math.sqrt(difference_noise(vehicle_class, cutoff) / VEHICLE.usual_speed**3) <= VEHICLE.most_difference_noise:
            break
        cutoff -= VEHICLE.cutoff_step
    return cutoff


def displacement_noise(vehicle_class: VehicleClass, cutoff_wavelength: float, speed: FloatArray) -> FloatArray:
    """Return the variance (n,) of the lateral displacement by the noise of the sensors, m2, at speeds (n,), m/s."""
    # Of white noise of an acceleration, integrated twice, and of the roll, which is taken off at the height of the
    # axle. Where gravity is taken out, g times the roll is integrated twice once more, which adds to the same error. A
    # slow vehicle takes longer over a wave: twice integrated, the variance grows with the third power of its period,
    # and that of g times the roll with the seventh.
    slowest = speed / cutoff_wavelength
    sensors, height = vehicle_class.sensors, vehicle_class.parameters.nominal_radius
    gravity = GRAVITY if sensors.measures_gravity else 0.0
    if not sensors.measures_gravity:
        height += VEHICLE.rail_head_radius
    of_roll = 1 if sensors.roll_is_gyroscope else 2
    crossed = 2.0 * gravity * height * _integrated(of_roll + 1, slowest)
    both = height**2 * _integrated(of_roll, slowest) + crossed + gravity**2 * _integrated(of_roll + 2, slowest)
    return sensors.lateral.noise_density**2 * _integrated(2, slowest) + sensors.roll.noise_density**2 * both


def _integrated(times: int, slowest: FloatArray) -> FloatArray:
    """Return the variance (n,) of white noise of density one, integrated so often, of frequencies from ``slowest``."""
    order = 2 * times
    return np.asarray(1.0 / ((order - 1) * (2.0 * math.pi) ** order * slowest ** (order - 1)))


def check_possible(parameters: object, may_be_zero: tuple[str, ...]) -> None:
    """Check that parameters are finite and positive; those whose names begin so may be zero."""
    for item in fields(cast("Any", parameters)):
        value = getattr(parameters, item.name)
        if not math.isfinite(value) or value < 0.0 or (value == 0.0 and not item.name.startswith(may_be_zero)):
            raise ParameterError(f"{value!r} is not a possible value", field=item.name)


@dataclass(frozen=True, slots=True)
class VehicleParameters:
    """Parameters of the wheelset and its suspended mass; the defaults are Table A.1 of the paper.

    Creep coefficients are Kalker's linear ones for one wheel. In the equations: f11 longitudinal, f22 lateral,
    f23 lateral/spin, f33 spin creep; fy, ky lateral damper and spring between wheelset and mass; f_psi, k_psi yaw
    damper and spring; I yaw and Iwy pitch (spin) inertia of the wheelset; l half the distance between the contact
    points; m wheelset mass, mm suspended mass; W load; r0 nominal rolling radius.

    W acts through the contact angles and the roll. The paper's is the wheelset's own weight, m g. What stands on the
    rails is the ``axle_load`` of wheelset and suspended mass; with it f23/r0 - W/2, the factor of dL - dR, is negative.

    Raises:
        ParameterError: A parameter is not finite, or is not positive where it must be.
    """

    longitudinal_creep_coefficient: Annotated[float, Ge(0.0)] = 7.44e6  # f11, N
    lateral_creep_coefficient: Annotated[float, Ge(0.0)] = 6.79e6  # f22, N
    lateral_spin_creep_coefficient: Annotated[float, Ge(0.0)] = 13.7e3  # f23, N m
    spin_creep_coefficient: Annotated[float, Ge(0.0)] = 0.0  # f33, N m2
    lateral_damping: Annotated[float, Ge(0.0)] = 50e3  # fy, N s/m
    yaw_damping: Annotated[float, Ge(0.0)] = 0.0  # f_psi, N m s
    yaw_inertia: Annotated[float, Ge(0.0)] = 700.0  # I, kg m2
    pitch_inertia: Annotated[float, Ge(0.0)] = 200.0  # Iwy, kg m2
    half_contact_distance: Annotated[float, Ge(0.0)] = 0.7452  # l, m
    wheelset_mass: Annotated[float, Ge(0.0)] = 1250.0  # m, kg
    suspended_mass: Annotated[float, Ge(0.0)] = 8000.0  # mm, kg
    lateral_stiffness: Annotated[float, Ge(0.0)] = 0.23e6  # ky, N/m
    yaw_stiffness: Annotated[float, Ge(0.0)] = 2.5e6  # k_psi, N m
    load: Annotated[float, Ge(0.0)] = 12263.0  # W, N
    nominal_radius: Annotated[float, Ge(0.0)] = 0.45  # r0, m

    def __post_init__(self) -> None:
        check_possible(self, ("spin_creep", "lateral_spin_creep", "yaw_damping", "lateral_damping"))

    @property
    def axle_load(self) -> float:
        """Weight of the wheelset and its suspended mass, (m + mm) g, N."""
        return (self.wheelset_mass + self.suspended_mass) * GRAVITY
