"""The linear model of a vehicle class: its modes with names, and the speed above which it hunts.

The lateral and the yaw equation of one wheelset as a filter of what its sensors measure.

    e(s) = E(s) u(s),   u = (y, psi, phi, ym, yn, x)

with s = i omega, ym the lateral position of what is above the wheelset, yn that above the other wheelset of the bogie
(0 without one), x = y - d. e is zero where parameters and contact geometry are right and nothing is noisy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.vehicle.equations_of_motion import (
    GRAVITY,
    ContactState,
    VehicleParameters,
    WheelsetState,
    lateral_acceleration,
    lateral_suspension_force,
    yaw_acceleration,
    yaw_suspension_moment,
)
from estimation.vehicle.linear_wheelset import (
    ComplexArray,
    LinearContact,
    LinearModel,
    assemble,
    klingel_frequency,
    single_wheelset_model,
    wheelset_accelerations,
)
from estimation.vehicle.vehicle_class import BogieParameters, SensorLayout, VehicleClass

COORDINATES = (
    "front wheelset lateral",
    "front wheelset yaw",
    "rear wheelset lateral",
    "rear wheelset yaw",
    "frame lateral",
    "frame yaw",
    "body lateral",
)


def bogie_model(
    parameters: VehicleParameters, bogie: BogieParameters, speed: float, contact: LinearContact
) -> LinearModel:
    """Return the model of a bogie whose two wheelsets are alike."""
    arms = bogie.wheelbase / 2, -bogie.wheelbase / 2

    def accelerations(q: FloatArray, v: FloatArray, d: FloatArray) -> FloatArray:
        result = np.empty_like(q)
        force, moment = _secondary(bogie, q, v)
        result[6] = -force / bogie.body_mass
        for number, arm in enumerate(arms):
            at = 2 * number
            state = _state(q, v, at, arm)
            lateral, yaw = wheelset_accelerations(parameters, speed, contact, state, d[number::2])
            on_wheelset = lateral_suspension_force(parameters, state)
            torsion = yaw_suspension_moment(parameters, _relative(state, q[5], v[5]))
            unyawing = yaw_suspension_moment(parameters, state)
            result[at] = lateral
            result[at + 1] = yaw + (torsion - unyawing) / parameters.yaw_inertia
            force = force - on_wheelset
            moment = moment - torsion - arm * on_wheelset
        result[4], result[5] = force / bogie.frame_mass, moment / bogie.frame_yaw_inertia
        return result

    klingel_hz = klingel_frequency(parameters, speed, contact)
    return assemble(accelerations, speed, klingel_hz, COORDINATES, (0.0, bogie.wheelbase))


def _state(q: FloatArray, v: FloatArray, at: int, arm: float) -> WheelsetState:
    """Return the state of the wheelset whose coordinates begin at ``at``, with the frame above it as its mass."""
    return WheelsetState(q[at], v[at], q[at + 1], v[at + 1], q[4] + arm * q[5], v[4] + arm * v[5])


def _relative(state: WheelsetState, yaw: FloatArray, yaw_rate: FloatArray) -> WheelsetState:
    """Return the state with its yaw against the frame's."""
    return WheelsetState(
        state.lateral_displacement,
        state.lateral_velocity,
        np.asarray(state.yaw) - yaw,
        np.asarray(state.yaw_rate) - yaw_rate,
        state.mass_lateral_displacement,
        state.mass_lateral_velocity,
    )


def _secondary(bogie: BogieParameters, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return force and moment of the secondary suspension on the frame."""
    force = bogie.secondary_lateral_stiffness * (q[6] - q[4]) + bogie.secondary_lateral_damping * (v[6] - v[4])
    moment = -bogie.secondary_yaw_stiffness * q[5] - bogie.secondary_yaw_damping * v[5]
    return force, moment


LOWEST_SPEED, HIGHEST_SPEED, SPEED_STEP, SPEED_TOLERANCE = 5.0, 150.0, 2.5, 0.05  # m/s
_CREEPING = 0.8  # damping ratio of a mode that hardly oscillates
_STABLE = 1e-5  # 1/s; a body without a spring has an eigenvalue of 0


@dataclass(frozen=True, slots=True)
class Mode:
    """A mode of the linear model."""

    name: str
    growth: float  # real part of the eigenvalue, 1/s; negative where the mode decays
    frequency_hz: float  # of its oscillation; 0 where it does not oscillate

    @property
    def damping_ratio(self) -> float:
        """Share of critical damping; negative where the mode grows."""
        magnitude = math.hypot(self.growth, 2 * math.pi * self.frequency_hz)
        return -self.growth / magnitude if magnitude else 0.0


def linear_model(vehicle_class: VehicleClass, speed: float, contact: LinearContact) -> LinearModel:
    """Return the state space of a class at V, m/s, positive."""
    if vehicle_class.bogie is None:
        return single_wheelset_model(vehicle_class.parameters, speed, contact)
    return bogie_model(vehicle_class.parameters, vehicle_class.bogie, speed, contact)


def modes(model: LinearModel) -> tuple[Mode, ...]:
    """Return the modes, those that decay slowest first; a pair of conjugate eigenvalues is one mode.

    The name is that of the coordinate with the largest participation (product of left and right eigenvector; I. J.
    Perez-Arriaga et al., IEEE Trans. Power Apparatus and Systems 101, 1982). A mode of the wheelsets that hardly
    oscillates is one of creep; one up to twice Klingel's frequency is kinematic.
    """
    values, right = np.linalg.eig(model.matrix)
    left = np.linalg.inv(right).T  # rows of the inverse are the left eigenvectors
    n = len(model.coordinates)
    participation = np.abs(left * right)
    shares = participation[:n] + participation[n:]
    found = [
        Mode(_name(model, shares[:, at], right[:n, at], value), float(value.real), abs(value.imag) / (2 * math.pi))
        for at, value in enumerate(values)
        if value.imag >= 0.0
    ]
    return tuple(sorted(found, key=lambda mode: -mode.growth))


def _name(model: LinearModel, shares: FloatArray, shape: FloatArray, value: complex) -> str:
    names = model.coordinates
    wheelset = np.array(["wheelset" in name for name in names])
    if shares[wheelset].sum() < shares[~wheelset].max():
        return names[int(np.argmax(np.where(wheelset, 0.0, shares)))]
    lateral = np.array([name.endswith("wheelset lateral") for name in names])
    direction = "lateral" if shares[lateral].sum() >= shares[wheelset & ~lateral].sum() else "yaw"
    if abs(value.real) > _CREEPING * abs(value):
        return f"wheelset {direction}, creep"
    kind = "kinematic" if abs(value.imag) < 4 * math.pi * model.klingel_hz else f"wheelset {direction}"
    if len(model.wheelset_offsets) == 1:
        return kind
    first = int(np.argmax(np.abs(shape[:2])))
    together = (shape[first] * np.conj(shape[first + 2])).real > 0.0
    return f"{kind}, in {'step' if together else 'opposition'}"


def critical_speed(vehicle_class: VehicleClass, contact: LinearContact) -> float:
    """Return the lowest speed, m/s, above which a mode grows; infinite where none does up to 150 m/s."""

    def grows(speed: float) -> bool:
        matrix = linear_model(vehicle_class, speed, contact).matrix
        return bool(np.linalg.eigvals(matrix).real.max() > _STABLE)

    speeds = np.arange(LOWEST_SPEED, HIGHEST_SPEED + SPEED_STEP, SPEED_STEP)
    unstable = next((float(speed) for speed in speeds if grows(float(speed))), math.inf)
    if unstable in {LOWEST_SPEED, math.inf}:
        return unstable
    stable = unstable - SPEED_STEP
    while unstable - stable > SPEED_TOLERANCE:
        middle = (stable + unstable) / 2
        stable, unstable = (stable, middle) if grows(middle) else (middle, unstable)
    return unstable


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
        s: (f,) i omega, 1/s.
    """
    powers = np.stack([np.ones_like(s), s, s * s])
    return np.asarray(np.einsum("ejk,kf->fej", coefficients, powers), dtype=np.complex128)


def true_signals(model: LinearModel, contact: LinearContact, p: VehicleParameters, s: ComplexArray) -> ComplexArray:
    """Return u (f, signals) of the front wheelset per metre of alignment at s (f,), i omega."""
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
