"""The equations of motion of a wheelset, and solved for its contact geometry: physical unknowns, two per equation.

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

This module is their one definition; the simulator's compiled loop is tested equal to it.

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

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from estimation.compiled import compiled
from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.windows import OF_FRAME, Motion
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.vehicle_class import VehicleParameters

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
    """Return the signals of a motion."""
    plain = {name: getattr(motion, name) for name in Signals._fields if name not in OF_FRAME}
    if motion.frame_yaw is None or motion.frame_yaw_rate is None or motion.frame_displacement is None:
        return Signals(**plain, frame_yaw=_NOTHING, frame_yaw_rate=_NOTHING, frame_displacement=_NOTHING)
    return Signals(**plain, **{name: getattr(motion, name) for name in OF_FRAME})


_NOTHING = frozen_array(np.zeros(0), (0,), name="nothing")


@compiled(nogil=True, error_model="numpy")
def lateral_equation(signals: Signals, k: Coefficients, i: int, row: FloatArray) -> None:
    """Write x1, x2 and the targets of Eq. 1 of sample ``i``."""
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
    """Write c and behind it the targets of Eq. 2 of sample ``i``, from ``row[at]``."""
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
def write_equations(signals: Signals, k: Coefficients, yaw: FloatArray) -> None:
    """Write regressors and targets of Eq. 2 (n, 2 or 4, and 8) of all samples."""
    for i in range(len(signals.speed)):
        yaw_targets(signals, k, i, yaw[i], yaw_regressors(signals, k, i, yaw[i]))


LATERAL_TARGETS = ("z1", "lateral_creep", "spin_creep", "mass", "load", "lateral_stiffness", "lateral_damping")
YAW_TARGETS = (
    "z2", "longitudinal_creep", "yaw_stiffness", "yaw_inertia", "spin_creep", "saturation", "noise",
    "displacement_noise",
)  # fmt: skip
REGRESSORS = 4
SHARED_IN_BOGIE = 3  # regressors of z2 that are the same in all bins: two scale errors and an angle of the sensors


@dataclass(frozen=True, slots=True)
class Regression:
    """Regressors and targets of Eq. 2 for n samples."""

    yaw: FloatArray  # (n, 2) (l W/2) psi, c; in a bogie (n, 4) the shared regressors, c
    yaw_targets: FloatArray  # (n, 8), see YAW_TARGETS


def angle_difference_factor(parameters: VehicleParameters) -> float:
    """Return x2 = f23/r0 - W/2, N: the factor of D in Eq. 1, positive or negative."""
    return parameters.lateral_spin_creep_coefficient / parameters.nominal_radius - parameters.load / 2


def angle_difference_derivatives(parameters: VehicleParameters) -> FloatArray:
    """Return (6,) derivatives of ln |x2| by the logarithms of the parameters, in the order of LATERAL_TARGETS after z1.

    The data determine the product x2 D, so that D changes by as much the other way, whatever the samples.
    """
    by_name = dict.fromkeys(LATERAL_TARGETS[1:], 0.0)
    by_name["spin_creep"] = parameters.lateral_spin_creep_coefficient / parameters.nominal_radius
    by_name["load"] = -parameters.load / 2
    return np.array(list(by_name.values())) / (angle_difference_factor(parameters) or VEHICLE.least_force)


def regression(
    motion: Motion, parameters: VehicleParameters, difference_noise: float = 0.0, wheelbase: float = 1.0
) -> Regression:
    """Return regressors and targets of Eq. 2 for every sample; the motion's stiffness ratio counts."""
    signals, k = signals_of(motion), coefficients(motion, parameters, difference_noise, wheelbase)
    before_c = SHARED_IN_BOGIE if k.in_bogie else 1
    yaw = np.empty((len(motion), before_c + 1 + len(YAW_TARGETS)))
    write_equations(signals, k, yaw)
    return Regression(yaw[:, : before_c + 1], yaw[:, before_c + 1 :])


def coefficients(
    motion: Motion, parameters: VehicleParameters, difference_noise: float = 0.0, wheelbase: float = 1.0
) -> Coefficients:
    """Return the coefficients of both equations."""
    f11 = parameters.longitudinal_creep_coefficient / motion.stiffness_ratio
    p = replace(parameters, longitudinal_creep_coefficient=f11)
    return Coefficients(
        f11=p.longitudinal_creep_coefficient,
        f22=p.lateral_creep_coefficient,
        f23=p.lateral_spin_creep_coefficient,
        f33=p.spin_creep_coefficient,
        **{name: getattr(p, name) for name in Coefficients._fields if hasattr(p, name)},
        angle_factor=angle_difference_factor(p),
        difference_noise=difference_noise,
        displacement_noise=motion.displacement_noise,
        wheelbase=wheelbase,
        in_bogie=motion.frame_yaw is not None and motion.frame_displacement is not None,
    )


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


def _array(value: npt.ArrayLike) -> FloatArray:
    return np.asarray(value, dtype=np.float64)


def _radius_sum(contact: ContactState) -> FloatArray:
    return _array(contact.rolling_radius_left) + _array(contact.rolling_radius_right)


def _angle_difference(contact: ContactState) -> FloatArray:
    return _array(contact.contact_angle_left) - _array(contact.contact_angle_right)
