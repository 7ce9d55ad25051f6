"""What a window says of the rolling radius: sums of products of what moves a wheelset sideways at the rails.

A wheelset that rolls moves sideways at the rails, r below its axle, as its yaw and the lateral creep let it. Eq. 1
solved for the velocity there, and differentiated, is

    y'' = s V psi' - r phi'' - (f23/f22) psi''
          - (V/(2 f22)) (a m y''' + b (ky (y' - ym') + fy (y'' - ym'')) + c W phi' + g W R'/(2 l))

with six unknowns: the scale s of yaw against lateral sensor, the radius r, the factors a, b and c of inertia,
suspension and gravity, and g of the contact angles: dL - dR goes with the roll where contact is straight, and with
R = rL - rR where it is curved, which Eq. 2 has of the yaw; in a bogie that needs the yaw of its frame. The track takes
no part, so that this holds on any track. The sums are taken over Fourier transforms of short pieces, by wavelength,
beside the sums that the noise of the sensors makes of them.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from estimation.compiled import compiled
from estimation.motion.axle_distance import turned_over
from estimation.motion.checks import moving_samples, runs_backwards
from estimation.motion.integration import SignalParameters, bridged, segments
from estimation.motion.parameters import MOTION
from estimation.values.arrays import BoolArray, FloatArray, IntArray, frozen_array
from estimation.values.roll_up import RollingSums
from estimation.values.units import GRAVITY
from estimation.values.windows import ACCELERATIONS, Window
from estimation.vehicle.linear_model import ComplexArray
from estimation.vehicle.vehicle_class import SensorLayout, VehicleClass

ROWS = 5  # spectra: y'', V psi', phi'', ym'' and psi_f'' of the bogie frame
TERMS = 7  # the lateral acceleration, then the unknowns


class Equation(NamedTuple):
    """What the terms of the equation and their noise follow from."""

    lateral_creep_coefficient: float  # as ``VehicleParameters`` names them, to the nominal radius
    lateral_spin_creep_coefficient: float
    wheelset_mass: float
    lateral_stiffness: float
    lateral_damping: float
    load: float
    half_contact_distance: float
    yaw_inertia: float
    yaw_stiffness: float
    yaw_damping: float
    nominal_radius: float
    per_moment: float  # r0/(l f11), m/(N m): of rL - rR
    yaw_creep: float  # 2 l^2 f11, N m2: times psi'/V
    pitch: float  # Iwy/r0, kg m: times V phi'
    wheelbase: float  # m; infinite without a bogie
    gravity: float  # m/s2 in the lateral sensors; 0 where it is not
    yaw_is_gyroscope: bool
    roll_is_gyroscope: bool


@compiled(nogil=True)
def level(row: FloatArray) -> None:
    """Take mean and straight line from a row (n,)."""
    n = len(row)
    middle = 0.5 * (n - 1)
    total, moment = 0.0, 0.0
    for i in range(n):
        total += row[i]
        moment += row[i] * (i - middle)
    mean, slope = total / n, moment / (n * (n * n - 1.0) / 12.0)
    for i in range(n):
        row[i] -= mean + slope * (i - middle)


@compiled(nogil=True)
def write_pieces(
    samples: FloatArray, starts: IntArray, dt: float, taper: FloatArray, pieces: FloatArray, speeds: FloatArray
) -> None:
    """Write the rows of each piece (k, 5, n), level and tapered, and its mean speed, of samples (6, m)."""
    n = len(taper)
    yaw_rate = np.empty(n)
    for k in range(len(starts)):
        first = starts[k]
        rate, speed = 0.0, 0.0
        for i in range(n):
            yaw = samples[1, first + i]
            rate += yaw
            yaw_rate[i] = rate - 0.5 * yaw
            speed += samples[5, first + i]
        speeds[k] = speed / n
        level(yaw_rate)
        for i in range(n):
            pieces[k, 0, i] = samples[0, first + i]
            pieces[k, 1, i] = samples[5, first + i] * dt * yaw_rate[i]
            pieces[k, 2, i] = samples[2, first + i]
            pieces[k, 3, i] = samples[3, first + i]
            pieces[k, 4, i] = samples[4, first + i]
        for r in range(ROWS):
            level(pieces[k, r])
            for i in range(n):
                pieces[k, r, i] *= taper[i]


@compiled(nogil=True)
def write_terms(omega: float, speed: float, e: Equation, terms: ComplexArray) -> None:
    """Write the terms (7, 5) of the equation per spectrum at an angular frequency; the others stay zero."""
    compliance = speed / (2.0 * e.lateral_creep_coefficient)
    terms[0, 0], terms[0, 2] = 1.0, e.gravity / omega**2
    terms[0, 1] = e.lateral_spin_creep_coefficient / e.lateral_creep_coefficient * 1j * omega / speed
    terms[1, 1], terms[2, 2] = 1.0, -1.0
    inertia = -compliance * e.wheelset_mass * 1j * omega
    terms[3, 0], terms[3, 2] = inertia * terms[0, 0], inertia * terms[0, 2]
    suspension = -compliance * (e.lateral_stiffness / (1j * omega) + e.lateral_damping)
    terms[4, 0], terms[4, 3] = suspension, -suspension
    terms[5, 2] = -compliance * e.load / (1j * omega)
    curve = compliance * e.load * e.per_moment / (2.0 * e.half_contact_distance)
    of_yaw = e.yaw_stiffness - e.yaw_inertia * omega**2 + 1j * omega * (e.yaw_creep / speed + e.yaw_damping)
    terms[6, 1], terms[6, 2] = curve * of_yaw / speed, curve * e.pitch * speed
    terms[6, 4] = -curve * (e.yaw_stiffness / (1j * omega) + e.yaw_damping)


@compiled(nogil=True)
def write_noise(
    omega: float, speed: float, e: Equation, density: FloatArray, counting: FloatArray, noise: FloatArray
) -> None:
    """Write the squared noise densities (5,) of the spectra, of sensors and counting."""
    for j in range(ROWS - 1):
        rate = (j == 1 and e.yaw_is_gyroscope) or (j == 2 and e.roll_is_gyroscope)  # noqa: PLR2004 - the rows
        noise[j] = density[j] * (omega**2 if rate else 1.0) + counting[j]
    noise[1] *= (speed / omega) ** 2
    noise[4] = 2.0 * noise[3] / e.wheelbase**2


@compiled(nogil=True)
def left_noise(terms: ComplexArray, noise: FloatArray, radius: float) -> float:
    """Return the squared noise density of the equation at the parameters on file."""
    total = 0.0
    for j in range(ROWS):
        left = terms[0, j] - terms[1, j] - radius * terms[2, j] - terms[3, j] - terms[4, j] - terms[5, j]
        total += (left.real**2 + left.imag**2) * noise[j]
    return total


@compiled(nogil=True)
def add_spectra(
    spectra: ComplexArray, speeds: FloatArray, part: IntArray, dt: float, samples: int, unit: float, e: Equation,
    density: FloatArray, counting: FloatArray, wavelengths: tuple[float, float],
    products: FloatArray, of_noise: FloatArray,
) -> None:  # fmt: skip
    """Add the products of the terms of every piece to those of its part (parts, bands, 7, 7), and what noise makes.

    Args:
        spectra, speeds: (k, 5, f) of the pieces, and (k,) their mean speeds, m/s.
        wavelengths: The shortest and the longest that are looked at, m.
    """
    terms, noise = np.zeros((TERMS, ROWS), np.complex128), np.empty(ROWS)
    values, moved = np.empty(TERMS, np.complex128), np.empty(ROWS, np.complex128)
    bands = products.shape[1]
    ratio = math.log(wavelengths[1] / wavelengths[0])
    for k in range(len(spectra)):
        longest, shortest = speeds[k] / wavelengths[1], speeds[k] / wavelengths[0]
        for f in range(1, spectra.shape[2]):
            frequency = f / (samples * dt)
            if not longest <= frequency <= shortest:
                continue
            omega = 2.0 * math.pi * frequency
            write_terms(omega, speeds[k], e, terms)
            write_noise(omega, speeds[k], e, density, counting, noise)
            for j in range(ROWS):
                moved[j] = spectra[k, j, f]
            moved[1] *= math.tan(0.5 * omega * dt) / (0.5 * omega * dt)  # the trapezoidal rule's shortfall
            weight = 2.0 / left_noise(terms, noise, e.nominal_radius)
            band = min(int(bands * math.log(frequency / longest) / ratio), bands - 1)
            for a in range(TERMS):
                values[a] = 0.0
                for j in range(ROWS):
                    values[a] += terms[a, j] * moved[j]
            for a in range(TERMS):
                for b in range(a, TERMS):
                    product = values[a].real * values[b].real + values[a].imag * values[b].imag
                    products[part[k], band, a, b] += weight / unit * product
                    expected = 0.0
                    for j in range(ROWS):
                        one, other = terms[a, j], terms[b, j]
                        expected += noise[j] * (one.real * other.real + one.imag * other.imag)
                    of_noise[part[k], band, a, b] += weight * expected


UNKNOWNS = ("scale", "radius", "inertia", "suspension", "gravity", "curve")


def rolling_sums(window: Window, vehicle_class: VehicleClass, signals: SignalParameters) -> tuple[RollingSums, ...]:
    """Return the sums of each part of a window that has pieces without gaps; none in a bogie of unknown frame yaw."""
    if vehicle_class.bogie is not None and window.frame_yaw_acceleration is None:
        return ()
    if runs_backwards(window):
        window = turned_over(window)
    dt = window.sample_interval_s
    size, each = round(MOTION.piece_s / dt), round(MOTION.jackknife_part_s / dt)
    usable = moving_samples(window, signals)
    samples, starts = [], []
    for first, behind in segments(usable, window, signals):
        samples.append((first, _bridged(window, usable, slice(first, behind))))
        starts.append(np.arange(0, behind - first - size + 1, size // 2))
    parts = [first + at for (first, _), of in zip(samples, starts, strict=True) for at in of]
    numbers = sorted({place // each for place in parts})
    products, noise = np.zeros((2, len(numbers), MOTION.wavelength_bands, TERMS, TERMS))
    for (first, rows), at in zip(samples, starts, strict=True):
        part = np.searchsorted(numbers, (first + at) // each)
        _add(rows, at, part, window, vehicle_class, size, products, noise)
    above, below = np.triu_indices(TERMS, 1)
    for sums in (products, noise):
        sums[..., below, above] = sums[..., above, below]
    return tuple(RollingSums(*both) for both in zip(products, noise, strict=True))


def _add(
    rows: FloatArray,
    starts: IntArray,
    part: IntArray,
    window: Window,
    vehicle_class: VehicleClass,
    size: int,
    products: FloatArray,
    noise: FloatArray,
) -> None:
    dt, taper = window.sample_interval_s, _taper(size)
    unit = 0.5 * size / dt * float(np.mean(taper**2))  # of a squared spectrum per squared noise density
    densities = _densities(vehicle_class.sensors), _resolution_noise(window)
    place = (dt, size, unit, _equation(vehicle_class), *densities, MOTION.wavelength_range)
    for first in range(0, len(starts), MOTION.pieces_together):
        some = slice(first, first + MOTION.pieces_together)
        speeds = np.empty(len(starts[some]))
        pieces = np.empty((len(speeds), ROWS, size))
        write_pieces(rows, starts[some], dt, taper, pieces, speeds)
        add_spectra(np.fft.rfft(pieces), speeds, part[some], *place, products, noise)


@lru_cache(maxsize=4)
def _taper(size: int) -> FloatArray:
    return frozen_array(np.hanning(size), (size,), name="taper")


def _equation(vehicle_class: VehicleClass) -> Equation:
    p, sensors = vehicle_class.parameters, vehicle_class.sensors
    half, longitudinal = p.half_contact_distance, p.longitudinal_creep_coefficient
    return Equation(
        **{name: getattr(p, name) for name in Equation._fields if hasattr(p, name)},
        per_moment=p.nominal_radius / (half * longitudinal),
        yaw_creep=2.0 * half**2 * longitudinal,
        pitch=p.pitch_inertia / p.nominal_radius,
        wheelbase=math.inf if vehicle_class.bogie is None else vehicle_class.bogie.wheelbase,
        gravity=GRAVITY if sensors.measures_gravity else 0.0,
        yaw_is_gyroscope=sensors.yaw_is_gyroscope,
        roll_is_gyroscope=sensors.roll_is_gyroscope,
    )


def _bridged(window: Window, usable: BoolArray, part: slice) -> FloatArray:
    frame = window.frame_yaw_acceleration
    accelerations = [getattr(window, name) for name in ACCELERATIONS]
    rows = (*accelerations, np.zeros(len(usable)) if frame is None else frame, window.speed)
    return np.stack([bridged(row[part], usable[part]) for row in rows])


def _resolution_noise(window: Window) -> FloatArray:
    """Return the squared noise density (4,) that counting makes of the accelerations."""
    return np.square(window.resolution) / 12.0 * 2.0 * window.sample_interval_s


def _densities(sensors: SensorLayout) -> FloatArray:
    lateral, angular, rate = MOTION.usual_lateral_noise, MOTION.usual_angular_noise, MOTION.usual_rate_noise
    yaw, roll = (rate if gyro else angular for gyro in (sensors.yaw_is_gyroscope, sensors.roll_is_gyroscope))
    channels = zip(sensors.channels.values(), (lateral, yaw, roll, lateral), strict=True)
    return np.square([channel.noise_density or usual for channel, usual in channels])
