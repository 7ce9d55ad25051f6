"""What a sensor node makes of the true motion: noise, offset, drift, clipping, anti-alias filter, sampling.

The node samples at 1 kHz, clips at its range, filters with a linear-phase low-pass whose delay it takes out of its
time stamps (so sample k belongs to the instant of its SYNC), and decimates. Where contact jumps are narrow a wheelset
that passes one accelerates for less time than passes between two samples of the motion: a node that filters then gets
slopes of the true velocities, whose integral holds such pulses. A node with gyroscopes sends the slope of the rates
that they measure. Quantisation to int16 happens in the codec, by the scale of the signal catalogue.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np
import scipy.signal
from pydantic import AfterValidator

from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays
from estimation.values.fields import MS, PERCENT, FileUnit, Key
from estimation.values.units import GRAVITY
from estimation.values.windows import ACCELERATIONS
from ingest.file_value import between
from ingest.input_file import NotNegative, Positive, Text, field_error, refusing
from ingest.simulator.motion import STEP, WheelsetMotion, time_derivative
from ingest.simulator.sensor_errors import (
    NodeErrors,
    SensorErrors,
    Vibration,
    in_sensor_axes,
    sampled_late,
    vibration_of,
)

FULL_RATE_HZ = round(1.0 / STEP)
VELOCITIES = ("lateral_velocity", "yaw_rate", "roll_rate", "mass_lateral_velocity")  # as in ACCELERATIONS
_PASS = 0.36  # end of the flat band, as a share of the output rate
_STOP = 0.64  # what is above folds back onto the flat band's outside only
_RIPPLE_DB = 70.0


@dataclass(frozen=True, slots=True)
class Channel:
    """One signal of a sensor node, in its own SI unit u (m/s2 or rad/s2; of a gyroscope rad/s).

    ``offset`` is the standard deviation of a constant drawn per sensor, ``drift`` that of a random walk after one
    second, ``limit`` the largest magnitude the transducer gives.
    """

    noise_density: float = 0.0  # u per root hertz, one-sided
    offset: float = 0.0  # u
    drift: float = 0.0  # u per root second
    limit: float = np.inf  # u
    gyroscope: bool = False  # measures the rate of an angular channel


@dataclass(frozen=True, slots=True)
class SensorNode:
    """The four channels of a node, in the order of ``ACCELERATIONS``, its rate, and whether it filters.

    ``measures_gravity`` says that its accelerometers measure specific force, as every real one does: one that rolls by
    phi measures 9.81 phi more.
    """

    lateral: Channel
    yaw: Channel
    roll: Channel
    mass_lateral: Channel
    rate_hz: int = 250
    anti_alias: bool = True
    errors: SensorErrors = field(default_factory=SensorErrors)
    measures_gravity: bool = False
    on_mass: bool = True  # whether there is a sensor on the suspended mass

    @property
    def channels(self) -> tuple[Channel, Channel, Channel, Channel]:
        """The channels in the order of ``ACCELERATIONS``."""
        return self.lateral, self.yaw, self.roll, self.mass_lateral

    @property
    def stride(self) -> int:
        """Samples of the motion per sample of the node."""
        return FULL_RATE_HZ // self.rate_hz


def ideal_node(rate_hz: int = FULL_RATE_HZ) -> SensorNode:
    """Return a node without noise, offset, drift, limit or filter: it gives the true instantaneous values."""
    return SensorNode(Channel(), Channel(), Channel(), Channel(), rate_hz=rate_hz, anti_alias=False)


@dataclass(frozen=True, slots=True)
class SensorRecord(FrozenArrays):
    """What a node measured: every ``1 / rate_hz`` s from the start of the motion."""

    t: Annotated[FloatArray, "n"]  # s from the start of the motion
    values: Annotated[FloatArray, "n", 4]  # in the order of ACCELERATIONS
    clipped: Annotated[BoolArray, "n", 4]  # the transducer was at its limit since the sample before


def measure(
    motion: WheelsetMotion,
    node: SensorNode,
    rng: np.random.Generator,
    offsets: FloatArray,
    errors: NodeErrors | None = None,  # how this node differs from its data sheet; None: not at all
    *,
    short_pulses: bool = False,
) -> SensorRecord:
    """Return the record of a sensor node: noise, offset, drift, limits and the filter before decimation applied.

    The constant offsets (4,) of this sensor are in its units, in the order of ``ACCELERATIONS``. ``short_pulses`` says
    that the motion accelerates for less time than passes between two of its samples.
    """
    n, stride = len(motion), node.stride
    size = -(-n // stride)
    signals = _true_signals(motion, node, errors, rng, short_pulses=short_pulses and node.anti_alias)
    values, clipped = np.empty((size, 4)), np.zeros((size, 4), dtype=np.bool_)
    taps = _low_pass(stride) if node.anti_alias and stride > 1 else None
    for place, channel in enumerate(node.channels):
        true = signals[place]
        if channel.gyroscope:  # the integral from its begin: the rate, but for that at first
            true = np.concatenate([[0.0], np.cumsum(0.5 * STEP * (true[1:] + true[:-1]))])
        raw = np.asarray(true + float(offsets[place]))
        if channel.noise_density > 0.0:
            raw += channel.noise_density * np.sqrt(0.5 / STEP) * rng.standard_normal(n)
        if channel.drift > 0.0:
            raw += _random_walk(n, channel.drift, rng)
        if errors is not None and errors.offset_slope[place] != 0.0:
            raw += errors.offset_slope[place] * STEP * np.arange(n)
        if np.isfinite(channel.limit):
            over = np.abs(raw) > channel.limit
            if over.any():
                clipped[:, place] = _since_last(over, stride)
                raw = np.clip(raw, -channel.limit, channel.limit)
        if channel.gyroscope:
            raw = np.gradient(raw, STEP)
        values[:, place] = raw[::stride] if taps is None else _decimate(raw, taps, stride)
    return SensorRecord(STEP * stride * np.arange(size, dtype=np.float64), values, clipped)


def _true_signals(
    motion: WheelsetMotion,
    node: SensorNode,
    errors: NodeErrors | None,
    rng: np.random.Generator,
    *,
    short_pulses: bool,
) -> list[FloatArray]:
    """Return what the transducers are exposed to, four signals (n,) in the order of ``ACCELERATIONS``."""
    if short_pulses:
        signals = [time_derivative(getattr(motion, name)) for name in VELOCITIES]
    else:
        signals = [np.asarray(getattr(motion, name)) for name in ACCELERATIONS]
    if motion.path_accelerations is not None:
        signals = [signal + path for signal, path in zip(signals, motion.path_accelerations, strict=True)]
    if node.measures_gravity:
        signals[0], signals[3] = signals[0] + GRAVITY * motion.roll, signals[3] + GRAVITY * motion.mass_roll
    if errors is None:
        return signals
    longitudinal = np.gradient(motion.speed, STEP)
    turned = in_sensor_axes(np.stack(signals), longitudinal, errors, gravity=node.measures_gravity)
    late, n = sampled_late(turned, errors.skew), len(motion)
    if errors.vibration is not None:
        late += vibration_of(errors.vibration, n, rng)
    drift = np.outer(errors.scale_drift, np.linspace(0.0, 1.0, n))
    return list(np.asarray(late * (errors.scale[:, None] + drift)))


def draw_offsets(node: SensorNode, rng: np.random.Generator) -> FloatArray:
    """Return the constant offsets (4,) of one sensor."""
    return np.array([channel.offset * rng.standard_normal() for channel in node.channels])


def _random_walk(n: int, per_root_second: float, rng: np.random.Generator) -> FloatArray:
    """Return a random walk (n,) that starts at 0, in steps of some 0.1 s, linear between."""
    every = 100
    count = n // every + 2
    nodes = np.concatenate([[0.0], np.cumsum(rng.standard_normal(count - 1))]) * per_root_second * np.sqrt(every * STEP)
    return np.asarray(np.interp(np.arange(n), every * np.arange(count), nodes))


def _low_pass(stride: int) -> FloatArray:
    """Return the taps, odd in number and symmetric: flat to 0.36 of the output rate, 70 dB down from 0.64."""
    width = 2.0 * (_STOP - _PASS) / stride  # of the input's Nyquist frequency
    count, beta = scipy.signal.kaiserord(_RIPPLE_DB, width)
    taps = scipy.signal.firwin(count | 1, (_PASS + _STOP) / stride, window=("kaiser", beta))
    return np.asarray(taps, dtype=np.float64)


def _decimate(raw: FloatArray, taps: FloatArray, stride: int) -> FloatArray:
    """Return every ``stride``-th sample of the filtered signal, its delay taken out; the ends are held."""
    half = len(taps) // 2
    padded = np.concatenate([np.full(half, raw[0]), raw, np.full(half, raw[-1])])
    lead = (-2 * half) % stride
    polyphase = scipy.signal.upfirdn(taps, np.concatenate([np.zeros(lead), padded]), up=1, down=stride)
    first = (2 * half + lead) // stride
    return np.asarray(polyphase[first : first + -(-len(raw) // stride)])


def _since_last(flags: BoolArray, stride: int) -> BoolArray:
    """Return for every ``stride``-th sample whether a flag was set in the ``stride`` samples that end there."""
    size = -(-len(flags) // stride)
    padded = np.zeros(size * stride, dtype=np.bool_)
    padded[stride - 1 : stride - 1 + len(flags)] = flags[: size * stride - stride + 1]
    return np.asarray(padded.reshape(size, stride).any(axis=1))


MICRO_G = 9.80665e-6  # m/s2
UG, MG, G = FileUnit("_ug", MICRO_G), FileUnit("_mg", 1e3 * MICRO_G), FileUnit("_g", 1e6 * MICRO_G)
Noise = Annotated[NotNegative, FileUnit("_ug_per_root_hz", MICRO_G)]
Drift = Annotated[NotNegative, FileUnit("_ug_per_root_s", MICRO_G)]
RAD_S2 = FileUnit("_rad_s2")
_DIVIDES = refusing(lambda rate: FULL_RATE_HZ % rate, f"{{value}} Hz does not divide {FULL_RATE_HZ} Hz")


@dataclass(frozen=True, slots=True)
class SensorsTable:
    """``[sensors]``."""

    kind: Text = "mems"
    rate_hz: Annotated[int, between(1, FULL_RATE_HZ), _DIVIDES] = 250
    anti_alias: bool = True
    lateral_noise: Noise = MICRO_G * 100.0
    lateral_offset: Annotated[NotNegative, MG] = 1e3 * MICRO_G * 20.0
    lateral_drift: Drift = MICRO_G * 20.0
    lateral_limit: Annotated[Positive, G] = 1e6 * MICRO_G * 50.0
    mass_noise: Noise = MICRO_G * 100.0
    mass_offset: Annotated[NotNegative, MG] = 1e3 * MICRO_G * 10.0
    mass_drift: Drift = MICRO_G * 20.0
    mass_limit: Annotated[Positive, G] = 1e6 * MICRO_G * 2.0
    angular_noise: Annotated[NotNegative, FileUnit("_rad_s2_per_root_hz")] = 2e-3
    angular_offset: Annotated[NotNegative, RAD_S2] = 0.05
    angular_drift: Annotated[NotNegative, FileUnit("_rad_s2_per_root_s")] = 2e-4
    angular_limit: Annotated[Positive, RAD_S2] = 100.0
    gyroscopes: bool = False
    gyroscope_noise: Annotated[NotNegative, FileUnit("_rad_s_per_root_hz")] = 1e-4
    gyroscope_limit: Annotated[Positive, FileUnit("_rad_s")] = 8.7
    measures_gravity: bool = False
    mass_sensor: bool = True
    scale_error_std: Annotated[float, between(0.0, 30.0), PERCENT] = 0.0
    stated_scale_std: Annotated[float, between(0.0, 30.0), PERCENT] | None = None
    mounting_error_std: Annotated[float, between(0.0, 20.0), AfterValidator(math.radians), FileUnit("_deg")] = 0.0
    skew_std: Annotated[float, between(0.0, 100.0), MS] = 0.0
    offset_drift_std: Annotated[NotNegative, FileUnit("_mg_per_min", 1e3 * MICRO_G, 60.0)] = 0.0
    angular_offset_drift_std: Annotated[NotNegative, FileUnit("_rad_s2_per_min", divisor=60.0)] = 0.0
    scale_drift_std: Annotated[float, between(0.0, 30.0), PERCENT] = 0.0
    axle_box_vibration: Annotated[NotNegative, FileUnit("_m_s2")] = 0.0
    axle_box_angular_vibration: Annotated[NotNegative, Key("axle_box_vibration_rad_s2")] = 0.0
    mass_vibration_share: Annotated[float, between(0.0, 1.0)] = 0.1
    vibration_from_hz: Annotated[float, between(1.0, 450.0)] = 20.0
    vibration_to_hz: Annotated[float, between(2.0, 480.0)] = 400.0

    def of_file(self, given: Collection[str]) -> Self:
        """Refuse a band without frequencies, and errors of ideal sensors."""
        if self.vibration_from_hz >= self.vibration_to_hz:
            raise field_error("must be below 'vibration_to_hz'", "vibration_from_hz")
        if self.kind not in {"mems", "ideal"}:
            raise field_error(f"{self.kind!r} is neither 'mems' nor 'ideal'", "kind")
        if self.kind == "ideal":
            for key in set(given) - {"kind", "rate_hz"}:
                raise field_error("unknown key of ideal sensors; known here: kind, rate_hz", key)
        return self

    def plan(self) -> SensorNode:
        """Return the sensor node."""
        if self.kind == "ideal":
            return ideal_node(self.rate_hz)
        angular = Channel(self.angular_noise, self.angular_offset, self.angular_drift, self.angular_limit)
        linear_slope, angular_slope = self.offset_drift_std, self.angular_offset_drift_std
        if self.gyroscopes:
            angular = Channel(self.gyroscope_noise, limit=self.gyroscope_limit, gyroscope=True)
            angular_slope = 0.0
        box = self.axle_box_vibration, self.axle_box_angular_vibration
        errors = SensorErrors(
            scale=self.scale_error_std,
            mounting=self.mounting_error_std,
            skew=self.skew_std,
            offset_slope=(linear_slope, angular_slope, angular_slope, linear_slope),
            scale_drift=self.scale_drift_std,
            vibration=Vibration(*box, self.mass_vibration_share, self.vibration_from_hz, self.vibration_to_hz)
            if any(box)
            else None,
            stated_scale=self.stated_scale_std,
        )
        return SensorNode(
            Channel(self.lateral_noise, self.lateral_offset, self.lateral_drift, self.lateral_limit),
            angular,
            angular,
            Channel(self.mass_noise, self.mass_offset, self.mass_drift, self.mass_limit),
            rate_hz=self.rate_hz,
            anti_alias=self.anti_alias,
            errors=errors,
            measures_gravity=self.measures_gravity,
            on_mass=self.mass_sensor,
        )
