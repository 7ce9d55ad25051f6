"""The equations of motion solved for the contact geometry, array by array."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.values.windows import Motion
from estimation.vehicle.regressors import (
    LATERAL_TARGETS,
    Regression,
    angle_difference_factor,
    coefficients,
    lateral_equation,
    signals_of,
)
from estimation.vehicle.regressors import regression as yaw_regression
from estimation.vehicle.vehicle_class import VehicleParameters


@dataclass(frozen=True, slots=True)
class BothEquations(Regression):
    """Regressors and targets of Eq. 1 and Eq. 2 for n samples."""

    lateral: FloatArray  # (n, 2) x1, x2
    lateral_targets: FloatArray  # (n, 7)


def both_equations(
    motion: Motion, parameters: VehicleParameters, difference_noise: float = 0.0, wheelbase: float = 1.0
) -> BothEquations:
    """Return regressors and targets of both equations as the product has them."""
    signals, k = signals_of(motion), coefficients(motion, parameters, difference_noise, wheelbase)
    lateral = np.empty((len(motion), 2 + len(LATERAL_TARGETS)))
    for i, row in enumerate(lateral):
        lateral_equation(signals, k, i, row)
    of_yaw = yaw_regression(motion, parameters, difference_noise, wheelbase)
    return BothEquations(of_yaw.yaw, of_yaw.yaw_targets, lateral[:, :2], lateral[:, 2:])


def regression(
    motion: Motion, parameters: VehicleParameters, difference_noise: float = 0.0, wheelbase: float = 1.0
) -> BothEquations:
    """Return regressors and targets of Eq. 1 and Eq. 2 for every sample, as the product's own does."""
    f11 = parameters.longitudinal_creep_coefficient / motion.stiffness_ratio
    p = replace(parameters, longitudinal_creep_coefficient=f11)
    f22, f23 = p.lateral_creep_coefficient, p.lateral_spin_creep_coefficient
    f33, r0, l = p.spin_creep_coefficient, p.nominal_radius, p.half_contact_distance  # noqa: E741 - the paper's l
    V, ψ, dψ, ddψ = motion.speed, motion.yaw, motion.yaw_rate, motion.yaw_acceleration
    slip = motion.lateral_velocity - V * ψ  # without the roll term, which carries S
    rolling_slip = slip + r0 * motion.roll_rate

    inertia = p.wheelset_mass * motion.lateral_acceleration
    spring = -p.lateral_stiffness * motion.suspension_deflection
    damper = -p.lateral_damping * motion.suspension_deflection_rate
    spin = (2 * f23 / V) * dψ
    weight = p.load * motion.roll
    z1 = inertia + (2 * f22 / V) * slip + 2 * f11 * ψ + spin + weight + spring + damper
    x1 = (f11 / r0) * ψ - (f22 / V) * motion.roll_rate
    x2 = np.full(len(motion), angle_difference_factor(p))

    yaw_inertia = p.yaw_inertia * ddψ
    creep = 2 * l**2 * f11 * dψ / V
    known = (np.zeros(1) if one is None else one for one in (motion.frame_yaw, motion.frame_yaw_rate))
    frame_yaw, frame_yaw_rate = known
    yaw_spring = p.yaw_stiffness * (ψ - frame_yaw)
    yaw_damper = p.yaw_damping * (dψ - frame_yaw_rate)
    yaw_spin = -(2 * f23 / V) * rolling_slip
    gyroscopic = (p.pitch_inertia * V / r0) * motion.roll_rate
    z2 = yaw_inertia + gyroscopic + creep + 2 * f33 * dψ / V + yaw_spring + yaw_damper + yaw_spin
    c = np.full(len(motion), -l * f11 / r0)
    creep_moment = yaw_inertia + yaw_spring + yaw_damper  # what the creep forces hold up
    force = np.hypot(creep_moment / (2 * l), 0.5 * (inertia + weight + spring + damper))  # of one wheel
    saturation = creep_moment * force / (1.5 * p.axle_load)
    first = [(l * p.load / 2) * ψ]
    if motion.frame_yaw is not None and motion.frame_displacement is not None:
        first = [
            p.yaw_stiffness * (rolling_slip / V + ψ),
            (p.yaw_stiffness / wheelbase) * motion.frame_displacement,
            _moment_of_roll(motion, p),
        ]
    return BothEquations(
        np.column_stack([*first, c]),
        np.column_stack(
            [
                *(z2, creep - z2, yaw_spring, yaw_inertia, yaw_spin, saturation),
                *(c * difference_noise / V**3, c * motion.displacement_noise),
            ]
        ),
        np.column_stack([x1, x2]),
        np.column_stack([z1, (2 * f22 / V) * rolling_slip, spin, inertia, weight, spring, damper]),
    )


def _moment_of_roll(motion: Motion, p: VehicleParameters) -> FloatArray:
    """Return what z2 would be (n,), N m, if the roll were the yaw; the wheelset's inertia is small beside the rest."""
    creep = 2 * (p.half_contact_distance**2 * p.longitudinal_creep_coefficient + p.spin_creep_coefficient)
    of_rate = (creep / motion.speed + p.yaw_damping) * motion.roll_rate
    return (p.yaw_stiffness + 2 * p.lateral_spin_creep_coefficient) * motion.roll + of_rate
