"""What a curved path does to a running gear whose axles are at different places of it.

Every wheelset and the frame move relative to the path where they are: y from its centre line, yaw from its tangent.
Seen from the frame's middle, the path at an axle is displaced by o and turned by t, both integrals of the curvature
between the two. Forces of the curve on wheelsets and masses are those of ``ingest.simulator.curves``; creep goes by
the absolute yaw rate psi' + V kappa, which the loop adds itself.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.values.arrays import FloatArray
from estimation.vehicle.equations_of_motion import GRAVITY, VehicleParameters
from ingest.simulator.curves import Curves
from ingest.simulator.gear_rates import AXLE_PATH, FRAME_PATH, PATH


def gear_path(
    p: VehicleParameters,
    curves: Curves,
    s: FloatArray,
    distance: FloatArray,
    speed: FloatArray,
    step: float,
    places: tuple[float, ...],
) -> tuple[FloatArray, FloatArray]:
    """Return what the loop needs of the path, (n, 16), and what the sensors of each axle measure of it, (a, 4, n).

    Per axle of the former: accelerations added to y'' and psi'', curvature, o, o', t, t'; then the accelerations added
    to frame (and body). The latter are in the order of ``ACCELERATIONS``.

    Args:
        curves: Curvature (m,), 1/m, and cant (m,), m, on the grid ``s``.
        s: (m,) m along the section.
        distance: (n,) m of the frame's middle at each sample.
        speed: (n,) m/s.
        step: Interval of the samples, s.
        places: (a,) m by which each axle is ahead of the frame's middle.
    """
    curvature = CubicSpline(s, curves.curvature)
    heading, line = curvature.antiderivative(1), curvature.antiderivative(2)
    middle = curvature(distance)
    path = np.zeros((len(speed), PATH))
    sensed = np.empty((len(places), 4, len(speed)))
    for axle, x in enumerate(places):
        at = distance + x
        kappa, tilt = curvature(at), np.interp(at, s, curves.cant) / (2.0 * p.half_contact_distance)
        turned, rolling = heading(at) - heading(distance), np.gradient(tilt, step)
        uncompensated, turning = speed**2 * kappa - GRAVITY * tilt, np.gradient(speed * kappa, step)
        gyroscopic = p.pitch_inertia * speed / p.nominal_radius * rolling / p.yaw_inertia
        path[:, AXLE_PATH * axle : AXLE_PATH * (axle + 1)] = np.column_stack(
            [
                -uncompensated,
                -turning + gyroscopic,  # the right rail above: it rolls by -tilt
                kappa,
                line(at) - line(distance) - x * heading(distance),
                speed * (turned - x * middle),
                turned,
                speed * (kappa - middle),
            ]
        )
        sensed[axle, :3] = uncompensated, turning, -np.gradient(rolling, step)
    tilt = np.interp(distance, s, curves.cant) / (2.0 * p.half_contact_distance)
    uncompensated, turning = speed**2 * middle - GRAVITY * tilt, np.gradient(speed * middle, step)
    path[:, FRAME_PATH], path[:, FRAME_PATH + 1] = -uncompensated, -turning
    sensed[:, 3] = uncompensated + np.outer(places, turning)
    return path, sensed
