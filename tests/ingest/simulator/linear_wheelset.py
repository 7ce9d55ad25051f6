"""The wheelset on cones as a linear system, worked out by hand from Eq. 1-5: an oracle for stability and growth."""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.vehicle.vehicle_class import VehicleParameters


def linear_system(p: VehicleParameters, V: float, conicity: float, angle_slope: float, roll_slope: float) -> FloatArray:
    """With rL,R = r0 +- c y, dL,R = c +- g y, phi = q y: S = 2 r0, R = 2 c y, D = 2 g y, A = 2 c, phi' = q y'."""
    f11, f22, f23, f33 = (
        p.longitudinal_creep_coefficient,
        p.lateral_creep_coefficient,
        p.lateral_spin_creep_coefficient,
        p.spin_creep_coefficient,
    )
    half, r0, W = p.half_contact_distance, p.nominal_radius, p.load
    c, g, q = conicity, angle_slope, roll_slope
    ky, fy, m, M, inertia = p.lateral_stiffness, p.lateral_damping, p.wheelset_mass, p.suspended_mass, p.yaw_inertia
    lateral = np.array(
        [
            2 * f23 * g / r0 - W * g - W * q - ky,
            -2 * f22 / V * (1 + r0 * q) - fy,
            2 * f22,
            -2 * f23 / V,
            ky,
            fy,
        ]
    )
    yaw = np.array(
        [
            -2 * half * f11 * c / r0 + 2 * f33 * g / r0,
            -p.pitch_inertia * V * q / r0 + 2 * f23 / V * (1 + r0 * q),
            -2 * f23 + half * W * c - p.yaw_stiffness,
            -2 * half**2 * f11 / V - 2 * f33 / V - p.yaw_damping,
            0.0,
            0.0,
        ]
    )
    mass = np.array([ky, fy, 0.0, 0.0, -ky, -fy])
    system = np.zeros((6, 6))
    system[0, 1] = system[2, 3] = system[4, 5] = 1.0
    system[1], system[3], system[5] = lateral / m, yaw / inertia, mass / M
    return system


def growth_rate(p: VehicleParameters, V: float, conicity: float, angle_slope: float, roll_slope: float) -> float:
    """Largest real part of the eigenvalues, 1/s: positive above the critical speed."""
    return float(np.linalg.eigvals(linear_system(p, V, conicity, angle_slope, roll_slope)).real.max())
