"""The algorithm of the paper as it is printed: bins of y - d, a threshold count, grey-box recursion in each bin.

Ward, Goodall, Dixon, UKACC 2010, section 4: two multiple-input single-output identifications with the regressors
[psi, phi', 1], lateral (Eq. 15-16) and yaw (Eq. 17-18), from which the four combinations follow. The signs of the
known parts are those of ``estimation.vehicle.equations_of_motion``. Kept as the baseline and for the reproduction.
The recursion is compiled; the tests hold its plain form.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.windows import Motion
from estimation.vehicle.equations_of_motion import VehicleParameters

REGRESSORS = 3


@dataclass(frozen=True, slots=True)
class PaperParameters:
    """Division size b, threshold count and forgetting factor W of section 4."""

    width: float = 0.25e-3  # b, m
    threshold: int = 200
    forgetting: float = 1.0
    vehicle: VehicleParameters = field(default_factory=VehicleParameters)


@dataclass(frozen=True, slots=True)
class PaperGeometry:
    """The four combinations by bin; NaN where the threshold was not reached."""

    centre: FloatArray  # (b,) m
    samples: IntArray  # (b,)
    rolling_radius_sum: FloatArray  # (b,) m
    rolling_radius_difference: FloatArray  # (b,) m
    contact_angle_sum: FloatArray  # (b,) rad
    contact_angle_difference: FloatArray  # (b,) rad


def estimate(motion: Motion, parameters: PaperParameters) -> PaperGeometry:
    """Run the algorithm over ideal signals in the order of their samples; the mean speed is the paper's V."""
    p = parameters.vehicle
    keep = motion.valid
    V = float(motion.speed[keep].mean())
    nearest = np.floor(motion.displacement[keep] / parameters.width + 0.5).astype(np.int64)
    first, bins = int(nearest.min()), int(nearest.max() - nearest.min()) + 1
    features = np.column_stack([motion.yaw[keep], motion.roll_rate[keep], np.ones(int(keep.sum()))])
    lateral, count = recursion_in_bins(features, _lateral(motion, p, V, keep), nearest - first, bins, parameters)
    yaw, _ = recursion_in_bins(features, yaw_output(motion, p, V, keep), nearest - first, bins, parameters)
    f11, f22, f23 = p.longitudinal_creep_coefficient, p.lateral_creep_coefficient, p.lateral_spin_creep_coefficient
    r0, l = p.nominal_radius, p.half_contact_distance  # noqa: E741 - the paper's l
    return PaperGeometry(
        centre=np.asarray((first + np.arange(bins)) * parameters.width, dtype=np.float64),
        samples=count,
        rolling_radius_sum=(p.wheelset_mass * lateral[:, 0] - 2 * f22 + 2 * f11) * r0 / f11,
        rolling_radius_difference=-p.yaw_inertia * yaw[:, 2] * r0 / (l * f11),
        contact_angle_sum=(p.yaw_inertia * yaw[:, 0] + p.yaw_stiffness + 2 * f23) / (l * p.load / 2),
        contact_angle_difference=p.wheelset_mass * lateral[:, 2] / (f23 / r0 - p.load / 2),
    )


def _lateral(motion: Motion, p: VehicleParameters, V: float, keep: BoolArray) -> FloatArray:
    """Return y'' - Omega1 (Eq. 15)."""
    known = (
        -(2 * p.lateral_creep_coefficient / V) * motion.lateral_velocity
        + p.lateral_damping * motion.suspension_deflection_rate
        + p.lateral_stiffness * motion.suspension_deflection
        - (2 * p.lateral_spin_creep_coefficient / V) * motion.yaw_rate
        - p.load * motion.roll
    ) / p.wheelset_mass
    return np.asarray((motion.lateral_acceleration - known)[keep])


def yaw_output(motion: Motion, p: VehicleParameters, V: float, keep: BoolArray) -> FloatArray:
    """Return psi'' - Omega2 (k,), rad/s^2 (Eq. 17); the frame of a bogie moves the other end of the yaw spring."""
    damping = 2 * p.half_contact_distance**2 * p.longitudinal_creep_coefficient / V + 2 * p.spin_creep_coefficient / V
    known = (
        (2 * p.lateral_spin_creep_coefficient / V) * motion.lateral_velocity
        - (damping + p.yaw_damping) * motion.yaw_rate
    ) / p.yaw_inertia
    if motion.frame_yaw is not None and motion.frame_yaw_rate is not None:
        known = known + (p.yaw_stiffness * motion.frame_yaw + p.yaw_damping * motion.frame_yaw_rate) / p.yaw_inertia
    return np.asarray((motion.yaw_acceleration - known)[keep])


def recursion_in_bins(
    features: FloatArray, output: FloatArray, index: IntArray, bins: int, parameters: PaperParameters
) -> tuple[FloatArray, IntArray]:
    """Run Eq. 10-14 in every bin; return theta (b, 3), NaN below the threshold, and the counts (b,).

    Args:
        index: (n,) bin of each sample, 0..bins-1.
    """
    count = np.bincount(index, minlength=bins).astype(np.int64)
    theta = np.full((bins, REGRESSORS), np.nan)
    order = np.argsort(index, kind="stable")  # a bin's samples together, in their own order
    stops = np.cumsum(count)
    for b in np.flatnonzero(count >= parameters.threshold):
        rows = order[stops[b] - count[b] : stops[b]]
        X, z = features[rows], output[rows]
        scale = np.sqrt((X[: parameters.threshold] ** 2).mean(axis=0))
        root, triangle = np.linalg.qr(X[: parameters.threshold] / scale)
        if np.abs(np.diag(triangle)).min() <= 1e-9 * np.abs(np.diag(triangle)).max():
            continue
        inverse = np.linalg.inv(triangle)
        start = inverse @ (root.T @ z[: parameters.threshold])
        tail = np.ascontiguousarray(X[parameters.threshold :] / scale)
        theta[b] = _recurse(start, inverse @ inverse.T, tail, z[parameters.threshold :], parameters.forgetting) / scale
    return theta, count


@compiled(nogil=True)
def _recurse(theta: FloatArray, P: FloatArray, X: FloatArray, z: FloatArray, W: float) -> FloatArray:
    """Eq. 12-14, sample by sample."""
    for i in range(len(z)):
        x = X[i]
        Px = P @ x
        γ = 1.0 / (W + x @ Px)
        theta = theta + γ * Px * (z[i] - x @ theta)
        P = (P - γ * np.outer(Px, Px)) / W
    return theta
