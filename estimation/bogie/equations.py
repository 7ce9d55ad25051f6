"""The equations of a bogie as columns over its unknowns, means over cells along the track.

Divided by c = l f11/r0 the yaw equations of both wheelsets and of the frame are, with delta_i = psi_i - psi_f,

    E_i   R_i(x_i) + [I psi_i'' + Iwy V/r0 phi_i' + k delta_i + k' delta_i' + 2 l^2 f11 psi_i'/V - 2 f23/V slip_i]/c
          + [creep moment of the simulation, times what saturation takes of it]/c = 0
    E_6   [I_f psi_f'' - k (delta_1 + delta_2) - k' (...)' + a (F_1 - F_2) + k2 psi_f]/c = 0,
          F_i = ky (y_f +- a psi_f - y_i) + fy (...)'

f11 stays as it is on file: the equations but for the rolling term and R are homogeneous in the others over it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.bogie.parameters import BOGIE
from estimation.bogie.signals import BogieRun
from estimation.bogie.simulation import Gear, Simulated, spin_force
from estimation.values.arrays import FloatArray

RealOrComplex = FloatArray | npt.NDArray[np.complex128]

EQUATIONS = len(("E_1", "E_2", "E_6"))
PARAMETERS = (
    "yaw_stiffness",  # k, relative
    "lateral_stiffness",  # ky, relative
    "inverse_friction",  # 1/mu
    "creep",  # 1/f11, relative: all but the rolling term and R
    "yaw_inertia",  # I, relative
    "frame_inertia",  # I_f, relative
    "spin_creep",  # f23, relative
    "yaw_scale_front",  # of the yaw sensors, relative
    "yaw_scale_rear",
    "frame_scale",  # of both frame sensors, relative
    "frame_difference",  # of one frame sensor against the other
    "lateral_scale_front",  # of the lateral sensors against the frame's, relative
    "lateral_scale_rear",
    "yaw_angle_front",  # of the yaw sensors about the lateral axis, rad
    "yaw_angle_rear",
    "shift",  # m, by which the bogie is further along the track than it is taken to be
)


Moved = BogieRun | Simulated
"""Signals of a bogie, measured or simulated."""


def moving_rows(moved: Moved, speed: FloatArray, radius: float) -> FloatArray:
    """Return what the equations are linear in (r, n): nine rows of each axle, then five of the frame."""
    (psi, dpsi, ddpsi), (phi, dphi), (y, dy, _) = moved.yaw, moved.roll, moved.lateral
    slip = (dy + radius * dphi) / speed - psi
    return np.concatenate(
        [psi, dpsi, ddpsi, phi, y, dy, dpsi / speed, speed * dphi, slip, moved.frame_yaw, moved.frame_lateral]
    )


def terms(gear: Gear, rows: RealOrComplex, saturated: RealOrComplex) -> RealOrComplex:
    """Return what is known of the equations and then their parameters' columns (3, 1 + p, ...), m of R.

    Args:
        rows: (r, ...) of :func:`moving_rows`, or means or transforms of them.
        saturated: (2, 2, ...) of :func:`saturation` of both axles, alike.
    """
    p, b, g = gear.vehicle, gear.bogie, gear.per_newton_metre
    a, shape = 0.5 * b.wheelbase, rows.shape[1:]
    psi_f, dpsi_f, ddpsi_f, y_f, dy_f = rows[-5:]
    psi, dpsi, ddpsi, phi, y, dy, rolled, gyroscopic, slip = rows[:-5].reshape(-1, 2, *shape)
    columns = np.zeros((EQUATIONS, 1 + len(PARAMETERS), *shape), dtype=rows.dtype)
    place = {name: 1 + number for number, name in enumerate(PARAMETERS)}
    k, arms = p.yaw_stiffness, (a, -a)
    rolling = 2 * (p.half_contact_distance**2 * p.longitudinal_creep_coefficient + p.spin_creep_coefficient)
    frame = columns[2]
    for axle, arm in enumerate(arms):
        side = ("front", "rear")[axle]
        spring, damper = k * (psi[axle] - psi_f), p.yaw_damping * (dpsi[axle] - dpsi_f)
        inertia, spin = p.yaw_inertia * ddpsi[axle], -2 * p.lateral_spin_creep_coefficient * slip[axle]
        turning = p.pitch_inertia / p.nominal_radius * gyroscopic[axle]
        lost, by_friction = saturated[axle]
        own = columns[axle]
        own[place["creep"]] = inertia + turning + spring + damper + spin + lost
        own[0] = own[place["creep"]] + rolling * rolled[axle]
        own[place["yaw_stiffness"]] = spring
        own[place["inverse_friction"]] = by_friction
        own[place["yaw_inertia"]] = inertia
        own[place["spin_creep"]] = spin
        frame[place["yaw_stiffness"]] -= spring
        frame[0] -= spring + damper
        by_scale, by_angle = k * psi[axle], k * phi[axle]
        for sign, row in ((1.0, own), (-1.0, frame)):
            row[place[f"yaw_scale_{side}"]] += sign * by_scale
            row[place[f"yaw_angle_{side}"]] += sign * by_angle
            row[place["frame_scale"]] -= sign * k * psi_f
            row[place["frame_difference"]] -= sign * k * y_f / a
        pressed = p.lateral_stiffness * (y_f + arm * psi_f - y[axle])
        damped = p.lateral_damping * (dy_f + arm * dpsi_f - dy[axle])
        frame[0] += arm * (pressed + damped)
        frame[place["lateral_stiffness"]] += arm * pressed
        frame[place["frame_scale"]] += arm * p.lateral_stiffness * arm * psi_f
        frame[place["frame_difference"]] += arm * p.lateral_stiffness * arm * y_f / a
        frame[place[f"lateral_scale_{side}"]] -= arm * p.lateral_stiffness * y[axle]
    frame[place["frame_inertia"]] = b.frame_yaw_inertia * ddpsi_f
    frame[0] += frame[place["frame_inertia"]] + b.secondary_yaw_stiffness * psi_f
    return np.asarray(g * columns)


def saturation(gear: Gear, moved: Simulated, axle: int) -> FloatArray:
    """Return what linear creep has more than the moment that creep holds up, N m, and its derivative by 1/mu (2, n).

    With f the force of a wheel over mu N its linear one is 3 (1 - (1 - f)^(1/3)) times mu N (Vermeulen and Johnson).
    """
    p = gear.vehicle
    turned, turning = moved.yaw[0, axle] - moved.frame_yaw[0], moved.yaw[1, axle] - moved.frame_yaw[1]
    moment = p.yaw_inertia * moved.yaw[2, axle] + p.yaw_stiffness * turned + p.yaw_damping * turning
    arm = 0.5 * gear.bogie.wheelbase * (1.0 if axle == 0 else -1.0)
    deflection = moved.frame_lateral[0] + arm * moved.frame_yaw[0] - moved.lateral[0, axle]
    across = p.wheelset_mass * moved.lateral[2, axle] + p.load * moved.roll[0, axle] - p.lateral_stiffness * deflection
    of_creep = np.hypot(moment / (2.0 * p.half_contact_distance), 0.5 * across)
    force = np.hypot(of_creep, spin_force(p)) / (0.5 * p.axle_load)  # per 1/mu
    f = np.clip(force * gear.inverse_friction, 1e-9, BOGIE.most_saturation)
    more = 3.0 * (1.0 - np.cbrt(1.0 - f)) / f
    by_f = (1.0 / np.cbrt(1.0 - f) ** 2 - more) / f
    by_f = np.where(f > 1e-6, by_f, 1.0 / 3.0)  # noqa: PLR2004 - the limit, without cancellation
    return np.stack([moment * (more - 1.0), moment * by_f * force])
