"""The linear model of a vehicle class: its modes with names, and the speed above which it hunts.

Small motion about the middle of a straight track at one speed. The columns of the matrices are the equations of
``regressors`` at unit states, so that they stay one definition. The contact geometry is that of one conicity:

    R = rL - rR = 2 gamma x,   S = rL + rR = 2 r0,   D = dL - dR = c R,   A = dL + dR,   phi = gamma x / l

with x = y - d. c is 1 / (delta0 Rw) for a wheel of transverse radius Rw that touches at the angle delta0
(A. H. Wickens, "Fundamentals of Rail Vehicle Dynamics", 2003, Chapter 2).

The lateral and the yaw equation of one wheelset as a filter of what its sensors measure.

    e(s) = E(s) u(s),   u = (y, psi, phi, ym, yn, x)

with s = i omega, ym the lateral position of what is above the wheelset, yn that above the other wheelset of the bogie
(0 without one), x = y - d. e is zero where parameters and contact geometry are right and nothing is noisy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from estimation.errors import ParameterError
from estimation.values.arrays import FloatArray
from estimation.values.units import GRAVITY
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.regressors import (
    ContactState,
    WheelsetState,
    lateral_acceleration,
    lateral_suspension_force,
    mass_lateral_acceleration,
    yaw_acceleration,
    yaw_suspension_moment,
)
from estimation.vehicle.vehicle_class import BogieParameters, SensorLayout, VehicleClass, VehicleParameters

ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class LinearContact:
    """Contact geometry of one conicity."""

    conicity: float = VEHICLE.usual_conicity  # gamma
    angle_per_difference: float = VEHICLE.angle_per_difference  # D/R, rad/m
    angle_sum: float = VEHICLE.angle_sum  # A, rad

    def __post_init__(self) -> None:
        if not self.conicity > 0.0:
            raise ParameterError(f"{self.conicity!r} is not positive", field="conicity")


@dataclass(frozen=True, slots=True)
class LinearModel:
    """State space of n coordinates, state [coordinates; their rates], driven by the alignment under k wheelsets."""

    speed: float  # m/s
    klingel_hz: float  # of a free wheelset that rolls without slip
    coordinates: tuple[str, ...]  # n
    matrix: FloatArray  # (2n, 2n)
    alignment_input: FloatArray  # (2n, k), of d, 1/s2 per m
    alignment_rate_input: FloatArray  # (2n, k), of d'
    wheelset_offsets: tuple[float, ...]  # k, m, behind the leading wheelset

    def response(self, frequency_hz: FloatArray) -> ComplexArray:
        """Return the coordinates (f, n) per metre of alignment under the leading wheelset."""
        n = len(self.coordinates)
        s = 2j * np.pi * frequency_hz
        delay = np.exp(-np.outer(s, np.array(self.wheelset_offsets) / self.speed))  # (f, k)
        drive = (self.alignment_input + s[:, None, None] * self.alignment_rate_input) @ delay[:, :, None]
        system = s[:, None, None] * np.eye(2 * n) - self.matrix
        return np.asarray(np.linalg.solve(system, drive)[:, :n, 0], dtype=np.complex128)


def klingel_wavelength(parameters: VehicleParameters, contact: LinearContact) -> float:
    """Return the wavelength of a free wheelset that rolls without slip, m (Klingel)."""
    return 2 * math.pi * math.sqrt(parameters.nominal_radius * parameters.half_contact_distance / contact.conicity)


def wheelset_accelerations(
    parameters: VehicleParameters, speed: float, contact: LinearContact, state: WheelsetState, alignment: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return y'' and psi'' (n,) on d and d' (2, n); the yaw spring is tied to a body that does not yaw."""
    x = np.asarray(state.lateral_displacement) - alignment[0]
    rate = np.asarray(state.lateral_velocity) - alignment[1]
    radius = contact.conicity * x
    angle = contact.angle_per_difference * radius
    roll = contact.conicity / parameters.half_contact_distance
    at = ContactState(
        rolling_radius_left=parameters.nominal_radius + radius,
        rolling_radius_right=parameters.nominal_radius - radius,
        contact_angle_left=contact.angle_sum / 2 + angle,
        contact_angle_right=contact.angle_sum / 2 - angle,
        roll=roll * x,
        roll_rate=roll * rate,
    )
    return lateral_acceleration(parameters, speed, state, at), yaw_acceleration(parameters, speed, state, at)


def assemble(
    accelerations: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
    speed: float,
    klingel_hz: float,
    coordinates: tuple[str, ...],
    wheelset_offsets: tuple[float, ...],
) -> LinearModel:
    """Return the state space of accelerations that are linear in coordinates, rates and alignment.

    Args:
        accelerations: Of (n, m) coordinates, (n, m) rates and (2k, m) alignments (d of each wheelset, then d'), (n, m).
    """
    n, k = len(coordinates), len(wheelset_offsets)
    units = np.eye(2 * n + 2 * k)
    columns = accelerations(units[:n], units[n : 2 * n], units[2 * n :])
    matrix = np.zeros((2 * n, 2 * n + 2 * k))
    matrix[:n, n : 2 * n] = np.eye(n)
    matrix[n:] = columns
    state, alignment, rate = matrix[:, : 2 * n], matrix[:, 2 * n : 2 * n + k], matrix[:, 2 * n + k :]
    return LinearModel(speed, klingel_hz, coordinates, state, alignment, rate, wheelset_offsets)


def single_wheelset_model(parameters: VehicleParameters, speed: float, contact: LinearContact) -> LinearModel:
    """Return the model of a wheelset and its suspended mass."""

    def accelerations(q: FloatArray, v: FloatArray, d: FloatArray) -> FloatArray:
        state = WheelsetState(q[0], v[0], q[1], v[1], q[2], v[2])
        lateral, yaw = wheelset_accelerations(parameters, speed, contact, state, d)
        return np.stack([lateral, yaw, mass_lateral_acceleration(parameters, state)])

    coordinates = "wheelset lateral", "wheelset yaw", "mass lateral"
    return assemble(accelerations, speed, speed / klingel_wavelength(parameters, contact), coordinates, (0.0,))


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
            above = q[4] + arm * q[5], v[4] + arm * v[5]  # the frame as the mass of the wheelset
            state = WheelsetState(q[at], v[at], q[at + 1], v[at + 1], *above)
            lateral, yaw = wheelset_accelerations(parameters, speed, contact, state, d[number::2])
            on_wheelset = lateral_suspension_force(parameters, state)
            turned = replace(state, yaw=q[at + 1] - q[5], yaw_rate=v[at + 1] - v[5])
            torsion = yaw_suspension_moment(parameters, turned)
            unyawing = yaw_suspension_moment(parameters, state)
            result[at] = lateral
            result[at + 1] = yaw + (torsion - unyawing) / parameters.yaw_inertia
            force = force - on_wheelset
            moment = moment - torsion - arm * on_wheelset
        result[4], result[5] = force / bogie.frame_mass, moment / bogie.frame_yaw_inertia
        return result

    klingel_hz = speed / klingel_wavelength(parameters, contact)
    return assemble(accelerations, speed, klingel_hz, COORDINATES, (0.0, bogie.wheelbase))


def _secondary(bogie: BogieParameters, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    force = bogie.secondary_lateral_stiffness * (q[6] - q[4]) + bogie.secondary_lateral_damping * (v[6] - v[4])
    moment = -bogie.secondary_yaw_stiffness * q[5] - bogie.secondary_yaw_damping * v[5]
    return force, moment


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
    """Return the modes, those that decay slowest first; a pair of conjugate eigenvalues is one mode."""
    # The name is that of the coordinate with the largest participation (product of left and right eigenvector; I. J.
    # Perez-Arriaga et al., IEEE Trans. Power Apparatus and Systems 101, 1982). A mode of the wheelsets that hardly
    # oscillates is one of creep; one up to twice Klingel's frequency is kinematic.
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
    if abs(value.real) > VEHICLE.creeping_damping_ratio * abs(value):
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
        return bool(np.linalg.eigvals(matrix).real.max() > VEHICLE.stable_growth)

    speeds = np.arange(VEHICLE.lowest_speed, VEHICLE.highest_speed + VEHICLE.speed_step, VEHICLE.speed_step)
    unstable = next((float(speed) for speed in speeds if grows(float(speed))), math.inf)
    if unstable in {VEHICLE.lowest_speed, math.inf}:
        return unstable
    stable = unstable - VEHICLE.speed_step
    while unstable - stable > VEHICLE.speed_tolerance:
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
    """Return E(s) (f, 2, signals) at s (f,), i omega."""
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
    """Return what sensors become of signals (f, sensors, signals), and signals of sensors (f, signals, sensors)."""
    # the second integrates, and takes gravity off the lateral signal by the roll
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
