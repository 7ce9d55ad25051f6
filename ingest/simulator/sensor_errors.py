"""How sensors differ from their data sheet: scale, mounting, skew, temperature, and the vibration of what they are on.

A node has two transducers: one on the axle box (lateral, yaw, roll) and one on the suspended mass above it (lateral).
Each is turned against the axes of the vehicle by three angles. What is drawn per node stays over all campaigns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy.signal

from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.units import GRAVITY
from ingest.simulator.motion import STEP

AXES = 3  # x forward, y left, z up; rotations about them: roll, pitch, yaw
CHANNELS = 4
MASS = 3  # place of the mass's channel
ORDER = 4  # of the band-pass


@dataclass(frozen=True, slots=True)
class Vibration:
    """Band-limited noise of an axle box; its root mean square before the node's filter."""

    lateral: float = 0.0  # m/s2
    angular: float = 0.0  # rad/s2, yaw and roll
    mass_share: float = 0.1  # of the lateral one, on the suspended mass
    lowest_hz: float = 20.0
    highest_hz: float = 400.0

    @property
    def of_channels(self) -> tuple[float, float, float, float]:
        """The root mean square of each channel, in the order of ``ACCELERATIONS``."""
        return self.lateral, self.angular, self.angular, self.mass_share * self.lateral


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Standard deviations of what is drawn per node, and what acts on all of them."""

    scale: float = 0.0  # relative, per channel
    mounting: float = 0.0  # rad about each axis, per transducer
    skew: float = 0.0  # s by which a node samples after SYNC
    offset_slope: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # u per s, per channel and campaign
    scale_drift: float = 0.0  # relative, from begin to end of a campaign, per channel
    vibration: Vibration | None = None
    stated_scale: float | None = None  # on file; None: as it is


@dataclass(frozen=True, slots=True)
class NodeErrors(FrozenArrays):
    """What one node has, in one campaign."""

    scale: Annotated[FloatArray, CHANNELS]  # (4,) factors
    axle_box: Annotated[FloatArray, AXES]  # (3,) rad, of its transducer about x, y, z
    mass: Annotated[FloatArray, AXES]  # (3,) rad, of that on the suspended mass
    skew: float  # s
    offset_slope: Annotated[FloatArray, CHANNELS]  # (4,) u per s
    scale_drift: Annotated[FloatArray, CHANNELS]  # (4,) relative, from begin to end
    vibration: Vibration | None


def draw_node_errors(plan: SensorErrors, node: np.random.Generator, campaign: np.random.Generator) -> NodeErrors:
    """Return what one node has in one campaign."""
    scale, turned, skew = node.standard_normal(CHANNELS), node.standard_normal((2, AXES)), node.standard_normal()
    slope, drift = campaign.standard_normal((2, CHANNELS))
    return NodeErrors(
        scale=1.0 + plan.scale * scale,
        axle_box=plan.mounting * turned[0],
        mass=plan.mounting * turned[1],
        skew=float(plan.skew * skew),
        offset_slope=np.array(plan.offset_slope) * slope,
        scale_drift=plan.scale_drift * drift,
        vibration=plan.vibration,
    )


def turned_axes(angles: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) that gives a vector of the vehicle in the axes of a sensor.

    Angles (3,), rad: it is turned about z, then about its own y, then about its own x; given as x, y, z.
    """
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, sx], [0.0, -sx, cx]])
    about_y = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]])
    about_z = np.array([[cz, sz, 0.0], [-sz, cz, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_x @ about_y @ about_z)


def in_sensor_axes(true: FloatArray, longitudinal: FloatArray, errors: NodeErrors, *, gravity: bool) -> FloatArray:
    """Return the signals (4, n) of transducers that are turned against the axes of the vehicle.

    The spin of the wheels does not reach an axle box: its pitch is zero. Transducers may measure gravity: 9.81 m/s^2
    upwards at rest.
    """
    lateral, yaw, roll, mass = true
    upwards = GRAVITY if gravity else 0.0
    axle_box, above = turned_axes(errors.axle_box), turned_axes(errors.mass)
    return np.stack(
        [
            axle_box[1, 0] * longitudinal + axle_box[1, 1] * lateral + axle_box[1, 2] * upwards,
            axle_box[2, 0] * roll + axle_box[2, 2] * yaw,
            axle_box[0, 0] * roll + axle_box[0, 2] * yaw,
            above[1, 0] * longitudinal + above[1, 1] * mass + above[1, 2] * upwards,
        ]
    )


def sampled_late(signals: FloatArray, skew: float) -> FloatArray:
    """Return signals (m, n) as a node sees them that samples ``skew`` s late, early where that is negative.

    Linear between samples, ends held.
    """
    at = np.arange(signals.shape[1], dtype=np.float64)
    return np.stack([np.interp(at + skew / STEP, at, signal) for signal in signals])


def vibration_of(vibration: Vibration, count: int, rng: np.random.Generator) -> FloatArray:
    """Return the vibration (4, count) of the channels: normal, band-limited, each for itself."""
    frequencies = (vibration.lowest_hz, vibration.highest_hz)
    band = scipy.signal.butter(ORDER, frequencies, btype="bandpass", fs=1.0 / STEP, output="sos")
    _, response = scipy.signal.sosfreqz(band, 1 << 14)
    gain = float(np.sqrt(np.mean(np.abs(response) ** 2)))  # of white noise
    out = np.zeros((CHANNELS, count))
    for place, rms in enumerate(vibration.of_channels):
        white = rng.standard_normal(count)
        if rms > 0.0:
            out[place] = scipy.signal.sosfilt(band, white) * (rms / gain)
    return out
