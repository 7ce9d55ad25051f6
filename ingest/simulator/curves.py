"""Curves of a simulated track: curvature and cant along it, and what they do to a wheelset that follows them.

Motion is relative to the path: y from the designed centre line, yaw from its tangent. With curvature kappa
(positive to the left), cant angle theta (right rail above the left one, over the distance of the contact points) and
a = V^2 kappa - g theta, the uncompensated lateral acceleration, Eq. 1-3 gain

    y''    - a - (2 f23/m) kappa
    psi''  - (V kappa)' - (2 l^2 f11 + 2 f33) kappa / I + (Iwy V/(r0 I)) theta'
    ym''   - a

because creep goes by the absolute yaw rate psi' + V kappa; the middle term is the path difference, which a difference
of rolling radii rL - rR = -2 l r0 kappa would balance. Sensors on the axlebox measure y'' + a, psi'' + (V kappa)',
phi'' - theta'' (the left wheel is the lower one) and ym'' + a.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from pydantic import AfterValidator

from estimation.errors import ParameterError
from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.fields import MM, M
from estimation.vehicle.equations_of_motion import GRAVITY, VehicleParameters
from ingest.file_value import between
from ingest.input_file import NotNegative, Positive, field_error

ROUNDING = 6.0  # m over which the ends of transitions are rounded: no track has a kink in its cant


MIN_CURVE_RADIUS = 150.0  # m


def _curve_radius(radius: float) -> float:
    if abs(radius) < MIN_CURVE_RADIUS:
        raise field_error(f"{radius:g} m is no radius; at least {MIN_CURVE_RADIUS:g} m, negative to the right")
    return radius


@dataclass(frozen=True, slots=True)
class Curve:
    """One curve between two equal transitions, m; ``radius`` and ``cant`` positive to the left."""

    start: Annotated[NotNegative, M]
    length: Annotated[Positive, M]  # with both transitions
    radius: Annotated[float, between(-1e6, 1e6), AfterValidator(_curve_radius), M]
    cant: Annotated[float, between(-200.0, 200.0), MM] = 0.0
    transition: Annotated[Positive, M] = 80.0

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse a curve that is all transition."""
        if self.length <= 2.0 * self.transition:
            raise field_error(f"{self.length:g} m is no longer than both transitions", "length_m")
        return self

    def __post_init__(self) -> None:
        if not (self.radius and self.transition > 0 and self.length > 2 * self.transition):
            raise ParameterError("a curve needs a radius and more length than its two transitions", field="curves")


@dataclass(frozen=True, slots=True)
class Curves:
    """Curvature and cant on the grid of a track."""

    curvature: FloatArray  # (n,) 1/m, positive to the left
    cant: FloatArray  # (n,) m, right rail above the left one

    def __post_init__(self) -> None:
        n = len(self.curvature)
        for name in ("curvature", "cant"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))


@dataclass(frozen=True, slots=True)
class PathMotion:
    """What the path does to a wheelset that follows it."""

    forced: FloatArray  # (n, 3) added to y'', psi'', ym''
    accelerations: FloatArray  # (4, n) what sensors measure beside the motion, in the order of ACCELERATIONS


def laid_out(curves: Sequence[Curve], s: FloatArray) -> Curves:
    """Return the curves on the grid ``s`` (n,), m; linear transitions with rounded ends."""
    shape = np.zeros((2, len(s)))
    for curve in curves:
        corners = curve.start + np.array([0.0, curve.transition, curve.length - curve.transition, curve.length])
        ramp = np.interp(s, corners, [0.0, 1.0, 1.0, 0.0])
        shape += np.outer([1.0 / curve.radius, curve.cant], ramp)
    window = np.hanning(2 * round(0.5 * ROUNDING / float(s[1] - s[0])) + 3)
    padded = np.pad(shape, ((0, 0), (len(window) // 2,) * 2), mode="edge")
    rounded = [np.convolve(row, window / window.sum(), mode="valid") for row in padded]
    return Curves(*rounded)


def path_motion(
    p: VehicleParameters, curves: Curves, s: FloatArray, distance: FloatArray, speed: FloatArray, step: float
) -> PathMotion:
    """Return the accelerations that curved track forces on a wheelset, and those that its sensors measure of the path.

    Args:
        curves: Curvature (m,), 1/m, and cant (m,), m, on the grid ``s``.
        s: (m,) m along the section.
        distance: (n,) m along the section at each sample.
        speed: (n,) m/s.
        step: Interval of the samples, s.
    """
    curvature = np.interp(distance, s, curves.curvature)
    tilt = np.interp(distance, s, curves.cant) / (2.0 * p.half_contact_distance)
    tilt_rate = np.gradient(tilt, step)
    uncompensated = speed**2 * curvature - GRAVITY * tilt
    turning = np.gradient(speed * curvature, step)
    spin = 2.0 * p.lateral_spin_creep_coefficient * curvature / p.wheelset_mass
    creep = 2.0 * (p.half_contact_distance**2 * p.longitudinal_creep_coefficient + p.spin_creep_coefficient)
    gyroscopic = p.pitch_inertia * speed / p.nominal_radius * tilt_rate
    yaw = -turning - (creep * curvature - gyroscopic) / p.yaw_inertia  # the right rail above: it rolls by -tilt
    return PathMotion(
        forced=np.ascontiguousarray(np.column_stack([-uncompensated - spin, yaw, -uncompensated])),
        accelerations=np.stack([uncompensated, turning, -np.gradient(tilt_rate, step), uncompensated]),
    )
