"""The linear model of a vehicle class: its modes with names, and the speed above which it hunts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.vehicle.linear_bogie import bogie_model
from estimation.vehicle.linear_wheelset import LinearContact, LinearModel, single_wheelset_model
from estimation.vehicle.vehicle_class import VehicleClass

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
    """Return the state space of a class.

    Args:
        vehicle_class: Single wheelset or bogie.
        speed: V, m/s, positive.
        contact: The geometry of all its wheelsets.
    """
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
    """Return the lowest speed, m/s, above which a mode grows; infinite where none does up to 150 m/s.

    Args:
        vehicle_class: Single wheelset or bogie.
        contact: The geometry of all its wheelsets.
    """

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
