"""Kalker's linear creep coefficients from the radii of wheel and rail and the load: Hertz's ellipse, Kalker's table."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy import optimize, special

from estimation.errors import ParameterError
from estimation.values.units import STEEL_POISSON_RATIO, STEEL_SHEAR_MODULUS
from estimation.vehicle.parameters import VEHICLE

RAIL_CONDITION_STD = VEHICLE.rail_condition_std
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

    if excess(VEHICLE.flattest_ellipse) < 0.0:
        raise ParameterError(
            f"the curvatures have the ratio {curvature_ratio:.3g}: the contact ellipse is outside Kalker's table",
            field="ratio",
        )
    return float(optimize.brentq(excess, VEHICLE.flattest_ellipse, 1.0 - 1e-9))


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
