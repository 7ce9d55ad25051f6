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

import numpy as np

from estimation.motion.integration import bridged, segments
from estimation.motion.parameters import SignalParameters
from estimation.motion.rolling_kernels import ROWS, TERMS, Equation, add_spectra, mirror, write_pieces
from estimation.motion.travel import runs_backwards, turned_over
from estimation.motion.usable_samples import moving_samples
from estimation.values.arrays import BoolArray, FloatArray, IntArray, frozen_array
from estimation.values.rolling_sums import RollingSums
from estimation.values.windows import ACCELERATIONS, Window
from estimation.vehicle.equations_of_motion import GRAVITY
from estimation.vehicle.vehicle_class import SensorLayout, VehicleClass

WAVELENGTHS = (2.5, 10.0)  # m: shorter ones are axle box vibration, longer ones noise
BANDS = 6  # of equal ratio, longest wavelengths first
PIECE_S = 8.0  # half of one overlaps the next
TOGETHER = 4  # pieces that are transformed at once: what fits into the cache of a processor
PART_S = 15.0  # of a window: what is left out as one by the jackknife
USUAL_LATERAL, USUAL_ANGULAR = 1e-3, 2e-3  # m/s2 and rad/s2 per root hertz: MEMS sensors, where nothing is on file
USUAL_RATE = 1e-4  # rad/s per root hertz, of a gyroscope
UNKNOWNS = ("scale", "radius", "inertia", "suspension", "gravity", "curve")


def rolling_sums(window: Window, vehicle_class: VehicleClass, signals: SignalParameters) -> tuple[RollingSums, ...]:
    """Return the sums of each part of a window that has pieces without gaps.

    Args:
        window: Measured accelerations and speed, (n,) each; in a bogie with the yaw of its frame, else it says nothing.
        vehicle_class: Of its vehicle, with the nominal radius on file of its wheelset.
        signals: Least speed, and how long gaps may be that straight lines bridge.
    """
    if vehicle_class.bogie is not None and window.frame_yaw_acceleration is None:
        return ()
    if runs_backwards(window):
        window = turned_over(window)
    dt = window.sample_interval_s
    size, each = round(PIECE_S / dt), round(PART_S / dt)
    usable = moving_samples(window, signals)
    samples, starts = [], []
    for first, behind in segments(usable, window, signals):
        samples.append((first, _bridged(window, usable, slice(first, behind))))
        starts.append(np.arange(0, behind - first - size + 1, size // 2))
    parts = [first + at for (first, _), of in zip(samples, starts, strict=True) for at in of]
    numbers = sorted({place // each for place in parts})
    products, noise = np.zeros((2, len(numbers), BANDS, TERMS, TERMS))
    for (first, rows), at in zip(samples, starts, strict=True):
        part = np.searchsorted(numbers, (first + at) // each)
        _add(rows, at, part, window, vehicle_class, size, products, noise)
    mirror(products)
    mirror(noise)
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
    """Add the pieces of a segment, accelerations and speed (6, m), that begin at ``starts`` to their parts."""
    dt, taper = window.sample_interval_s, _taper(size)
    unit = 0.5 * size / dt * float(np.mean(taper**2))  # of a squared spectrum per squared noise density
    densities = _densities(vehicle_class.sensors), _resolution_noise(window)
    place = (dt, size, unit, _equation(vehicle_class), *densities, WAVELENGTHS)
    for first in range(0, len(starts), TOGETHER):
        some = slice(first, first + TOGETHER)
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
        lateral_creep=p.lateral_creep_coefficient,
        spin_creep=p.lateral_spin_creep_coefficient,
        mass=p.wheelset_mass,
        lateral_stiffness=p.lateral_stiffness,
        lateral_damping=p.lateral_damping,
        load=p.load,
        radius=p.nominal_radius,
        half=half,
        per_moment=p.nominal_radius / (half * longitudinal),
        yaw_inertia=p.yaw_inertia,
        yaw_creep=2.0 * half**2 * longitudinal,
        yaw_stiffness=p.yaw_stiffness,
        yaw_damping=p.yaw_damping,
        pitch=p.pitch_inertia / p.nominal_radius,
        wheelbase=math.inf if vehicle_class.bogie is None else vehicle_class.bogie.wheelbase,
        gravity=GRAVITY if sensors.measures_gravity else 0.0,
        yaw_is_gyroscope=sensors.yaw_is_gyroscope,
        roll_is_gyroscope=sensors.roll_is_gyroscope,
    )


def _bridged(window: Window, usable: BoolArray, part: slice) -> FloatArray:
    """Return accelerations, the frame's and speed (6, m) of a part of a window, straight lines where any is missing."""
    frame = window.frame_yaw_acceleration
    accelerations = [getattr(window, name) for name in ACCELERATIONS]
    rows = (*accelerations, np.zeros(len(usable)) if frame is None else frame, window.speed)
    return np.stack([bridged(row[part], usable[part]) for row in rows])


def _resolution_noise(window: Window) -> FloatArray:
    """Return the squared noise density (4,) that counting makes of the accelerations."""
    return np.square(window.resolution) / 12.0 * 2.0 * window.sample_interval_s


def _densities(sensors: SensorLayout) -> FloatArray:
    """Return the squared noise densities (4,) of the sensors: on file, or usual ones where none is."""
    usual = (USUAL_LATERAL, USUAL_ANGULAR, USUAL_ANGULAR, USUAL_LATERAL)
    rates = (False, sensors.yaw_is_gyroscope, sensors.roll_is_gyroscope, False)
    return np.square(
        [
            one.noise_density or (USUAL_RATE if rate else density)
            for one, density, rate in zip(sensors.channels.values(), usual, rates, strict=True)
        ]
    )
