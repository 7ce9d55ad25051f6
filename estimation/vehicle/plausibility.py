"""Whether the parameters of a class can be those of a railway vehicle: a unit that is wrong by 1000 moves a mode.

Each parameter enters a frequency, a damping ratio or a ratio of its neighbours whose range over wagons, coaches,
multiple units and locomotives is narrower than a factor of 1000 (of frequencies, its root) is wide. A
mode is that of one coordinate with all others held, so that it depends on few parameters and can be named.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy import optimize, special

from estimation.errors import ParameterError
from estimation.values.units import GRAVITY, STEEL_POISSON_RATIO, STEEL_SHEAR_MODULUS
from estimation.vehicle.parameters import OF_GEAR
from estimation.vehicle.vehicle_class import BogieParameters, VehicleClass, VehicleParameters

UNIT_FACTOR = OF_GEAR.unit_factor
RAIL_CONDITION_STD = OF_GEAR.rail_condition_std


UNIT_FACTORS = UNIT_FACTOR, UNIT_FACTOR**2  # kN/mm for N/m, MN for N


@dataclass(frozen=True, slots=True)
class PlausibleRange:
    """A quantity of the vehicle, and the range that railway vehicles have; the fields that it follows from."""

    name: str
    unit: str
    value: float
    lowest: float
    highest: float
    fields: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """Whether the value is in the range."""
        return self.lowest <= self.value <= self.highest


def check_plausible(vehicle_class: VehicleClass) -> None:
    """Check that no quantity is outside its range.

    Raises:
        ParameterError: Names the mode or quantity, its value and range, and as field the parameter whose correction by
            a unit mends most.
    """
    failing = [item for item in plausible_ranges(vehicle_class) if not item.holds]
    if not failing:
        return
    field, factor = _suspect(vehicle_class, failing)
    named = next(item for item in failing if field in item.fields)
    hint = ""
    if factor is not None:
        size = "small" if factor > 1.0 else "large"
        hint = f"; {field} is {max(factor, 1.0 / factor):,.0f} times too {size}: is its unit right?"
    reason = (
        f"{named.name} would be {named.value:.3g} {named.unit}".rstrip()
        + f", railway vehicles have {named.lowest:g} to {named.highest:g}{hint}"
    )
    raise ParameterError(reason, field=field)


def plausible_ranges(vehicle_class: VehicleClass) -> tuple[PlausibleRange, ...]:
    """Return the quantities of a class with their ranges, modes first."""
    p, bogie = vehicle_class.parameters, vehicle_class.bogie
    of_bogie = () if bogie is None else tuple(_bogie_ratios(bogie))
    return (*_modes(p, bogie), *_damping(p, bogie), *of_bogie, *_wheelset_ratios(p), *_creep_ratios(p))


def _suspect(vehicle_class: VehicleClass, failing: list[PlausibleRange]) -> tuple[str, float | None]:
    best = len(failing)
    suspect: tuple[str, float | None] = failing[0].fields[0], None
    parameters = [field for item in failing for field in item.fields]
    for unit, field, inverse in itertools.product(UNIT_FACTORS, parameters, (False, True)):
        factor = 1.0 / unit if inverse else unit
        left = sum(not item.holds for item in plausible_ranges(_scaled(vehicle_class, field, factor)))
        if left < best:
            best, suspect = left, (field, factor)
    return suspect


def _scaled(vehicle_class: VehicleClass, field: str, factor: float) -> VehicleClass:
    if field in {item.name for item in fields(VehicleParameters)}:
        p = vehicle_class.parameters
        return replace(vehicle_class, parameters=replace(p, **{field: factor * getattr(p, field)}))
    bogie = vehicle_class.bogie
    assert bogie is not None
    return replace(vehicle_class, bogie=replace(bogie, **{field: factor * getattr(bogie, field)}))


def _mode(name: str, stiffness: float, inertia: float, ends: tuple[float, float], *names: str) -> PlausibleRange:
    frequency = math.sqrt(stiffness / inertia) / (2 * math.pi)
    return PlausibleRange(f"the mode {name!r}", "Hz", frequency, *ends, names)


def _modes(p: VehicleParameters, bogie: BogieParameters | None) -> Iterator[PlausibleRange]:
    on, lateral = "on its primary springs", ("lateral_stiffness", "wheelset_mass")
    yield _mode(f"wheelset lateral {on}", p.lateral_stiffness, p.wheelset_mass, (1.0, 30.0), *lateral)
    yield _mode(f"wheelset yaw {on}", p.yaw_stiffness, p.yaw_inertia, (2.5, 70.0), "yaw_stiffness", "yaw_inertia")
    if bogie is None:
        names: tuple[str, ...] = "suspended_mass", "lateral_stiffness"
        yield _mode("mass lateral on its springs", p.lateral_stiffness, p.suspended_mass, (0.2, 6.0), *names)
        return
    both, on = 2 * p.lateral_stiffness, "on the primary springs"
    yield _mode(f"frame lateral {on}", both, bogie.frame_mass, (2.0, 60.0), "frame_mass", "lateral_stiffness")
    torsion = 2 * p.yaw_stiffness + both * (bogie.wheelbase / 2) ** 2
    names = "frame_yaw_inertia", "yaw_stiffness", "lateral_stiffness", "wheelbase"
    yield _mode(f"frame yaw {on}", torsion, bogie.frame_yaw_inertia, (3.0, 90.0), *names)
    on = "on the secondary springs"
    stiffness, torsion = bogie.secondary_lateral_stiffness, bogie.secondary_yaw_stiffness
    if stiffness:
        names = "secondary_lateral_stiffness", "body_mass"
        yield _mode(f"body lateral {on}", stiffness, bogie.body_mass, (0.2, 6.0), *names)
    if torsion:
        names = "secondary_yaw_stiffness", "frame_yaw_inertia"
        yield _mode(f"frame yaw {on}", torsion, bogie.frame_yaw_inertia, (0.3, 9.0), *names)


def _damping(p: VehicleParameters, bogie: BogieParameters | None) -> Iterator[PlausibleRange]:
    on, ends = "on its primary springs", (0.003, 3.0)
    rows = [
        (f"wheelset lateral {on}", p.lateral_damping, p.lateral_stiffness, p.wheelset_mass, ends, "lateral_damping"),
        (f"wheelset yaw {on}", p.yaw_damping, p.yaw_stiffness, p.yaw_inertia, ends, "yaw_damping"),
    ]
    if bogie is not None:
        on = "on the secondary springs"
        lateral = bogie.secondary_lateral_damping, bogie.secondary_lateral_stiffness, bogie.body_mass
        yaw = bogie.secondary_yaw_damping, bogie.secondary_yaw_stiffness, bogie.frame_yaw_inertia
        rows.append((f"body lateral {on}", *lateral, (0.01, 5.0), "secondary_lateral_damping"))
        rows.append((f"frame yaw {on}", *yaw, (0.05, 60.0), "secondary_yaw_damping"))
    for mode, damping, stiffness, inertia, (lowest, highest), name in rows:
        if damping and stiffness:
            ratio = damping / (2 * math.sqrt(stiffness * inertia))
            yield PlausibleRange(f"the damping ratio of the mode {mode!r}", "", ratio, lowest, highest, (name,))


def _bogie_ratios(bogie: BogieParameters) -> Iterator[PlausibleRange]:
    yield PlausibleRange("the wheelbase", "m", bogie.wheelbase, 1.2, 5.0, ("wheelbase",))
    gyration = math.sqrt(bogie.frame_yaw_inertia / bogie.frame_mass)
    yield _gyration("frame", gyration, (0.4, 2.5), "frame_yaw_inertia", "frame_mass")
    ratio = bogie.body_mass / bogie.frame_mass
    yield PlausibleRange("body mass over frame mass", "", ratio, 1.5, 100.0, ("body_mass", "frame_mass"))


def _wheelset_ratios(p: VehicleParameters) -> Iterator[PlausibleRange]:
    yield PlausibleRange("the nominal radius", "m", p.nominal_radius, 0.15, 0.75, ("nominal_radius",))
    half = p.half_contact_distance
    yield PlausibleRange("half the distance of the contacts", "m", half, 0.25, 1.0, ("half_contact_distance",))
    gyration = math.sqrt(p.yaw_inertia / p.wheelset_mass)
    yield _gyration("wheelset", gyration, (0.3, 1.2), "yaw_inertia", "wheelset_mass")
    rolling = math.sqrt(p.pitch_inertia / p.wheelset_mass) / p.nominal_radius
    name = "the radius of gyration of the rolling wheelset over its radius"
    yield PlausibleRange(name, "", rolling, 0.2, 1.2, ("pitch_inertia", "wheelset_mass"))
    ratio = p.suspended_mass / p.wheelset_mass
    yield PlausibleRange("suspended mass over wheelset mass", "", ratio, 1.0, 50.0, ("suspended_mass", "wheelset_mass"))
    weight = (p.wheelset_mass + p.suspended_mass) * GRAVITY
    names = "load", "suspended_mass", "wheelset_mass"
    yield PlausibleRange("the axle load over the weight of the masses", "", p.load / weight, 0.13, 2.0, names)


def _creep_ratios(p: VehicleParameters) -> Iterator[PlausibleRange]:
    f11, f22 = p.longitudinal_creep_coefficient, p.lateral_creep_coefficient
    names = "longitudinal_creep_coefficient", "load"
    yield PlausibleRange("longitudinal creep coefficient over wheel load", "", 2 * f11 / p.load, 40.0, 1500.0, names)
    names = "lateral_creep_coefficient", "longitudinal_creep_coefficient"
    yield PlausibleRange("lateral over longitudinal creep coefficient", "", f22 / f11, 0.5, 1.5, names)
    if p.lateral_spin_creep_coefficient:
        length = p.lateral_spin_creep_coefficient / f22
        name = "lateral/spin over lateral creep coefficient"
        yield PlausibleRange(name, "m", length, 2e-4, 1e-2, ("lateral_spin_creep_coefficient",))
    if p.spin_creep_coefficient:
        length = math.sqrt(p.spin_creep_coefficient / f22)
        name = "the root of spin over lateral creep coefficient"
        yield PlausibleRange(name, "m", length, 3e-4, 9e-3, ("spin_creep_coefficient",))


def _gyration(body: str, value: float, ends: tuple[float, float], *names: str) -> PlausibleRange:
    return PlausibleRange(f"the radius of gyration of the {body} in yaw", "m", value, *ends, names)


_ROWS = np.array(  # semi-axis ratio a/b, C11, C22, C23, C33; Poisson's ratio 1/4
    [
        (0.1, 3.31, 2.52, 0.473, 8.28),
        (0.2, 3.37, 2.63, 0.603, 4.27),
        (0.3, 3.44, 2.75, 0.715, 2.96),
        (0.4, 3.53, 2.88, 0.823, 2.32),
        (0.5, 3.62, 3.01, 0.929, 1.93),
        (0.6, 3.72, 3.14, 1.03, 1.68),
        (0.7, 3.81, 3.28, 1.14, 1.50),
        (0.8, 3.91, 3.41, 1.25, 1.37),
        (0.9, 4.01, 3.54, 1.36, 1.27),
        (1.0, 4.12, 3.67, 1.47, 1.19),
        (1 / 0.9, 4.22, 3.81, 1.59, 1.11),
        (1 / 0.8, 4.36, 3.99, 1.75, 1.04),
        (1 / 0.7, 4.54, 4.21, 1.95, 0.965),
        (1 / 0.6, 4.78, 4.50, 2.23, 0.892),
        (1 / 0.5, 5.10, 4.90, 2.62, 0.819),
        (1 / 0.4, 5.57, 5.48, 3.24, 0.747),
        (1 / 0.3, 6.34, 6.40, 4.32, 0.674),
        (1 / 0.2, 7.78, 8.14, 6.63, 0.601),
        (1 / 0.1, 11.7, 12.8, 14.6, 0.526),
    ]
)


@dataclass(frozen=True, slots=True)
class ContactRadii:
    """What presses against what: radii of curvature at the contact point, and the load of one wheel.

    A radius is positive where the body is convex, negative where it is hollow, and infinite where it is straight.

    Raises:
        ParameterError: The surfaces do not touch in one point, or a number is impossible.
    """

    wheel_rolling_radius: float  # m
    rail_head_radius: float  # m, across the rail
    wheel_load: float  # N, of one wheel
    wheel_transverse_radius: float = math.inf  # m; a hollow worn tread is negative
    shear_modulus: float = STEEL_SHEAR_MODULUS  # Pa
    poisson_ratio: float = STEEL_POISSON_RATIO

    def __post_init__(self) -> None:
        for name in ("wheel_rolling_radius", "wheel_load", "shear_modulus"):
            value = getattr(self, name)
            if not math.isfinite(value) or value <= 0.0:
                raise ParameterError(f"{value!r} is not a possible value", field=name)
        if not 0.0 <= self.poisson_ratio < 0.5:  # noqa: PLR2004 - that of a body that keeps its volume
            raise ParameterError(f"{self.poisson_ratio!r} is not a possible value", field="poisson_ratio")
        if self.rail_head_radius == 0.0 or self.wheel_transverse_radius == 0.0 or self.transverse_curvature <= 0.0:
            reason = "wheel and rail do not touch in one point: the hollow radius must be larger than the other"
            raise ParameterError(reason, field="wheel_transverse_radius")

    @property
    def transverse_curvature(self) -> float:
        """Sum of the curvatures of both across the rail, 1/m."""
        return 1.0 / self.rail_head_radius + 1.0 / self.wheel_transverse_radius


@dataclass(frozen=True, slots=True)
class ContactRadiiStd:
    """Relative standard deviation of the inputs of :class:`ContactRadii`."""

    wheel_rolling_radius: float = 0.0
    rail_head_radius: float = 0.0
    wheel_load: float = 0.0
    wheel_transverse_radius: float = 0.0


@dataclass(frozen=True, slots=True)
class CreepCoefficients:
    """Kalker's linear creep coefficients of one wheel."""

    longitudinal: float  # f11, N
    lateral: float  # f22, N
    lateral_spin: float  # f23, N m
    spin: float  # f33, N m2


def contact_ellipse(contact: ContactRadii) -> tuple[float, float]:
    """Return the semi-axes (a, b) of Hertz's contact ellipse, m: a along the rail, b across it."""
    # The ratio of the curvatures determines the shape by the complete elliptic integrals of first and second kind (K.
    # L. Johnson, "Contact Mechanics", Cambridge 1985, Eq. 4.25 to 4.28).
    along, across = 1.0 / contact.wheel_rolling_radius, contact.transverse_curvature
    ratio = max(along, across) / min(along, across)
    short_to_long = _semi_axis_ratio(ratio)
    parameter = 1.0 - short_to_long**2  # e^2
    modulus = contact.shear_modulus / (1.0 - contact.poisson_ratio)  # E* of two bodies of one steel
    first, second = float(special.ellipk(parameter)), float(special.ellipe(parameter))
    # half the smaller curvature is 3 N (K - E) / (2 pi E* e^2 longer^3)
    shape = (first - second) / parameter if parameter > 0.0 else math.pi / 4.0
    half_curvature = 0.5 * min(along, across)
    longer = (1.5 * contact.wheel_load * shape / (math.pi * modulus * half_curvature)) ** (1.0 / 3.0)
    shorter = short_to_long * longer
    return (longer, shorter) if along <= across else (shorter, longer)


def _semi_axis_ratio(curvature_ratio: float) -> float:
    """Return short/long semi-axis of the ellipse whose larger curvature is ``curvature_ratio`` times the smaller."""
    if curvature_ratio <= 1.0:
        return 1.0

    def excess(g: float) -> float:
        parameter = 1.0 - g**2
        first, second = special.ellipk(parameter), special.ellipe(parameter)
        return float((second / g**2 - first) / (first - second)) - curvature_ratio

    if excess(OF_GEAR.flattest) < 0.0:
        raise ParameterError(
            f"the curvatures have the ratio {curvature_ratio:.3g}: the contact ellipse is outside Kalker's table",
            field="ratio",
        )
    return float(optimize.brentq(excess, OF_GEAR.flattest, 1.0 - 1e-9))


def table_coefficients(ratio: float) -> tuple[float, float, float, float]:
    """Return Kalker's C11, C22, C23 and C33 for the semi-axis ratio a/b, interpolated in its logarithm."""
    ratios = _ROWS[:, 0]
    if not ratios[0] <= ratio <= ratios[-1]:
        raise ParameterError(f"the contact ellipse has a/b = {ratio:.3g}, the table holds 0.1 to 10", field="ratio")
    at = math.log(ratio)
    c11, c22, c23, c33 = (math.exp(np.interp(at, np.log(ratios), np.log(column))) for column in _ROWS[:, 1:].T)
    return c11, c22, c23, c33


def creep_coefficients(contact: ContactRadii) -> CreepCoefficients:
    """Return the linear creep coefficients of a wheel: f11 = G a b C11, f23 = G (a b)^1.5 C23, f33 = G (a b)^2 C33."""
    a, b = contact_ellipse(contact)
    c11, c22, c23, c33 = table_coefficients(a / b)
    area, modulus = a * b, contact.shear_modulus
    return CreepCoefficients(
        longitudinal=modulus * area * c11,
        lateral=modulus * area * c22,
        lateral_spin=modulus * area**1.5 * c23,
        spin=modulus * area**2 * c33,
    )


def creep_coefficient_std(
    contact: ContactRadii, std: ContactRadiiStd, rail_condition_std: float = RAIL_CONDITION_STD
) -> CreepCoefficients:
    """Return the relative std of each coefficient: from radii and load, and from the rail's condition."""
    values = creep_coefficients(contact)
    variances = dict.fromkeys((item.name for item in fields(CreepCoefficients)), rail_condition_std**2)
    for name in (item.name for item in fields(ContactRadiiStd)):
        relative, value = getattr(std, name), getattr(contact, name)
        if not relative or math.isinf(value):
            continue
        changed = creep_coefficients(replace(contact, **{name: value * (1.0 + relative)}))
        for coefficient in variances:
            variances[coefficient] += (getattr(changed, coefficient) / getattr(values, coefficient) - 1.0) ** 2
    return CreepCoefficients(**{name: math.sqrt(variance) for name, variance in variances.items()})
