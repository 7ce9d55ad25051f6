"""The lateral and the yaw equation of one wheelset as a filter of what its sensors measure.

    e(s) = E(s) u(s),   u = (y, psi, phi, ym, yn, x)

with s = i omega, ym the lateral position of what is above the wheelset, yn that above the other wheelset of the bogie
(0 without one), x = y - d. e is zero where parameters and contact geometry are right and nothing is noisy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.vehicle.equations_of_motion import (
    GRAVITY,
    ContactState,
    VehicleParameters,
    WheelsetState,
    lateral_acceleration,
    yaw_acceleration,
)
from estimation.vehicle.linear_wheelset import ComplexArray, LinearContact, LinearModel
from estimation.vehicle.vehicle_class import SensorLayout

SIGNALS = 6
SENSORS = ("lateral", "yaw", "roll", "mass_lateral", "other_mass_lateral")
_Y, _PSI, _PHI, _MASS, _OTHER, _X = range(SIGNALS)


@dataclass(frozen=True, slots=True)
class Combinations:
    """The four combinations in small motion: R = 2 conicity x, S = 2 r0 + sum_deviation, D = angle_slope x, A."""

    conicity: float
    radius_sum_deviation: float  # m
    angle_slope: float  # D/x, rad/m
    angle_sum: float  # rad


def combinations(contact: LinearContact) -> Combinations:
    """Return the combinations of a contact geometry."""
    slope = 2 * contact.conicity * contact.angle_per_difference
    return Combinations(contact.conicity, 0.0, slope, contact.angle_sum)


def equations(p: VehicleParameters, wheelbase: float | None, speed: float, at: Combinations) -> FloatArray:
    """Return the coefficients (2, signals, 3) of e by the signals and their first and second derivatives, N and N m.

    Args:
        wheelbase: m, of the bogie, of which this is the front wheelset; None where the yaw spring is tied to a fixed
            body.
        speed: V, m/s.
    """
    units = np.eye(2 * SIGNALS)
    u, du = units[:SIGNALS], units[SIGNALS:]
    S, R, D = 2 * p.nominal_radius + at.radius_sum_deviation, 2 * at.conicity * u[_X], at.angle_slope * u[_X]
    contact = ContactState((S + R) / 2, (S - R) / 2, (at.angle_sum + D) / 2, (at.angle_sum - D) / 2, u[_PHI], du[_PHI])
    state = WheelsetState(u[_Y], du[_Y], u[_PSI], du[_PSI], u[_MASS], du[_MASS])
    frame = np.zeros(2 * SIGNALS)
    if wheelbase is not None:
        frame = p.yaw_stiffness * (u[_MASS] - u[_OTHER]) + p.yaw_damping * (du[_MASS] - du[_OTHER])
        frame = frame / wheelbase
    coefficients = np.zeros((2, 3, SIGNALS))
    coefficients[0, :2] = -p.wheelset_mass * lateral_acceleration(p, speed, state, contact).reshape(2, SIGNALS)
    turning = p.yaw_inertia * yaw_acceleration(p, speed, state, contact) + frame
    coefficients[1, :2] = -turning.reshape(2, SIGNALS)
    coefficients[0, 2, _Y], coefficients[1, 2, _PSI] = p.wheelset_mass, p.yaw_inertia
    return np.moveaxis(coefficients, 1, 2)


def filtered(coefficients: FloatArray, s: ComplexArray) -> ComplexArray:
    """Return E(s) (f, 2, signals).

    Args:
        coefficients: (2, signals, 3), see :func:`equations`.
        s: (f,) i omega, 1/s.
    """
    powers = np.stack([np.ones_like(s), s, s * s])
    return np.asarray(np.einsum("ejk,kf->fej", coefficients, powers), dtype=np.complex128)


def true_signals(model: LinearModel, contact: LinearContact, p: VehicleParameters, s: ComplexArray) -> ComplexArray:
    """Return u (f, signals) of the front wheelset per metre of alignment.

    Args:
        model: Single wheelset or bogie.
        s: (f,) i omega, 1/s.
    """
    q = model.response(s.imag / (2 * np.pi))
    u = np.zeros((len(s), SIGNALS), dtype=np.complex128)
    u[:, _Y], u[:, _PSI], u[:, _X] = q[:, 0], q[:, 1], q[:, 0] - 1.0
    u[:, _PHI] = contact.conicity / p.half_contact_distance * u[:, _X]
    if len(model.wheelset_offsets) == 1:
        u[:, _MASS] = q[:, 2]
    else:
        arm = model.wheelset_offsets[1] / 2
        u[:, _MASS], u[:, _OTHER] = q[:, 4] + arm * q[:, 5], q[:, 4] - arm * q[:, 5]
    return u


def sensor_filters(layout: SensorLayout, s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return what sensors become of signals (f, sensors, signals), and signals of sensors (f, signals, sensors).

    The second integrates, and takes gravity off the lateral signal by the roll.

    Args:
        s: (f,) i omega, 1/s.
    """
    orders = 2, 1 if layout.yaw_is_gyroscope else 2, 1 if layout.roll_is_gyroscope else 2, 2, 2
    measured = np.zeros((len(s), len(SENSORS), SIGNALS), dtype=np.complex128)
    restored = np.zeros((len(s), SIGNALS, len(SENSORS)), dtype=np.complex128)
    for sensor, (signal, order) in enumerate(zip((_Y, _PSI, _PHI, _MASS, _OTHER), orders, strict=True)):
        measured[:, sensor, signal] = s**order
        restored[:, signal, sensor] = s**-order
    if layout.measures_gravity:
        measured[:, 0, _PHI] = GRAVITY
        restored[:, _Y, 2] = -GRAVITY * restored[:, _PHI, 2] * restored[:, _Y, 0]
    restored[:, _X] = restored[:, _Y]
    return measured, restored
