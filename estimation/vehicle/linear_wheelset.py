"""A wheelset on its suspension, linearised: small motion about the middle of a straight track at one speed.

The columns of the matrices are the equations of ``equations_of_motion`` at unit states, so that they stay one
definition. The contact geometry is that of one equivalent conicity:

    R = rL - rR = 2 gamma x,   S = rL + rR = 2 r0,   D = dL - dR = c R,   A = dL + dR,   phi = gamma x / l

with x = y - d. c is 1 / (delta0 Rw) for a wheel of transverse radius Rw that touches at the angle delta0
(A. H. Wickens, "Fundamentals of Rail Vehicle Dynamics", 2003, Chapter 2).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.errors import ParameterError
from estimation.values.arrays import FloatArray
from estimation.vehicle.equations_of_motion import (
    ContactState,
    VehicleParameters,
    WheelsetState,
    lateral_acceleration,
    mass_lateral_acceleration,
    yaw_acceleration,
)

ComplexArray = npt.NDArray[np.complex128]
ANGLE_PER_DIFFERENCE = 67.0  # c, rad/m: touching at 1:20 on a tread of 300 mm
ANGLE_SUM = 0.1  # A, rad: twice 1:20


@dataclass(frozen=True, slots=True)
class LinearContact:
    """Contact geometry of one conicity.

    Raises:
        ParameterError: The conicity is not positive.
    """

    conicity: float = 0.2  # gamma
    angle_per_difference: float = ANGLE_PER_DIFFERENCE  # D/R, rad/m
    angle_sum: float = ANGLE_SUM  # A, rad

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


def klingel_frequency(parameters: VehicleParameters, speed: float, contact: LinearContact) -> float:
    """Return the frequency of a free wheelset that rolls without slip, Hz (Klingel: 2 pi sqrt(r0 l/gamma) long)."""
    return speed / klingel_wavelength(parameters, contact)


def klingel_wavelength(parameters: VehicleParameters, contact: LinearContact) -> float:
    """Return the wavelength of a free wheelset that rolls without slip, m."""
    return 2 * math.pi * math.sqrt(parameters.nominal_radius * parameters.half_contact_distance / contact.conicity)


def contact_state(
    contact: LinearContact, parameters: VehicleParameters, displacement: FloatArray, rate: FloatArray
) -> ContactState:
    """Return the contact geometry at x = y - d (n,), m, and x', m/s."""
    radius = contact.conicity * displacement
    angle = contact.angle_per_difference * radius
    roll = contact.conicity / parameters.half_contact_distance
    return ContactState(
        rolling_radius_left=parameters.nominal_radius + radius,
        rolling_radius_right=parameters.nominal_radius - radius,
        contact_angle_left=contact.angle_sum / 2 + angle,
        contact_angle_right=contact.angle_sum / 2 - angle,
        roll=roll * displacement,
        roll_rate=roll * rate,
    )


def wheelset_accelerations(
    parameters: VehicleParameters, speed: float, contact: LinearContact, state: WheelsetState, alignment: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return y'' and psi'' (n,) of a wheelset; its yaw spring is tied to a body that does not yaw.

    Args:
        alignment: (2, n) d in m and d' in m/s.
    """
    y, v = np.asarray(state.lateral_displacement), np.asarray(state.lateral_velocity)
    at = contact_state(contact, parameters, y - alignment[0], v - alignment[1])
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
    return assemble(accelerations, speed, klingel_frequency(parameters, speed, contact), coordinates, (0.0,))
