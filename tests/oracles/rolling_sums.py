"""The sums that tell the rolling radius, piece by piece in arrays over the frequencies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.motion.checks import moving_samples, runs_backwards
from estimation.motion.integration import SignalParameters, segments
from estimation.motion.parameters import MOTION
from estimation.motion.rolling_sums import TERMS
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.roll_up import RollingSums
from estimation.values.units import GRAVITY
from estimation.values.windows import ACCELERATIONS, Window
from estimation.vehicle.linear_model import ComplexArray
from estimation.vehicle.vehicle_class import SensorLayout, VehicleClass


def rolling_sums(window: Window, vehicle_class: VehicleClass, signals: SignalParameters) -> tuple[RollingSums, ...]:
    """Return the sums of each part of a window, as the product's own does."""
    if vehicle_class.bogie is not None and window.frame_yaw_acceleration is None:
        return ()
    if runs_backwards(window):
        # With its rear end first a vehicle moves to the right when it yaws to the left.
        frame = window.frame_yaw_acceleration
        window = replace(
            window,
            yaw_acceleration=-window.yaw_acceleration,
            frame_yaw_acceleration=None if frame is None else -frame,
        )
    dt = window.sample_interval_s
    size, each = round(MOTION.piece_s / dt), round(MOTION.jackknife_part_s / dt)
    parts: dict[int, list[RollingSums]] = {}
    usable = moving_samples(window, signals)
    for first, behind in segments(usable, window, signals):
        samples = _bridged(window, usable, slice(first, behind))
        for start in range(0, behind - first - size + 1, size // 2):
            piece = _piece(samples[:, start : start + size], dt, _resolution_noise(window), vehicle_class)
            parts.setdefault((first + start) // each, []).append(piece)
    return tuple(
        RollingSums(np.sum([one.products for one in pieces], axis=0), np.sum([one.noise for one in pieces], axis=0))
        for _, pieces in sorted(parts.items())
    )


def _bridged(window: Window, usable: BoolArray, part: slice) -> FloatArray:
    """Return accelerations, the frame's and speed (6, m) of a part of a window, straight lines where any is missing."""
    known = np.flatnonzero(usable[part])
    at = np.arange(part.stop - part.start)
    frame = window.frame_yaw_acceleration
    rows = [getattr(window, name) for name in ACCELERATIONS]
    rows += [np.zeros(len(usable)) if frame is None else frame, window.speed]
    return np.stack([np.interp(at, known, row[part][known]) for row in rows])


def _resolution_noise(window: Window) -> FloatArray:
    """Return the squared noise density (4,) that counting makes of the accelerations."""
    return np.square(window.resolution) / 12.0 * 2.0 * window.sample_interval_s


def _piece(samples: FloatArray, dt: float, counting: FloatArray, vehicle_class: VehicleClass) -> RollingSums:
    """Return the sums of one piece, accelerations, the frame's and speed (6, m)."""
    n, speed = samples.shape[1], float(samples[5].mean())
    frequency = np.asarray(np.fft.rfftfreq(n, dt), dtype=np.float64)
    longest = speed / MOTION.wavelength_range[1]
    used = (frequency >= longest) & (frequency <= speed / MOTION.wavelength_range[0])
    omega = np.asarray(2.0 * np.pi * frequency[used])
    window = np.hanning(n)
    unit = 0.5 * n / dt * float(np.mean(window**2))  # of a squared spectrum per squared noise density
    yaw_rate = np.cumsum(samples[1]) - 0.5 * samples[1]
    rows = np.stack([samples[0], samples[5] * dt * _level(yaw_rate), samples[2], samples[3], samples[4]])
    moved = np.fft.rfft(_level(rows) * window)[:, used]
    moved[1] *= np.tan(0.5 * omega * dt) / (0.5 * omega * dt)  # the trapezoidal rule's shortfall
    terms = _terms(omega, speed, vehicle_class)
    values = np.einsum("kjf,jf->kf", terms, moved)
    noise = _noise(omega, speed, vehicle_class, counting)
    weight = 2.0 / _left(terms, noise, vehicle_class.parameters.nominal_radius)
    band = np.minimum(
        (
            MOTION.wavelength_bands
            * np.log(frequency[used] / longest)
            / np.log(MOTION.wavelength_range[1] / MOTION.wavelength_range[0])
        ),
        MOTION.wavelength_bands - 1,
    )
    share = weight * (band.astype(np.int64)[None, :] == np.arange(MOTION.wavelength_bands)[:, None])
    measured = np.einsum("if,jf->fij", values.conj(), values).real
    of_noise = np.einsum("iaf,jaf->fij", terms.conj() * noise, terms).real
    return RollingSums(np.tensordot(share / unit, measured, axes=1), np.tensordot(share, of_noise, axes=1))


def _densities(sensors: SensorLayout) -> FloatArray:
    """Return the squared noise densities (4,) of the sensors: on file, or usual ones where none is."""
    usual = (
        MOTION.usual_lateral_noise,
        MOTION.usual_angular_noise,
        MOTION.usual_angular_noise,
        MOTION.usual_lateral_noise,
    )
    rates = (False, sensors.yaw_is_gyroscope, sensors.roll_is_gyroscope, False)
    return np.square(
        [
            one.noise_density or (MOTION.usual_rate_noise if rate else density)
            for one, density, rate in zip(sensors.channels.values(), usual, rates, strict=True)
        ]
    )


def _per_density(omega: FloatArray, sensors: SensorLayout) -> FloatArray:
    """Return the accelerations (4, f) that a sensor's unit makes: of gyroscopes omega, of accelerometers one."""
    once, rate = np.ones_like(omega), np.maximum(omega, np.finfo(np.float64).tiny)
    return np.stack(
        [once, rate if sensors.yaw_is_gyroscope else once, rate if sensors.roll_is_gyroscope else once, once]
    )


def _level(values: FloatArray) -> FloatArray:
    """Return rows (..., n) without their mean and straight line."""
    n = values.shape[-1]
    centred = np.arange(n) - 0.5 * (n - 1)
    flat = values - values.mean(axis=-1, keepdims=True)
    return np.asarray(flat - np.multiply.outer(flat @ centred / (centred @ centred), centred))


def _terms(omega: FloatArray, speed: float, vehicle_class: VehicleClass) -> ComplexArray:
    """Return the terms (TERMS, 5, f) of the equation per spectrum of y'', V psi', phi'', ym'' and psi_f''."""
    p = vehicle_class.parameters
    compliance = speed / (2.0 * p.lateral_creep_coefficient)
    gravity = GRAVITY if vehicle_class.sensors.measures_gravity else 0.0
    terms = np.zeros((TERMS, 5, len(omega)), dtype=np.complex128)
    terms[0, 0], terms[0, 2] = 1.0, gravity / omega**2
    terms[0, 1] = p.lateral_spin_creep_coefficient / p.lateral_creep_coefficient * 1j * omega / speed
    terms[1, 1] = 1.0
    terms[2, 2] = -1.0
    lateral = terms[0] * np.array([1.0, 0.0, 1.0, 0.0, 0.0])[:, None]
    terms[3] = -compliance * p.wheelset_mass * 1j * omega * lateral
    suspension = -compliance * (p.lateral_stiffness / (1j * omega) + p.lateral_damping)
    terms[4, 0], terms[4, 3] = suspension, -suspension
    terms[5, 2] = -compliance * p.load / (1j * omega)
    # (rL - rR)'/(2 l) of Eq. 2, per spectrum: yaw inertia, creep and suspension, the gyroscopic moment, and the frame
    half, f11 = p.half_contact_distance, p.longitudinal_creep_coefficient
    difference = np.zeros((5, len(omega)), dtype=np.complex128)
    difference[1] = (p.yaw_stiffness + 1j * omega * p.yaw_damping - omega**2 * p.yaw_inertia) / speed
    difference[1] += 2.0 * half**2 * f11 * 1j * omega / speed**2
    difference[2] = p.pitch_inertia * speed / p.nominal_radius
    difference[4] = -p.yaw_stiffness / (1j * omega) - p.yaw_damping
    difference *= -p.nominal_radius / (half * f11) / (2.0 * half)
    terms[6] = -compliance * p.load * difference
    return terms


def _noise(omega: FloatArray, speed: float, vehicle_class: VehicleClass, counting: FloatArray) -> FloatArray:
    """Return the squared noise densities (5, f) of y'', V psi', phi'', ym'' and psi_f'', of sensors and counting."""
    sensors = vehicle_class.sensors
    squared = _densities(sensors)[:, None] * _per_density(omega, sensors) ** 2 + counting[:, None]
    squared[1] *= (speed / omega) ** 2
    bogie = vehicle_class.bogie
    of_frame = np.zeros_like(omega) if bogie is None else 2.0 * squared[3] / bogie.wheelbase**2
    return np.asarray(np.vstack([squared, of_frame]))


def _left(terms: ComplexArray, noise: FloatArray, radius: float) -> FloatArray:
    """Return the squared noise density (f,) of the equation at the parameters on file."""
    left = terms[0] - terms[1] - radius * terms[2] - terms[3] - terms[4] - terms[5]
    return np.asarray(np.einsum("jf,jf->f", np.abs(left) ** 2, noise))
