"""What the rails do to the wheelsets of a running gear, from its accelerations by Newton's equations.

The filter knows no creep law, no track and no contact geometry: a force is what the motion needs. Of each wheelset it
gives the lateral force at the contacts (creep and gravitational stiffness together) and the moment of the creep forces
about the vertical,

    M_creep = I psi'' + k_psi (psi - psi_f) + f_psi (psi' - psi_f') + (Iwy V/r0) phi'

whose gravitational part (l W/2) A psi is below a hundredth of it. A filter whose innovations are far larger than it
expects does not follow the vehicle: ``diverged``, and nothing is published.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np

from estimation.adhesion.parameters import FORCES
from estimation.adhesion.stationary_filter import AXLE, StationaryFilter, stationary_filter
from estimation.compiled import compiled
from estimation.filters import remove_wander
from estimation.motion.checks import moving_samples
from estimation.motion.integration import IntegratedSegment, SignalParameters, integrate
from estimation.motion.parameters import MOTION
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray, frozen_array
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import GRAVITY
from estimation.values.windows import ACCELERATIONS, Window
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, SensorLayout, VehicleClass, VehicleParameters

ROLL, LATERAL, YAW, MASS = (
    ACCELERATIONS.index(f"{name}_acceleration") for name in ("roll", "lateral", "yaw", "mass_lateral")
)


@dataclass(frozen=True, slots=True)
class GearSegment(FrozenArrays):
    """A segment of m samples of all a wheelsets of a running gear.

    The accelerations are lateral and yaw of each axle, then the lateral ones above; 0 where they are not known.
    """

    axles: tuple[IntegratedSegment, ...]
    rolls: tuple[FloatArray, ...]  # (m,) rad, of each
    accelerations: Annotated[FloatArray, "3a", "m"]  # without gravity and means


@dataclass(frozen=True, slots=True)
class GearSegments(FrozenArrays):
    """All segments of the windows of a running gear."""

    segments: tuple[GearSegment, ...]
    usable: Annotated[BoolArray, None]  # samples of the windows
    sample_interval_s: float
    axles: int


def gear_segments(
    windows: Sequence[Window], vehicle_class: VehicleClass, signals: SignalParameters
) -> GearSegments | Reason:
    """Return the segments of windows (n,) of one time, of a wheelset or of both of a bogie, or why there are none."""
    axles = 1 if vehicle_class.bogie is None else AXLES_OF_A_BOGIE
    if len(windows) != axles or len({(window.start_ns, len(window.valid)) for window in windows}) != 1:
        raise ValueError(f"{len(windows)} windows for a running gear of {axles} wheelsets, or not of one time")
    usable = np.logical_and.reduce([moving_samples(window, signals) for window in windows])
    if not usable.any():
        return Reason(ReasonCode.NO_USABLE_SAMPLE, "no sample of the running gear can be used")
    integrated = [integrate(window, usable, signals).segments for window in windows]
    if not integrated[0]:
        return Reason(ReasonCode.INTERRUPTED, f"no uninterrupted run of {signals.shortest_segment_s:g} s")
    segments = []
    for parts in zip(*integrated, strict=True):
        rolls = tuple(
            remove_wander(p.displacements[[ROLL]], p.run, p.known, MOTION.longest_roll_wave)[0] for p in parts
        )
        segments.append(GearSegment(parts, rolls, _accelerations(windows, parts, rolls)))
    return GearSegments(tuple(segments), usable, windows[0].sample_interval_s, axles)


def _accelerations(
    windows: Sequence[Window], parts: Sequence[IntegratedSegment], rolls: Sequence[FloatArray]
) -> FloatArray:
    """Return the accelerations (3 a, m) without gravity and means: lateral and yaw of each axle, then those above."""
    # the sensors above are on one frame, which rests on both axles and rolls with their mean
    part, known = parts[0].part, parts[0].known
    mean_roll = np.mean(rolls, axis=0)
    rows = []
    for window, roll in zip(windows, rolls, strict=True):
        rows += [_level(window, LATERAL, part, roll), getattr(window, ACCELERATIONS[YAW])[part]]
    rows += [_level(window, MASS, part, mean_roll) for window in windows]
    values = np.stack(rows)
    return np.where(known, values - values[:, known].mean(axis=1)[:, None], 0.0)


def _level(window: Window, channel: int, part: slice, roll: FloatArray) -> FloatArray:
    values = getattr(window, ACCELERATIONS[channel])[part]
    return np.asarray(values - GRAVITY * roll if window.measures_gravity else values)


@compiled(nogil=True)
def filter_forward(
    transition: FloatArray,
    measured: FloatArray,
    gain: FloatArray,
    measurements: FloatArray,
    known: BoolArray,
    varying: IntArray,
    excess: FloatArray,
    predicted: FloatArray,
    filtered: FloatArray,
    innovations: FloatArray,
) -> None:
    """Write states before (s, n) and after (s, n) each sample, and innovations (s, m); begin at zero.

    Args:
        transition, measured, gain: (n, n), (n, m) and (m, n): columns of the matrices of the filter.
        known: (s,) samples that were measured; over the others the state runs on, and the innovation is zero.
        varying: (a,) states by which the last a measurements vary from sample to sample.
        excess: (s,) what is added to their rows there, of a scaled state.
    """
    samples, n = predicted.shape
    first = measurements.shape[1] - len(varying)
    state, correction = np.zeros(n), np.zeros(n)
    for i in range(samples):
        predicted[i] = state
        filtered[i] = state
        innovations[i] = 0.0
        if known[i]:
            add_product(measured, state, innovations[i])
            for j in range(measurements.shape[1]):
                innovations[i, j] = measurements[i, j] - innovations[i, j]
            for a in range(len(varying)):
                innovations[i, first + a] -= excess[i] * state[varying[a]]
            correction[:] = 0.0
            add_product(gain, innovations[i], correction)
            for k in range(n):
                filtered[i, k] += correction[k]
        state[:] = 0.0
        add_product(transition, filtered[i], state)


@compiled(nogil=True)
def add_product(columns: FloatArray, vector: FloatArray, product: FloatArray) -> None:
    """Add the product (n,) of a matrix and a vector (m,); every sum goes in the order of its terms."""
    for j in range(len(vector)):
        for k in range(len(product)):
            product[k] += columns[j, k] * vector[j]


@compiled(nogil=True)
def smooth_back(back: FloatArray, predicted: FloatArray, filtered: FloatArray) -> None:
    """Change filtered states (s, n) to what all samples together give."""
    samples, n = filtered.shape
    gained = np.zeros(n)
    for i in range(samples - 2, -1, -1):
        for k in range(n):
            gained[k] = filtered[i + 1, k] - predicted[i + 1, k]
        add_product(back, gained, filtered[i])


def without_vibration(
    accelerations: FloatArray, known: BoolArray, sample_interval_s: float, lateral: slice
) -> tuple[FloatArray, bool]:
    """Return accelerations of a running gear, low-passed where its axle boxes vibrate, and whether they do."""
    from scipy import signal  # noqa: PLC0415 - slow to import, and few need it

    rate = 1.0 / sample_interval_s
    weights = signal.firwin(2 * round(FORCES.low_pass_half_s * rate) + 1, FORCES.band_hz, fs=rate)
    smooth = signal.fftconvolve(accelerations, weights[None], mode="same", axes=1)
    rest = (accelerations - smooth)[lateral][:, known]
    if float(np.sqrt(np.mean(rest**2, axis=1)).max()) <= FORCES.vibration_rms:
        return accelerations, False
    return np.where(known, smooth, 0.0), True


@dataclass(frozen=True, slots=True)
class ContactForces(FrozenArrays):
    """What acts on one wheelset at the samples of a window, in the axes of its sensors; NaN where not known."""

    contact: Annotated[FloatArray, "n"]  # N, lateral, creep and gravitational stiffness
    moment: Annotated[FloatArray, "n"]  # N m, of the creep forces
    yaw_rate: Annotated[FloatArray, "n"]  # rad/s
    roll: Annotated[FloatArray, "n"]  # rad
    known: Annotated[BoolArray, "n"]  # samples that were measured
    innovation: float  # largest mean square of a channel's innovations over what was expected
    smoothed: bool = False  # without vibration of the axle boxes, and what is as fast


def forces_on(gear: GearSegments, vehicle_class: VehicleClass) -> tuple[ContactForces, ...] | Reason:
    """Return the forces on each wheelset of a running gear, or why they cannot be had."""
    axles, usable = gear.axles, gear.usable
    values = np.full((axles, 4, len(usable)), np.nan)
    worst, vibrating = 0.0, False
    for segment in gear.segments:
        named, innovation, vibrates = _smoothed(gear, segment, vehicle_class)
        values[:, :, segment.axles[0].part] = named
        worst, vibrating = max(worst, innovation), vibrating or vibrates
    if not (np.isfinite(worst) and worst <= FORCES.most_innovation):
        return Reason(
            ReasonCode.DIVERGED,
            f"the innovations of the filter are {np.sqrt(worst):.1f} times what the vehicle's class lets expect, at"
            f" most {np.sqrt(FORCES.most_innovation):.1f} times are believed; check class and sensors",
        )
    return tuple(
        ContactForces(contact, moment, yaw_rate, roll, usable, worst, vibrating)
        for contact, moment, yaw_rate, roll in values
    )


def _smoothed(gear: GearSegments, segment: GearSegment, vehicle_class: VehicleClass) -> tuple[FloatArray, float, bool]:
    """Return the signals (a, 4, m) of a segment in the order of ``ContactForces``."""
    # beside them the largest mean square of a channel's innovations, and whether its axle boxes vibrate
    p, parts, rolls = vehicle_class.parameters, segment.axles, segment.rolls
    first = parts[0]
    speed = float(first.speed.mean())
    made = stationary_filter(vehicle_class, gear.sample_interval_s, speed)
    roll_rates = [remove_wander(p.rates[[ROLL]], p.run, p.known, MOTION.longest_roll_wave)[0] for p in parts]
    measurements = np.zeros((len(first.speed), len(made.measured)))
    lateral = slice(0, 2 * made.axles, 2)
    steady, vibrating = without_vibration(segment.accelerations, first.known, gear.sample_interval_s, lateral)
    measurements[:, : made.accelerations] = steady.T
    measurements[:, -made.axles :] = p.nominal_radius * np.stack(roll_rates, axis=1) / first.speed[:, None]
    states, innovations = smoothed_states(made, measurements, first.known, first.speed)
    squares = (innovations[first.known, : made.accelerations] / made.innovation_std[: made.accelerations]) ** 2
    named = [_named(made, states, axle, one, rolls[axle], roll_rates[axle], p) for axle, one in enumerate(parts)]
    return np.stack(named), float(squares.mean(axis=0).max()), vibrating


def smoothed_states(
    made: StationaryFilter, measurements: FloatArray, known: BoolArray, speed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the smoothed states (s, n), in SI, and the innovations (s, m) of the filter."""
    samples, (n, m) = len(known), made.gain.shape
    predicted, filtered, innovations = np.empty((samples, n)), np.empty((samples, n)), np.empty((samples, m))
    varying = AXLE * np.arange(made.axles) + 1
    per_speed = -made.measured[-1, varying[-1]] / made.scale[varying[-1]]
    excess = (per_speed - 1.0 / speed) * made.scale[varying[-1]]
    transition, measured, gain, back = (
        frozen_array(matrix.T, matrix.T.shape, name="columns")
        for matrix in (made.transition, made.measured, made.gain, made.back)
    )
    filter_forward(
        transition,
        measured,
        gain,
        frozen_array(measurements, (samples, m), name="measurements"),
        frozen_array(known, (samples,), np.bool_, name="known"),
        varying,
        frozen_array(excess, (samples,), name="excess"),
        predicted,
        filtered,
        innovations,
    )
    smooth_back(back, predicted, filtered)
    return filtered * made.scale, innovations


def _named(
    made: StationaryFilter,
    states: FloatArray,
    axle: int,
    segment: IntegratedSegment,
    roll: FloatArray,
    roll_rate: FloatArray,
    p: VehicleParameters,
) -> FloatArray:
    force = made.states + 2 * axle
    gyroscopic = p.pitch_inertia * segment.speed / p.nominal_radius * roll_rate
    return np.stack([states[:, force], states[:, force + 1] + gyroscopic, states[:, AXLE * axle + 3], roll])


@dataclass(frozen=True, slots=True)
class FileErrors:
    """Relative stds of what all vehicles of a class have in common."""

    creep: float = VEHICLE.creep_std  # coefficient
    spring: float = VEHICLE.stiffness_std  # in yaw
    load: float = VEHICLE.load_std
    yaw_scale: float = VEHICLE.unstated_scale_std  # of the yaw sensors
    lateral_scale: float = VEHICLE.unstated_scale_std  # of the lateral sensors

    @classmethod
    def of(cls, classes: Collection[VehicleClass]) -> Self:
        """Return the largest std that any of some classes has; the defaults where there is none."""
        if not classes:
            return cls()
        return cls(
            max(vehicle_class.std_of("longitudinal_creep_coefficient") for vehicle_class in classes),
            max(vehicle_class.std_of("yaw_stiffness") for vehicle_class in classes),
            max(vehicle_class.std_of("load") for vehicle_class in classes),
            max(vehicle_class.sensors.yaw.usual_scale_std for vehicle_class in classes),
            max(lateral_scale_std(vehicle_class.sensors) for vehicle_class in classes),
        )

    @property
    def factor_std(self) -> float:
        """Relative std of 1/mu of all places."""
        return math.hypot(self.creep, self.spring, self.load)

    @property
    def creep_std(self) -> float:
        """Std of what the scales of the sensors leave, as a b of all vehicles."""
        return math.hypot(FORCES.yaw_scale_creep * self.yaw_scale, FORCES.lateral_scale_creep * self.lateral_scale)


def lateral_scale_std(sensors: SensorLayout) -> float:
    """Return the relative std of the scale of the lateral sensors: the larger one of axle boxes and what is above."""
    return max(sensors.lateral.usual_scale_std, sensors.mass_lateral.usual_scale_std)


def force_errors(vehicle_class: VehicleClass) -> tuple[float, float, float]:
    """Return the relative stds that file and sensors leave to forces across the track, the moment in yaw, and load."""
    std_of, sensors = vehicle_class.std_of, vehicle_class.sensors
    return (
        math.hypot(std_of("wheelset_mass"), std_of("lateral_stiffness"), lateral_scale_std(sensors)),
        math.hypot(std_of("yaw_stiffness"), sensors.yaw.usual_scale_std),
        std_of("load"),
    )


@dataclass(frozen=True, slots=True)
class FrictionParameters:
    """When friction is published, and when it is low."""

    low: float = 0.15  # limit of low adhesion
    likely: float = 0.45  # probability of a friction below the limit from which a place has low adhesion
    at_ends: float = 0.3  # the same of the places around it, to which its stretch reaches
    good: float = 0.4  # friction of good rails: an interval that holds it shows no low friction
    certain: float = 0.9  # that probability where a vehicle is alone, and from which samples are left out elsewhere
    beside_others: float = 0.7  # the same of a place that one vehicle met, where others have passed the section
    fewest_vehicles: int = 2  # that agree, where the probability is less
    fewest_passes: int = 3  # of wheelsets
    creep_error_std: float = 0.1  # of b, relative
    usual: float = 3.3  # 1/mu of rails that nothing is known of: a friction of 0.3
    usual_std: float = 3.0  # of it, at a place
    most_usual: float = 6.7  # 1/mu of a place that is usual yet
    level_std: float = 1.0  # of it, of the middle one of all places of a section
    law_std: float = 0.1  # of 1/mu, relative: creep laws differ
    file: FileErrors = field(default_factory=FileErrors)  # what file and sensors leave open of all vehicles alike
    track_std: float = 0.45  # of 1/mu of a place, at least: the error of the alignment is the same in all passes
    smoothed_std: float = 1.0  # the same of what forces have lost with the vibration of axle boxes
    change_std: float = 0.2  # of the logarithm of 1/mu from a place to the next
    fresh: float = 0.05  # share of places whose friction has nothing to do with that of the place before
    least_upper: float = 0.6  # an interval that reaches beyond says no more than a lower bound
    rounds: int = 12
    wheelset_scatter: float = 0.1  # std of the logarithm of a wheelset's scale: its curve and its profiles
    fewest_with_scale: int = 3  # of two that contradict each other nobody knows which is wrong
    most_deviation_stds: float = 3.0  # stds
    wrong_place_share: float = 0.05  # of places, whose error is so many times that of the others
    wrong_factor: float = 3.0
    least_likelihood: float = 1e-12  # of the largest: no place makes another one impossible
    best_inverse: float = 2.0  # 1/mu of the best rails: what places show below is error
    below_best_share: float = 0.1  # share of the places that may be below by their errors alone
    least_common_std: float = 0.4  # std of what is common over all that is left: no section shows less
    prior_places: float = 20.0  # that are worth as much as the expectation that all of it is common
    most_creep_stds: float = 2.0  # stds of b that all vehicles have in common, from which the shape is asked
    least_creep_support: float = 0.8  # of the squares that an error of linear creep would leave, to be taken for one
    learnt_std_share: float = 0.7  # of the std beforehand: with more, the passes say nothing of a place
