"""The stationary Kalman-Bucy filter of a running gear: which forces at the contacts its accelerations show.

Unknown forces are states beside those of ``gear_equations``. Each is a Matern process of order 3/2: it has a
derivative, a standard deviation and a time of change, and is zero on average. Of the motion three things are measured:

- accelerations, with the noise density on file;
- that displacements and angles stay near the track: each is zero but for white noise, whose density puts the corner
  from which the filter believes the accelerations at ``FORCES.corner_wavelength``;
- that a wheelset rolls nearly where it points: psi - (y' + r0 phi')/V is the lateral creepage with the sign reversed,
  an Ornstein-Uhlenbeck process of ``FORCES.creepage_std``. No creep law and no friction is assumed.

Speeds differ little within a window; the gains are those of its mean speed. A fixed-interval smoother (Rauch, Tung and
Striebel 1965) with stationary gains goes back over the window.

``gear_equations`` are Newton's, linear in the states, the forces at the contacts their inputs: what the rails do to it
laterally, F (N), and the moment that they do about the vertical, M (N m). With (x_i) the place of an axle ahead of the
middle of its bogie's frame (y_f, psi_f), and y_b the body::

    m y_i''     = F_i + ky (y_f + x_i psi_f - y_i) + fy (their rates)
    I psi_i''   = M_i - k_psi (psi_i - psi_f) - f_psi (their rates)
    m_f y_f''   = -(sum of the suspensions' forces) + ks (y_b - y_f) + cs (y_b' - y_f'),     m_b y_b'' = the opposite
    I_f psi_f'' = -(sum of the suspensions' moments and of x_i times their forces) - k2 psi_f - c2 psi_f'

Without a bogie the mass above a single wheelset hangs on its springs alone and does not yaw (Eq. 3-5 of
``estimation.vehicle.regressors``). No speed, no creep law and no contact geometry is in these equations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
import scipy.linalg

from estimation.adhesion.parameters import FORCES
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.memory import MEMORY
from estimation.vehicle.vehicle_class import BogieParameters, SensorLayout, VehicleClass, VehicleParameters

AXLE = 4  # states of a wheelset: y, y', psi, psi'


@dataclass(frozen=True, slots=True)
class GearEquations(FrozenArrays):
    """Rates of n states of a running gear of a axles; SI.

    The first 4 a states are those of the wheelsets, then those of what is above; ``inputs`` are F and M of each axle.
    """

    rates: Annotated[FloatArray, "n", "n"]  # of the states by the states
    inputs: Annotated[FloatArray, "n", "2a"]  # of the states by F and M of each axle
    measured: Annotated[FloatArray, "3a", "n"]  # accelerations of the sensors, by the states: 2 a of wheelsets, a above
    measured_inputs: Annotated[FloatArray, "3a", "2a"]  # the same by the inputs
    anchored: tuple[int, ...]  # displacements and angles that nothing ties to the track
    angles: tuple[int, ...]  # those of them that are angles
    axles: int


def gear_equations(parameters: VehicleParameters, bogie: BogieParameters | None) -> GearEquations:
    """Return the equations of one running gear of a class."""
    places = (0.0,) if bogie is None else (0.5 * bogie.wheelbase, -0.5 * bogie.wheelbase)
    axles = len(places)
    above = AXLE * axles  # first state of the mass, or of frame (y, y', psi, psi') and body (y, y')
    n = above + (2 if bogie is None else 6)
    rates, inputs = np.zeros((n, n)), np.zeros((n, 2 * axles))
    for first in range(0, n, 2):
        rates[first, first + 1] = 1.0
    force, moment = np.zeros(n), np.zeros(n)
    for axle, place in enumerate(places):
        first = AXLE * axle
        lateral, yaw = _suspension(parameters, n, axle, None if bogie is None else place)
        per_mass, per_inertia = 1.0 / parameters.wheelset_mass, 1.0 / parameters.yaw_inertia
        rates[first + 1], rates[first + 3] = per_mass * lateral, per_inertia * yaw
        inputs[first + 1, 2 * axle], inputs[first + 3, 2 * axle + 1] = per_mass, per_inertia
        force += lateral
        moment += place * lateral + yaw
    if bogie is None:
        rates[above + 1] = -force / parameters.suspended_mass
    else:
        _carried(bogie, rates, force, moment, above)
    wheelsets = [AXLE * axle + row for axle in range(axles) for row in (1, 3)]
    nodes = [rates[above + 1] + (0.0 if bogie is None else place * rates[above + 3]) for place in places]
    sensors_above = np.zeros((axles, 2 * axles))
    return GearEquations(
        rates,
        inputs,
        np.concatenate([rates[wheelsets], np.stack(nodes)]),
        np.concatenate([inputs[wheelsets], sensors_above]),
        tuple(range(0, n, 2)),
        tuple([AXLE * axle + 2 for axle in range(axles)] + ([] if bogie is None else [above + 2])),
        axles,
    )


def _suspension(p: VehicleParameters, n: int, axle: int, place: float | None) -> tuple[FloatArray, FloatArray]:
    """Return force, N, and moment, N m, of the primary suspension on a wheelset, each (n,) by the states."""
    # `place` is None where what is above does not yaw
    first, above = AXLE * axle, n - (2 if place is None else 6)
    lateral, yaw = np.zeros(n), np.zeros(n)
    lateral[[above, first]] = p.lateral_stiffness, -p.lateral_stiffness
    lateral[[above + 1, first + 1]] = p.lateral_damping, -p.lateral_damping
    yaw[[first + 2, first + 3]] = -p.yaw_stiffness, -p.yaw_damping
    if place is not None:
        lateral[[above + 2, above + 3]] = place * p.lateral_stiffness, place * p.lateral_damping
        yaw[[above + 2, above + 3]] = p.yaw_stiffness, p.yaw_damping
    return lateral, yaw


def _carried(bogie: BogieParameters, rates: FloatArray, force: FloatArray, moment: FloatArray, above: int) -> None:
    body, stiffness, damping = above + 4, bogie.secondary_lateral_stiffness, bogie.secondary_lateral_damping
    secondary = np.zeros(len(rates))
    secondary[[body, above]] = stiffness, -stiffness
    secondary[[body + 1, above + 1]] = damping, -damping
    rates[above + 1] = (secondary - force) / bogie.frame_mass
    rates[body + 1] = -secondary / bogie.body_mass
    turned = np.zeros(len(rates))
    turned[[above + 2, above + 3]] = bogie.secondary_yaw_stiffness, bogie.secondary_yaw_damping
    rates[above + 3] = -(moment + turned) / bogie.frame_yaw_inertia


@dataclass(frozen=True, slots=True)
class StationaryFilter(FrozenArrays):
    """Matrices of n scaled states, k accelerations and m measurements, those first; ``scale`` makes states SI."""

    transition: Annotated[FloatArray, "n", "n"]  # over a sample
    measured: Annotated[FloatArray, "m", "n"]
    gain: Annotated[FloatArray, "n", "m"]
    back: Annotated[FloatArray, "n", "n"]  # of the smoother
    innovation_std: Annotated[FloatArray, "m"]
    scale: Annotated[FloatArray, "n"]
    axles: int  # a
    states: int  # of the running gear; F and M of each axle come behind them

    @property
    def accelerations(self) -> int:
        """How many accelerations are measured, k; they are the first measurements."""
        return 3 * self.axles


def stationary_filter(vehicle_class: VehicleClass, sample_interval_s: float, speed: float) -> StationaryFilter:
    """Return the filter of a class at a speed; a LinAlgError where it has no stationary one."""
    rounded = max(FORCES.speed_step, FORCES.speed_step * round(speed / FORCES.speed_step))
    gear = (vehicle_class.parameters, vehicle_class.bogie, vehicle_class.sensors)
    return _filter(*gear, sample_interval_s, rounded)


@lru_cache(maxsize=MEMORY.adhesion_filters)
def _filter(
    vehicle: VehicleParameters, bogie: BogieParameters | None, sensors: SensorLayout, dt: float, speed: float
) -> StationaryFilter:
    gear = gear_equations(vehicle, bogie)
    rates, noise, scale = _with_inputs(gear, vehicle.load)
    n = len(rates)
    rates, noise = rates * scale / scale[:, None], noise / np.outer(scale, scale)
    transition, process = over_a_sample(rates, noise, dt)
    process += FORCES.state_rounding * np.eye(n)
    rows = _measured(gear, n, speed) * scale
    wheelbase = None if bogie is None else bogie.wheelbase
    variance = _variances(gear, sensors, wheelbase, dt, 2.0 * math.pi * speed / FORCES.corner_wavelength)
    predicted = scipy.linalg.solve_discrete_are(transition.T, rows.T, process, np.diag(variance))
    innovation = rows @ predicted @ rows.T + np.diag(variance)
    gain = np.linalg.solve(innovation, rows @ predicted).T
    filtered = predicted - gain @ rows @ predicted
    return StationaryFilter(
        transition=transition,
        measured=rows,
        gain=np.asarray(gain, np.float64),
        back=np.asarray(np.linalg.solve(predicted, transition @ filtered).T, np.float64),
        innovation_std=np.sqrt(np.diag(innovation)),
        scale=scale,
        axles=gear.axles,
        states=len(gear.rates),
    )


def over_a_sample(rates: FloatArray, noise: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """Return transition and covariance (n, n) over ``dt``, driven by noise of an intensity (n, n) (Van Loan 1978)."""
    n = len(rates)
    block = scipy.linalg.expm(dt * np.block([[-rates, noise], [np.zeros((n, n)), rates.T]]))
    transition = np.ascontiguousarray(block[n:, n:].T)
    process = transition @ block[:n, n:]
    return transition, 0.5 * (process + process.T)


def _with_inputs(gear: GearEquations, load: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rates (n, n), noise intensity (n, n) and scale (n,) of states, forces, their derivatives and creepages."""
    own, forces = len(gear.rates), 2 * gear.axles
    n = own + 2 * forces + gear.axles
    rates, noise, scale = np.zeros((n, n)), np.zeros((n, n)), np.full(n, 1e-3)
    rates[:own, :own], rates[:own, own : own + forces] = gear.rates, gear.inputs
    corner = 1.0 / FORCES.force_change_s
    stds = load * np.array([FORCES.force_share, FORCES.moment_share] * gear.axles)
    for force, std in enumerate(stds):
        value, slope = own + force, own + forces + force
        rates[value, slope], rates[slope, value], rates[slope, slope] = 1.0, -(corner**2), -2.0 * corner
        noise[slope, slope] = 4.0 * corner**3 * std**2
        scale[value], scale[slope] = 1e3, 1e3 * corner
    for creepage in range(n - gear.axles, n):
        rates[creepage, creepage] = -1.0 / FORCES.creepage_change_s
        noise[creepage, creepage] = 2.0 * FORCES.creepage_std**2 / FORCES.creepage_change_s
        scale[creepage] = 1e-4
    return rates, noise, scale


def _measured(gear: GearEquations, n: int, speed: float) -> FloatArray:
    own, forces = len(gear.rates), 2 * gear.axles
    accelerations = np.zeros((len(gear.measured), n))
    accelerations[:, :own], accelerations[:, own : own + forces] = gear.measured, gear.measured_inputs
    rolling = np.zeros((gear.axles, n))
    for axle in range(gear.axles):
        rolling[axle, [AXLE * axle + 2, AXLE * axle + 1, n - gear.axles + axle]] = 1.0, -1.0 / speed, 1.0
    return np.concatenate([accelerations, np.eye(n)[list(gear.anchored)], rolling])


def _variances(
    gear: GearEquations, sensors: SensorLayout, wheelbase: float | None, dt: float, corner: float
) -> FloatArray:
    """Return the variance (m,) of each measurement, sample by sample; ``corner`` is an angular frequency, 1/s."""
    on_wheelset = [sensors.lateral.noise_density, sensors.yaw.noise_density] * gear.axles
    above = [sensors.mass_lateral.noise_density] * gear.axles
    wheelsets = AXLE * gear.axles
    drift = []
    for place in gear.anchored:
        turned = place in gear.angles
        if place < wheelsets:
            drift.append(on_wheelset[int(turned)])
        else:
            drift.append(above[0] * (math.sqrt(2.0) / wheelbase if turned and wheelbase else 1.0))
    density = np.maximum([*on_wheelset, *above], FORCES.least_noise_density)
    anchors = np.maximum(drift, FORCES.least_noise_density) / corner**2
    rolling = np.full(gear.axles, FORCES.rolling_angle_std**2)
    return np.concatenate([density**2 / (2.0 * dt), anchors**2 / (2.0 * dt), rolling])
