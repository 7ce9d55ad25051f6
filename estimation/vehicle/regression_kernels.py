"""Compiled regressors and targets of both equations of motion, sample by sample: see ``estimation.vehicle.regressors``.

The order of the operations is that of the formulas there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.motion import OF_FRAME, Motion
from estimation.vehicle.equations_of_motion import VehicleParameters

LATERAL_COLUMNS = 9  # x1, x2 and the targets of Eq. 1
YAW_TARGET_COLUMNS = 8


class Signals(NamedTuple):
    """Signals of a motion, (n,) each; those of the frame are empty without a bogie."""

    speed: FloatArray
    lateral_velocity: FloatArray
    lateral_acceleration: FloatArray
    yaw: FloatArray
    yaw_rate: FloatArray
    yaw_acceleration: FloatArray
    roll: FloatArray
    roll_rate: FloatArray
    suspension_deflection: FloatArray
    suspension_deflection_rate: FloatArray
    frame_yaw: FloatArray
    frame_yaw_rate: FloatArray
    frame_displacement: FloatArray


class Coefficients(NamedTuple):
    """Parameters of the equations, as ``VehicleParameters`` names them, and what follows from them."""

    f11: float
    f22: float
    f23: float
    f33: float
    lateral_damping: float
    yaw_damping: float
    yaw_inertia: float
    pitch_inertia: float
    half_contact_distance: float
    wheelset_mass: float
    lateral_stiffness: float
    yaw_stiffness: float
    load: float
    nominal_radius: float
    axle_load: float
    angle_factor: float  # x2
    difference_noise: float
    displacement_noise: float
    wheelbase: float
    in_bogie: bool


def signals_of(motion: Motion) -> Signals:
    """Return the signals of a motion.

    Args:
        motion: (n,) samples.
    """
    plain = {name: getattr(motion, name) for name in Signals._fields if name not in OF_FRAME}
    if motion.frame_yaw is None or motion.frame_yaw_rate is None or motion.frame_displacement is None:
        return Signals(**plain, frame_yaw=_NOTHING, frame_yaw_rate=_NOTHING, frame_displacement=_NOTHING)
    return Signals(**plain, **{name: getattr(motion, name) for name in OF_FRAME})


_NOTHING = frozen_array(np.zeros(0), (0,), name="nothing")


def coefficients_of(
    p: VehicleParameters,
    angle_factor: float,
    difference_noise: float,
    displacement_noise: float,
    wheelbase: float,
    *,
    in_bogie: bool,
) -> Coefficients:
    """Return the coefficients of a vehicle.

    Args:
        angle_factor: x2, N.
        difference_noise: Variance of R by the noise of the sensors times the cube of the speed, m2 (m/s)3.
        displacement_noise: Variance of y - d by the noise of the sensors, m2.
        wheelbase: Of the bogie, m; without one it plays no part.
        in_bogie: Whether the yaw spring is tied to the frame of a bogie.
    """
    return Coefficients(
        p.longitudinal_creep_coefficient,
        p.lateral_creep_coefficient,
        p.lateral_spin_creep_coefficient,
        p.spin_creep_coefficient,
        p.lateral_damping,
        p.yaw_damping,
        p.yaw_inertia,
        p.pitch_inertia,
        p.half_contact_distance,
        p.wheelset_mass,
        p.lateral_stiffness,
        p.yaw_stiffness,
        p.load,
        p.nominal_radius,
        p.axle_load,
        angle_factor,
        difference_noise,
        displacement_noise,
        wheelbase,
        in_bogie,
    )


@compiled(nogil=True, error_model="numpy")
def lateral_equation(signals: Signals, k: Coefficients, i: int, row: FloatArray) -> None:
    """Write x1, x2 and the targets of Eq. 1 of sample ``i``.

    Args:
        row: (9,), written.
    """
    speed, yaw, roll_rate = signals.speed[i], signals.yaw[i], signals.roll_rate[i]
    slip = signals.lateral_velocity[i] - speed * yaw  # without the roll term, which carries S
    inertia = k.wheelset_mass * signals.lateral_acceleration[i]
    spring = -k.lateral_stiffness * signals.suspension_deflection[i]
    damper = -k.lateral_damping * signals.suspension_deflection_rate[i]
    spin = (2 * k.f23 / speed) * signals.yaw_rate[i]
    weight = k.load * signals.roll[i]
    row[0] = (k.f11 / k.nominal_radius) * yaw - (k.f22 / speed) * roll_rate
    row[1] = k.angle_factor
    row[2] = inertia + (2 * k.f22 / speed) * slip + 2 * k.f11 * yaw + spin + weight + spring + damper
    row[3] = (2 * k.f22 / speed) * (slip + k.nominal_radius * roll_rate)
    row[4], row[5], row[6], row[7], row[8] = spin, inertia, weight, spring, damper


@compiled(nogil=True, error_model="numpy")
def yaw_moments(signals: Signals, k: Coefficients, i: int) -> tuple[float, float, float, float, float, float]:
    """Return the moments of sample ``i`` that make z2, and first their sum: inertia, creep, spring, damper, spin."""
    speed, yaw, yaw_rate, roll_rate = signals.speed[i], signals.yaw[i], signals.yaw_rate[i], signals.roll_rate[i]
    l, r0 = k.half_contact_distance, k.nominal_radius  # noqa: E741 - the paper's l
    deflection, deflection_rate = yaw, yaw_rate
    if k.in_bogie:
        deflection, deflection_rate = yaw - signals.frame_yaw[i], yaw_rate - signals.frame_yaw_rate[i]
    rolling_slip = signals.lateral_velocity[i] - speed * yaw + r0 * roll_rate
    inertia = k.yaw_inertia * signals.yaw_acceleration[i]
    creep = 2 * l**2 * k.f11 * yaw_rate / speed
    spring, damper = k.yaw_stiffness * deflection, k.yaw_damping * deflection_rate
    spin = -(2 * k.f23 / speed) * rolling_slip
    gyroscopic = (k.pitch_inertia * speed / r0) * roll_rate
    z2 = inertia + gyroscopic + creep + 2 * k.f33 * yaw_rate / speed + spring + damper + spin
    return z2, inertia, creep, spring, damper, spin


@compiled(nogil=True, error_model="numpy")
def yaw_targets(signals: Signals, k: Coefficients, i: int, row: FloatArray, at: int) -> None:
    """Write c and behind it the targets of Eq. 2 of sample ``i``, from ``row[at]``.

    Args:
        row, at: Where c and the targets are written.
    """
    z2, inertia, creep, spring, damper, spin = yaw_moments(signals, k, i)
    c = radius_factor(k)
    creep_moment = inertia + spring + damper  # what the creep forces hold up
    lateral = (
        k.wheelset_mass * signals.lateral_acceleration[i]
        + k.load * signals.roll[i]
        + -k.lateral_stiffness * signals.suspension_deflection[i]
        + -k.lateral_damping * signals.suspension_deflection_rate[i]
    )
    along, across = creep_moment / (2 * k.half_contact_distance), 0.5 * lateral
    force = math.sqrt(along * along + across * across)  # of one wheel
    row[at], row[at + 1], row[at + 2], row[at + 3] = c, z2, creep - z2, spring
    row[at + 4], row[at + 5] = inertia, spin
    row[at + 6] = creep_moment * force / (1.5 * k.axle_load)
    row[at + 7], row[at + 8] = c * k.difference_noise / signals.speed[i] ** 3, c * k.displacement_noise


@compiled(nogil=True)
def radius_factor(k: Coefficients) -> float:
    """Return c, N: the factor of R in Eq. 2."""
    return -k.half_contact_distance * k.f11 / k.nominal_radius


@compiled(nogil=True, error_model="numpy")
def yaw_regressors(signals: Signals, k: Coefficients, i: int, row: FloatArray) -> int:
    """Write the regressors of Eq. 2 before c of sample ``i``; return how many there are."""
    speed, yaw, roll_rate = signals.speed[i], signals.yaw[i], signals.roll_rate[i]
    if not k.in_bogie:
        row[0] = (k.half_contact_distance * k.load / 2) * yaw
        return 1
    rolling_slip = signals.lateral_velocity[i] - speed * yaw + k.nominal_radius * roll_rate
    row[0] = k.yaw_stiffness * (rolling_slip / speed + yaw)
    row[1] = (k.yaw_stiffness / k.wheelbase) * signals.frame_displacement[i]
    # what z2 would be if the roll were the yaw; the wheelset's inertia is small beside the rest
    creep = 2 * (k.half_contact_distance**2 * k.f11 + k.f33)
    of_rate = (creep / speed + k.yaw_damping) * roll_rate
    row[2] = (k.yaw_stiffness + 2 * k.f23) * signals.roll[i] + of_rate
    return 3


@compiled(nogil=True, error_model="numpy")
def write_equations(signals: Signals, k: Coefficients, lateral: FloatArray, yaw: FloatArray) -> None:
    """Write x1, x2 and targets of Eq. 1 (n, 9), regressors and targets of Eq. 2 (n, 2 or 4, and 8) of all samples."""
    for i in range(len(signals.speed)):
        lateral_equation(signals, k, i, lateral[i])
        before_c = yaw_regressors(signals, k, i, yaw[i])
        yaw_targets(signals, k, i, yaw[i], before_c)
