"""What the noise of a vehicle's sensors makes of its rolling radius difference."""

from __future__ import annotations

import math

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.vehicle.equations_of_motion import GRAVITY, RAIL_HEAD_RADIUS
from estimation.vehicle.vehicle_class import VehicleClass


def difference_noise(vehicle_class: VehicleClass, cutoff_wavelength: float) -> float:
    """Return the variance of rL - rR by the noise of the sensors, times the cube of the speed, m2 (m/s)3.

    The moment of the yaw spring takes nearly all of it: white noise of an acceleration, of density n, integrated twice
    and without what is slower than f_c = V / L, has the variance n^2 / (3 (2 pi)^4 f_c^3); that of a gyroscope,
    integrated once, n^2 / ((2 pi)^2 f_c), which is taken at 20 m/s. In a bogie the two sensors of the frame add theirs.

    Args:
        cutoff_wavelength: L, m, of the high-pass of the motion.
    """
    p, sensors = vehicle_class.parameters, vehicle_class.sensors
    per_yaw = p.yaw_stiffness * p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient)
    twice = cutoff_wavelength**3 / (3.0 * (2.0 * math.pi) ** 4)
    once = cutoff_wavelength * USUAL_SPEED**2 / (2.0 * math.pi) ** 2
    variance = (once if sensors.yaw_is_gyroscope else twice) * sensors.yaw.noise_density**2
    if vehicle_class.bogie is not None:
        variance += 2.0 * twice * (sensors.mass_lateral.noise_density / vehicle_class.bogie.wheelbase) ** 2
    return per_yaw**2 * variance


def usable_cutoff(vehicle_class: VehicleClass, longest: float) -> float:
    """Return the longest cut-off wavelength, m, at which the noise of the sensors leaves something of rL - rR.

    A stiff yaw spring turns the slow noise of the yaw sensor into rolling radius difference. Where that is large,
    longer waves hold noise alone. Shorter ones than ``SHORTEST_CUTOFF`` would not hold the displacement of a wheelset.

    Args:
        longest: m, where there is no such noise.
    """
    cutoff = longest
    while cutoff - CUTOFF_STEP >= SHORTEST_CUTOFF and _usual_noise(vehicle_class, cutoff) > MOST_DIFFERENCE_NOISE:
        cutoff -= CUTOFF_STEP
    return cutoff


def _usual_noise(vehicle_class: VehicleClass, cutoff_wavelength: float) -> float:
    return math.sqrt(difference_noise(vehicle_class, cutoff_wavelength) / USUAL_SPEED**3)


MOST_DIFFERENCE_NOISE = 0.3e-3  # m, std of rL - rR at the usual speed
CUTOFF_STEP = 5.0  # m
SHORTEST_CUTOFF = 30.0  # m
USUAL_SPEED = 20.0  # m/s


def displacement_noise(vehicle_class: VehicleClass, cutoff_wavelength: float, speed: FloatArray) -> FloatArray:
    """Return the variance (n,) of the lateral displacement by the noise of the sensors, m2.

    Of white noise of an acceleration, integrated twice, and of the roll, which is taken off at the height of the axle.
    Where gravity is taken out, g times the roll is integrated twice once more, which adds to the same error. A slow
    vehicle takes longer over a wave: twice integrated, the variance grows with the third power of its period, and that
    of g times the roll with the seventh.

    Args:
        cutoff_wavelength: m, of the high-pass of the motion.
        speed: (n,) m/s.
    """
    slowest = speed / cutoff_wavelength
    sensors, height = vehicle_class.sensors, vehicle_class.parameters.nominal_radius
    gravity = GRAVITY if sensors.measures_gravity else 0.0
    if not sensors.measures_gravity:
        height += RAIL_HEAD_RADIUS
    of_roll = 1 if sensors.roll_is_gyroscope else 2
    crossed = 2.0 * gravity * height * _integrated(of_roll + 1, slowest)
    both = height**2 * _integrated(of_roll, slowest) + crossed + gravity**2 * _integrated(of_roll + 2, slowest)
    return sensors.lateral.noise_density**2 * _integrated(2, slowest) + sensors.roll.noise_density**2 * both


def _integrated(times: int, slowest: FloatArray) -> FloatArray:
    """Return the variance (n,) of white noise of density one, integrated so often, of frequencies from ``slowest``."""
    order = 2 * times
    return np.asarray(1.0 / ((order - 1) * (2.0 * math.pi) ** order * slowest ** (order - 1)))
