"""The long waves of the rolling radius difference of a wheelset in a bogie, from its lateral motion.

With the yaw of the frame psi_f, and psi = (y' + r0 phi')/V + (lateral creep) + g R of Eq. 1, the yaw equation reads

    R (1 + (k_psi/c) g) = -2 l r0 psi'/V - (k_psi/c) ((y' + r0 phi')/V - psi_f) - (k_psi/c) (lateral creep)

with c = l f11/r0. A stiff primary suspension makes (k_psi/c) g as large as 1, and multiplies every error of the
lateral creep coefficient. So the three terms on the right are not taken as they are: each has a factor, and the
factors are those with which the terms agree best with the R of the yaw sensor at wavelengths that both know. The noise
of the yaw sensor is in what is fitted and not in the terms, so that it does not bias the factors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.filters.local_cubic import high_pass, local_cubic_kernel
from estimation.motion.fusion_parameters import FusionParameters
from estimation.values.arrays import FloatArray
from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.regressors import angle_difference_factor

ANGLE_PER_RADIUS = 112.0  # 1/m: contact angle difference over rolling radius difference of usual pairs


@dataclass(frozen=True, slots=True)
class BogieYaws:
    """What the yaw of a wheelset follows from, and that of the frame, on a grid of distance (m,), rad."""

    rolling: FloatArray  # (y' + r0 phi') / V
    creep: FloatArray  # what the lateral creep adds, without g R
    frame: FloatArray


def long_waves_in_bogie(
    R: FloatArray, yaws: BogieYaws, V: FloatArray, vehicle: VehicleParameters, parameters: FusionParameters
) -> tuple[FloatArray, FloatArray]:
    """Return R and its stiffness term (m,), m, of the lateral motion of a wheelset in a bogie.

    Args:
        R: (m,) m, by the yaw sensor, on a grid of distance.
        yaws: (m,) rad, on the same grid.
        V: (m,) m/s.
        vehicle: Parameters of Eq. 1 and Eq. 2; its yaw stiffness is that of the primary suspension.
        parameters: Grid, and the wavelengths at which both are compared.
    """
    p, step = vehicle, parameters.step
    per_moment = -p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient)
    rolling = -2 * p.half_contact_distance * p.nominal_radius
    inertia = p.yaw_inertia * V * V * _bend(yaws.rolling, step)
    terms = np.stack(
        [
            rolling * np.gradient(yaws.rolling, step),
            per_moment * (p.yaw_stiffness * (yaws.rolling - yaws.frame) + inertia),
            per_moment * p.yaw_stiffness * yaws.creep,
        ]
    )
    slow = np.asarray(_factors(R, terms, per_moment, p, parameters) @ terms)
    return slow, np.asarray(slow - rolling * np.gradient(yaws.rolling + yaws.creep, step))


def _factors(
    R: FloatArray, terms: FloatArray, per_moment: float, p: VehicleParameters, parameters: FusionParameters
) -> FloatArray:
    """Return the factors (3,) of the terms (3, m) that bring them to R (m,) where both are good."""
    gravity = -0.5 * ANGLE_PER_RADIUS * angle_difference_factor(p) / p.lateral_creep_coefficient
    expected = np.full(len(terms), 1.0 / max(1.0 - per_moment * p.yaw_stiffness * gravity, LEAST_DIVISOR))
    step = parameters.step
    margin = int(parameters.margin / step)
    if len(R) <= 3 * margin:
        return expected
    short, long = (local_cubic_kernel(wavelength, step) for wavelength in parameters.compared)
    both = np.concatenate([terms, R[None, :]])
    band = (high_pass(both, long) - high_pass(both, short))[:, margin:-margin]
    design, target = band[:-1], band[-1]
    normal = design @ design.T + parameters.gravity_weight * np.eye(len(terms))
    return np.asarray(np.linalg.solve(normal, design @ target + parameters.gravity_weight * expected))


LEAST_DIVISOR = 0.5  # of the factors known beforehand


def _bend(yaw: FloatArray, step: float) -> FloatArray:
    return np.asarray(np.gradient(np.gradient(yaw, step), step))
