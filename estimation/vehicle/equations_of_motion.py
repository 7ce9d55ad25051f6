"""One wheelset and its suspended mass: parameters and equations of motion.

Source: Ward, Goodall, Dixon, "Wheel-Rail Profile Condition Monitoring", UKACC 2010, Eq. 1-5 and Table A.1. With x
forward, y left, z up (ISO 8855): yaw psi > 0 turns the front to the left, roll phi > 0 lifts the left wheel, and for
a displacement to the left (y > 0) the left wheel runs on its larger radius and steeper contact angle::

    m y''     = -(2 f22/V) (y' + (rL+rR)/2 phi' - V psi) - 2 f11 (1 - (rL+rR)/(2 r0)) psi
                - (2 f23/V) (psi' - V (dL-dR)/(2 r0)) - W ((dL-dR)/2 + phi) + Fsy                            (1)
    I psi''   = -(Iwy V/r0) phi' - (l f11/r0) (rL-rR) + (2 f23/V) (y' + (rL+rR)/2 phi' - V psi)
                - 2 l^2 f11 psi'/V + f33 (dL-dR)/r0 + (l W/2) (dL+dR) psi - 2 f33 psi'/V + Mpsi              (2)
    mm ym''   = -Fsy                                                                                         (3)
    Fsy       = ky (ym - y) + fy (ym' - y')                                                                  (4)
    Mpsi      = -k_psi psi - f_psi psi'                                                                      (5)

This module is the one definition of these equations; the simulator's compiled loop is tested equal to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.values.arrays import FloatArray
from estimation.vehicle.vehicle_class import VehicleParameters


@dataclass(frozen=True, slots=True)
class WheelsetState:
    """States of wheelset and mass; scalars or arrays of one shape (n,)."""

    lateral_displacement: npt.ArrayLike  # y, m, absolute
    lateral_velocity: npt.ArrayLike  # y', m/s
    yaw: npt.ArrayLike  # psi, rad
    yaw_rate: npt.ArrayLike  # psi', rad/s
    mass_lateral_displacement: npt.ArrayLike  # ym, m
    mass_lateral_velocity: npt.ArrayLike  # ym', m/s


@dataclass(frozen=True, slots=True)
class ContactState:
    """What the contact geometry gives at one lateral displacement and gauge deviation; scalars or arrays (n,)."""

    rolling_radius_left: npt.ArrayLike  # rL, m
    rolling_radius_right: npt.ArrayLike  # rR, m
    contact_angle_left: npt.ArrayLike  # dL, rad
    contact_angle_right: npt.ArrayLike  # dR, rad
    roll: npt.ArrayLike  # phi, rad
    roll_rate: npt.ArrayLike  # phi', rad/s


def lateral_suspension_force(parameters: VehicleParameters, state: WheelsetState) -> FloatArray:
    """Return Fsy (n,), N: the force of spring and damper on the wheelset, positive to the left (Eq. 4)."""
    deflection = _array(state.mass_lateral_displacement) - _array(state.lateral_displacement)
    rate = _array(state.mass_lateral_velocity) - _array(state.lateral_velocity)
    return parameters.lateral_stiffness * deflection + parameters.lateral_damping * rate


def yaw_suspension_moment(parameters: VehicleParameters, state: WheelsetState) -> FloatArray:
    """Return Mpsi (n,), N m: the moment of the yaw suspension on the wheelset (Eq. 5)."""
    psi, psi_rate = _array(state.yaw), _array(state.yaw_rate)
    return -parameters.yaw_stiffness * psi - parameters.yaw_damping * psi_rate


def lateral_acceleration(
    parameters: VehicleParameters, speed: npt.ArrayLike, state: WheelsetState, contact: ContactState
) -> FloatArray:
    """Return y'' (n,), m/s2, of the wheelset (Eq. 1); ``speed`` V in m/s, positive."""
    p = parameters
    f11, f22, f23 = p.longitudinal_creep_coefficient, p.lateral_creep_coefficient, p.lateral_spin_creep_coefficient
    V, psi, psi_rate = _array(speed), _array(state.yaw), _array(state.yaw_rate)
    S, D = _radius_sum(contact), _angle_difference(contact)
    slip = lateral_slip_velocity(speed, state, contact)
    force = (
        -(2.0 * f22 / V) * slip
        - 2.0 * f11 * (1.0 - S / (2.0 * p.nominal_radius)) * psi
        - (2.0 * f23 / V) * (psi_rate - V * D / (2.0 * p.nominal_radius))
        - p.load * (D / 2.0 + _array(contact.roll))
        + lateral_suspension_force(p, state)
    )
    return force / p.wheelset_mass


def yaw_acceleration(
    parameters: VehicleParameters, speed: npt.ArrayLike, state: WheelsetState, contact: ContactState
) -> FloatArray:
    """Return psi'' (n,), rad/s2, of the wheelset (Eq. 2 and 5); ``speed`` V in m/s, positive."""
    p = parameters
    f11, f23, f33 = p.longitudinal_creep_coefficient, p.lateral_spin_creep_coefficient, p.spin_creep_coefficient
    half, r0 = p.half_contact_distance, p.nominal_radius
    V, psi, psi_rate = _array(speed), _array(state.yaw), _array(state.yaw_rate)
    R = _array(contact.rolling_radius_left) - _array(contact.rolling_radius_right)
    A = _array(contact.contact_angle_left) + _array(contact.contact_angle_right)
    moment = (
        -(p.pitch_inertia * V / r0) * _array(contact.roll_rate)
        - (half * f11 / r0) * R
        + (2.0 * f23 / V) * lateral_slip_velocity(speed, state, contact)
        - 2.0 * half**2 * f11 * psi_rate / V
        + f33 * _angle_difference(contact) / r0
        + (half * p.load / 2.0) * A * psi
        - 2.0 * f33 * psi_rate / V
        + yaw_suspension_moment(p, state)
    )
    return moment / p.yaw_inertia


def mass_lateral_acceleration(parameters: VehicleParameters, state: WheelsetState) -> FloatArray:
    """Return ym'' (n,), m/s2, of the suspended mass (Eq. 3)."""
    return -lateral_suspension_force(parameters, state) / parameters.suspended_mass


def lateral_slip_velocity(speed: npt.ArrayLike, state: WheelsetState, contact: ContactState) -> FloatArray:
    """Return y' + (rL+rR)/2 phi' - V psi (n,), m/s: the lateral slip that Eq. 1 and 2 share."""
    return (
        _array(state.lateral_velocity)
        + 0.5 * _radius_sum(contact) * _array(contact.roll_rate)
        - _array(speed) * _array(state.yaw)
    )


def creep_rate(parameters: VehicleParameters, speed: float) -> float:
    """Return the fastest decay rate of the creep modes, 1/s: the larger of 2 f22/(m V) and 2 l^2 f11/(I V).

    It bounds the step of an explicit integration: the rate grows without limit as the speed falls.
    """
    p = parameters
    lateral = 2.0 * p.lateral_creep_coefficient / (p.wheelset_mass * speed)
    yaw = 2.0 * p.half_contact_distance**2 * p.longitudinal_creep_coefficient / (p.yaw_inertia * speed)
    return max(lateral, yaw)


def _array(value: npt.ArrayLike) -> FloatArray:
    return np.asarray(value, dtype=np.float64)


def _radius_sum(contact: ContactState) -> FloatArray:
    return _array(contact.rolling_radius_left) + _array(contact.rolling_radius_right)


def _angle_difference(contact: ContactState) -> FloatArray:
    return _array(contact.contact_angle_left) - _array(contact.contact_angle_right)
