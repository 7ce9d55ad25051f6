"""The stationary Kalman-Bucy filter of a running gear: which forces at the contacts its accelerations show.

Unknown forces are states beside those of ``gear_equations``. Each is a Matern process of order 3/2: it has a
derivative, a standard deviation and a time of change, and is zero on average. Of the motion three things are measured:

- accelerations, with the noise density on file;
- that displacements and angles stay near the track: each is zero but for white noise, whose density puts the corner
  from which the filter believes the accelerations at ``corner_wavelength``;
- that a wheelset rolls nearly where it points: psi - (y' + r0 phi')/V is the lateral creepage with the sign reversed,
  an Ornstein-Uhlenbeck process of ``creepage_std``. No creep law and no friction is assumed.

Speeds differ little within a window; the gains are those of its mean speed. A fixed-interval smoother (Rauch, Tung and
Striebel 1965) with stationary gains goes back over the window.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg

from estimation.adhesion.gear_equations import AXLE, GearEquations, gear_equations
from estimation.values.arrays import FloatArray, frozen_array
from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.vehicle_class import BogieParameters, SensorLayout, VehicleClass

SPEED_STEP = 0.5  # m/s, to which the mean speed of a window is rounded
LEAST_DENSITY = 1e-5  # m/s2 or rad/s2 per root hertz: of sensors that have no noise on file
ROUNDING = 1e-13  # of the scaled states, which keeps the covariance positive
KEPT = 32  # filters


@dataclass(frozen=True, slots=True)
class FilterParameters:
    """What is known of forces and creepages beforehand.

    The forces are in parts of the load on a wheelset; 1 m stands for the arm of the moment.
    """

    force_share: float = 0.02
    moment_share: float = 0.075
    change_s: float = 0.02  # of a force
    creepage_std: float = 1e-4  # 1
    creepage_change_s: float = 0.15
    kinematic_std: float = 2e-5  # 1, white, of the angle of rolling
    corner_wavelength: float = 130.0  # m


@dataclass(frozen=True, slots=True)
class StationaryFilter:
    """Matrices of n scaled states, k accelerations and m measurements, those first; ``scale`` makes states SI."""

    transition: FloatArray  # (n, n) over a sample
    measured: FloatArray  # (m, n)
    gain: FloatArray  # (n, m)
    back: FloatArray  # (n, n) of the smoother
    innovation_std: FloatArray  # (m,)
    scale: FloatArray  # (n,)
    axles: int  # a
    states: int  # of the running gear; F and M of each axle come behind them

    def __post_init__(self) -> None:
        n, m = self.gain.shape
        shapes = {
            "transition": (n, n),
            "measured": (m, n),
            "gain": (n, m),
            "back": (n, n),
            "innovation_std": (m,),
            "scale": (n,),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape, name=name))

    @property
    def accelerations(self) -> int:
        """How many accelerations are measured, k; they are the first measurements."""
        return 3 * self.axles


def stationary_filter(
    vehicle_class: VehicleClass, sample_interval_s: float, speed: float, parameters: FilterParameters
) -> StationaryFilter:
    """Return the filter of a class at a speed.

    Args:
        sample_interval_s: Between samples, s.
        speed: Mean speed of the window, m/s; rounded.
        parameters: What is known of the forces.

    Raises:
        numpy.linalg.LinAlgError: The class has no stationary filter.
    """
    rounded = max(SPEED_STEP, SPEED_STEP * round(speed / SPEED_STEP))
    gear = (vehicle_class.parameters, vehicle_class.bogie, vehicle_class.sensors)
    return _filter(*gear, sample_interval_s, rounded, parameters)


@lru_cache(maxsize=KEPT)
def _filter(
    vehicle: VehicleParameters,
    bogie: BogieParameters | None,
    sensors: SensorLayout,
    dt: float,
    speed: float,
    known: FilterParameters,
) -> StationaryFilter:
    gear = gear_equations(vehicle, bogie)
    rates, noise, scale = _with_inputs(gear, vehicle.load, known)
    n = len(rates)
    rates, noise = rates * scale / scale[:, None], noise / np.outer(scale, scale)
    # Van Loan 1978: transition and covariance over a sample from one exponential
    block = scipy.linalg.expm(dt * np.block([[-rates, noise], [np.zeros((n, n)), rates.T]]))
    transition = np.ascontiguousarray(block[n:, n:].T)
    process = transition @ block[:n, n:]
    process = 0.5 * (process + process.T) + ROUNDING * np.eye(n)
    rows = _measured(gear, n, speed) * scale
    wheelbase = None if bogie is None else bogie.wheelbase
    variance = _variances(gear, sensors, wheelbase, dt, 2.0 * math.pi * speed / known.corner_wavelength, known)
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


def _with_inputs(
    gear: GearEquations, load: float, known: FilterParameters
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rates (n, n), noise intensity (n, n) and scale (n,) of states, forces, their derivatives and creepages."""
    own, forces = len(gear.rates), 2 * gear.axles
    n = own + 2 * forces + gear.axles
    rates, noise, scale = np.zeros((n, n)), np.zeros((n, n)), np.full(n, 1e-3)
    rates[:own, :own], rates[:own, own : own + forces] = gear.rates, gear.inputs
    corner = 1.0 / known.change_s
    stds = load * np.array([known.force_share, known.moment_share] * gear.axles)
    for force, std in enumerate(stds):
        value, slope = own + force, own + forces + force
        rates[value, slope], rates[slope, value], rates[slope, slope] = 1.0, -(corner**2), -2.0 * corner
        noise[slope, slope] = 4.0 * corner**3 * std**2
        scale[value], scale[slope] = 1e3, 1e3 * corner
    for creepage in range(n - gear.axles, n):
        rates[creepage, creepage] = -1.0 / known.creepage_change_s
        noise[creepage, creepage] = 2.0 * known.creepage_std**2 / known.creepage_change_s
        scale[creepage] = 1e-4
    return rates, noise, scale


def _measured(gear: GearEquations, n: int, speed: float) -> FloatArray:
    """Return the rows (m, n) of what is measured: accelerations, places, and where wheelsets roll."""
    own, forces = len(gear.rates), 2 * gear.axles
    accelerations = np.zeros((len(gear.measured), n))
    accelerations[:, :own], accelerations[:, own : own + forces] = gear.measured, gear.measured_inputs
    rolling = np.zeros((gear.axles, n))
    for axle in range(gear.axles):
        rolling[axle, [AXLE * axle + 2, AXLE * axle + 1, n - gear.axles + axle]] = 1.0, -1.0 / speed, 1.0
    return np.concatenate([accelerations, np.eye(n)[list(gear.anchored)], rolling])


def _variances(
    gear: GearEquations,
    sensors: SensorLayout,
    wheelbase: float | None,
    dt: float,
    corner: float,
    known: FilterParameters,
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
    density = np.maximum([*on_wheelset, *above], LEAST_DENSITY)
    anchors = np.maximum(drift, LEAST_DENSITY) / corner**2
    rolling = np.full(gear.axles, known.kinematic_std**2)
    return np.concatenate([density**2 / (2.0 * dt), anchors**2 / (2.0 * dt), rolling])
