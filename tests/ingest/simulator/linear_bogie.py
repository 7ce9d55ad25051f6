"""A bogie on cones as a linear system, from Newton's equations of its four bodies: an oracle for the compiled loop."""

from __future__ import annotations

import numpy as np
from linear_wheelset import linear_system

from estimation.values.arrays import FloatArray
from estimation.vehicle.vehicle_class import BogieParameters, VehicleParameters


def bogie_system(
    p: VehicleParameters, b: BogieParameters, V: float, conicity: float, angle_slope: float, roll_slope: float
) -> FloatArray:
    """States y, y', psi, psi' of the front wheelset, of the rear one, of the frame; y, y' of the body."""
    ky, fy, kp, fp = p.lateral_stiffness, p.lateral_damping, p.yaw_stiffness, p.yaw_damping
    alone = linear_system(p, V, conicity, angle_slope, roll_slope)[:4, :4].copy()
    alone[1, :2] += np.array([ky, fy]) / p.wheelset_mass  # without its suspension
    alone[3, 2:] += np.array([kp, fp]) / p.yaw_inertia
    system = np.zeros((14, 14))
    lateral, yaw = np.zeros(14), np.zeros(14)  # on the frame
    for i, x in ((0, 0.5 * b.wheelbase), (4, -0.5 * b.wheelbase)):
        system[i : i + 4, i : i + 4] = alone
        force, moment = np.zeros(14), np.zeros(14)  # on the wheelset
        force[[8, 9]] += ky, fy
        force[[10, 11]] += ky * x, fy * x
        force[[i, i + 1]] -= ky, fy
        moment[[10, 11]] += kp, fp
        moment[[i + 2, i + 3]] -= kp, fp
        system[i + 1] += force / p.wheelset_mass
        system[i + 3] += moment / p.yaw_inertia
        lateral -= force
        yaw -= x * force + moment
    secondary = np.zeros(14)  # on the frame
    secondary[[12, 13]] = b.secondary_lateral_stiffness, b.secondary_lateral_damping
    secondary[[8, 9]] = -b.secondary_lateral_stiffness, -b.secondary_lateral_damping
    yaw[10] -= b.secondary_yaw_stiffness
    yaw[11] -= b.secondary_yaw_damping
    system[8, 9] = system[10, 11] = system[12, 13] = 1.0
    system[9] = (lateral + secondary) / b.frame_mass
    system[11] = yaw / b.frame_yaw_inertia
    system[13] = -secondary / b.body_mass
    return system
