"""The equations of motion solved for the contact geometry: physical unknowns, two per equation.

With S = rL + rR, R = rL - rR, A = dL + dR, D = dL - dR (radii r, contact angles d), Eq. 1 and Eq. 2 read

    z1 = S x1 + D x2             x1 = (f11/r0) psi - (f22/V) phi',   x2 = f23/r0 - W/2
    z2 = A (l W/2) psi + R c     c = -l f11/r0

where z1 and z2 gather all that is measured. Beside each target stand its derivatives by the logarithm of the uncertain
parameters, at S = 2 r0: regressed like the target, they give the derivative of every estimate by every parameter.

In a bogie k_psi is so large that A cannot be seen beside a scale error of the yaw sensor, k_psi e psi, or between the
two frame sensors, k_psi e ym / wheelbase. There these two regressors take its place, with psi = (y' + r0 phi')/V of
the lateral motion, whose noise is not that of z2. A third is what z2 has too much where the yaw sensor is turned about
y and measures psi + b phi, by b: k_psi phi and the creep of phi'/V.

Creep forces saturate: a force T of a wheel needs 1 + T/(3 mu N) times its linear creep (Vermeulen and Johnson 1964,
first term). The derivative by 1/mu stands beside the others. The last two targets of z2 are c times the variance of
R and of y - d that the noise of the sensors makes: regressed on c they give the means of these variances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.values.motion import Motion
from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.regression_kernels import Coefficients, coefficients_of, signals_of, write_equations

LATERAL_TARGETS = ("z1", "lateral_creep", "spin_creep", "mass", "load", "lateral_stiffness", "lateral_damping")
YAW_TARGETS = (
    "z2", "longitudinal_creep", "yaw_stiffness", "yaw_inertia", "spin_creep", "saturation", "noise",
    "displacement_noise",
)  # fmt: skip
REGRESSORS = 4
SHARED_IN_BOGIE = 3  # regressors of z2 that are the same in all bins: two scale errors and an angle of the sensors
SMALLEST_FACTOR = 1e-6  # N; in place of zero, with which the data say nothing of D


@dataclass(frozen=True, slots=True)
class Regression:
    """Regressors and targets of both equations for n samples."""

    lateral: FloatArray  # (n, 2) x1, x2
    lateral_targets: FloatArray  # (n, 7), see LATERAL_TARGETS
    yaw: FloatArray  # (n, 2) (l W/2) psi, c; in a bogie (n, 4) the shared regressors, c
    yaw_targets: FloatArray  # (n, 8), see YAW_TARGETS


def angle_difference_factor(parameters: VehicleParameters) -> float:
    """Return x2 = f23/r0 - W/2, N: the factor of D in Eq. 1, positive or negative."""
    return parameters.lateral_spin_creep_coefficient / parameters.nominal_radius - parameters.load / 2


def angle_difference_derivatives(parameters: VehicleParameters) -> FloatArray:
    """Return (6,) derivatives of ln |x2| by the logarithms of the parameters, in the order of LATERAL_TARGETS after z1.

    The data determine the product x2 D, so that D changes by as much the other way, whatever the samples.

    Args:
        parameters: Of the vehicle; f23 and W make the factor.
    """
    by_name = dict.fromkeys(LATERAL_TARGETS[1:], 0.0)
    by_name["spin_creep"] = parameters.lateral_spin_creep_coefficient / parameters.nominal_radius
    by_name["load"] = -parameters.load / 2
    return np.array(list(by_name.values())) / (angle_difference_factor(parameters) or SMALLEST_FACTOR)


def regression(
    motion: Motion, parameters: VehicleParameters, difference_noise: float = 0.0, wheelbase: float = 1.0
) -> Regression:
    """Return regressors and targets of Eq. 1 and Eq. 2 for every sample of ``motion``.

    What is known of the vehicle's stiffness ratio is taken into account.

    Args:
        motion: (n,) samples relative to the track.
        parameters: As assumed; the longitudinal creep coefficient is divided by the stiffness ratio of the motion.
        difference_noise: Variance of R by the noise of the sensors times the cube of the speed, m2 (m/s)3.
        wheelbase: Of the bogie, m; without one it plays no part.
    """
    signals, k = signals_of(motion), coefficients(motion, parameters, difference_noise, wheelbase)
    before_c = SHARED_IN_BOGIE if k.in_bogie else 1
    lateral = np.empty((len(motion), 2 + len(LATERAL_TARGETS)))
    yaw = np.empty((len(motion), before_c + 1 + len(YAW_TARGETS)))
    write_equations(signals, k, lateral, yaw)
    return Regression(lateral[:, :2], lateral[:, 2:], yaw[:, : before_c + 1], yaw[:, before_c + 1 :])


def coefficients(
    motion: Motion, parameters: VehicleParameters, difference_noise: float = 0.0, wheelbase: float = 1.0
) -> Coefficients:
    """Return the coefficients of both equations."""
    f11 = parameters.longitudinal_creep_coefficient / motion.stiffness_ratio
    p = replace(parameters, longitudinal_creep_coefficient=f11)
    in_bogie = motion.frame_yaw is not None and motion.frame_displacement is not None
    noises = difference_noise, motion.displacement_noise
    return coefficients_of(p, angle_difference_factor(p), *noises, wheelbase, in_bogie=in_bogie)
