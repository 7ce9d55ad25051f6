"""A wheelset with smooth analytic geometry, different on its two sides, run by the simulator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from estimation.motion.integration import standard_displacement
from estimation.values.quantities import Status
from estimation.values.track import TrackAlignment
from estimation.values.windows import Motion, Window, WindowQuality
from ingest.simulator.motion import WheelsetMotion
from ingest.simulator.running_gear import RunningGear, simulate_gear
from ingest.simulator.track import TrackRecipe, TrackTruth, make_track


@dataclass(frozen=True)
class SmoothTable:
    """Radii and angles as polynomials of the displacement; the right wheel is worn a little more."""

    cone: float = 0.1

    lateral_displacement = np.linspace(-12e-3, 12e-3, 481)
    gauge_deviation = np.zeros(1)

    def left(self, x: np.ndarray) -> np.ndarray:
        return 0.45 + self.cone * x + 6 * x**2 + 900 * x**3

    def right(self, x: np.ndarray) -> np.ndarray:
        return 0.4499 - (self.cone + 0.02) * x + 5 * x**2 - 700 * x**3

    def angle_left(self, x: np.ndarray) -> np.ndarray:
        return 0.13 + 12 * x + 2700 * x**2

    def angle_right(self, x: np.ndarray) -> np.ndarray:
        return 0.15 - 10 * x + 2100 * x**2

    @property
    def rolling_radius_left(self) -> np.ndarray:
        return self.left(self.lateral_displacement)[:, None]

    @property
    def rolling_radius_right(self) -> np.ndarray:
        return self.right(self.lateral_displacement)[:, None]

    @property
    def contact_angle_left(self) -> np.ndarray:
        return self.angle_left(self.lateral_displacement)[:, None]

    @property
    def contact_angle_right(self) -> np.ndarray:
        return self.angle_right(self.lateral_displacement)[:, None]

    @property
    def roll(self) -> np.ndarray:
        return (self.rolling_radius_left - self.rolling_radius_right) / 1.5

    @property
    def standard_displacement(self) -> np.ndarray:
        """(n,) m, of EN 15302, where the axle's is ``lateral_displacement``."""
        return standard_displacement(self.lateral_displacement, self.roll[:, 0], 0.45, level=False)


@cache
def track(seed: int, length: float = 13_000.0) -> TrackTruth:
    return make_track(TrackRecipe(length=length), np.random.SeedSequence(seed))


@cache
def run(seconds: int, seed: int = 1, cone: float = 0.1, speed: float = 20.0, swing: float = 0.0) -> WheelsetMotion:
    t = np.arange(seconds * 1000) * 1e-3
    V = speed + swing * np.sin(2 * np.pi * t / 97.0)
    return simulate_gear(RunningGear(), [SmoothTable(cone)], track(seed), V, 10.0)[0]


def ideal(m: WheelsetMotion, block_s: float = 20.0) -> Motion:
    return Motion(
        speed=m.speed,
        displacement=m.relative_displacement,
        lateral_velocity=m.lateral_velocity,
        lateral_acceleration=m.lateral_acceleration,
        yaw=m.yaw,
        yaw_rate=m.yaw_rate,
        yaw_acceleration=m.yaw_acceleration,
        roll=m.roll,
        roll_rate=m.roll_rate,
        suspension_deflection=m.mass_lateral_displacement - m.lateral_displacement,
        suspension_deflection_rate=m.mass_lateral_velocity - m.lateral_velocity,
        valid=np.ones(len(m), dtype=bool),
        block=(m.t / block_s).astype(np.int64),
        band_limited=False,
        sample_interval_s=1e-3,
    )


def alignment(truth: TrackTruth) -> TrackAlignment:
    zero = np.zeros(len(truth.s))
    return TrackAlignment(
        section="S1",
        version=1,
        s=truth.s,
        alignment=truth.alignment,
        alignment_std=zero,
        gauge_deviation=truth.gauge_deviation,
        gauge_deviation_std=zero,
        passes=np.zeros(len(truth.s), dtype=np.int64),
        status=Status.ESTIMATED,
    )


GOOD = WindowQuality(
    coverage=1.0,
    longest_gap_s=0.0,
    gaps=0,
    clipped=0.0,
    invalid=0.0,
    speed_min_m_s=17.0,
    speed_max_m_s=23.0,
    position_quality=1.0,
    sensor_fault=False,
)


def mems_windows(m: WheelsetMotion, seed: int, density: float = 1e-3, length_s: int = 60) -> list[Window]:
    """Cut the motion into windows at 250 Hz as white, offset, drifting sensors would measure it."""
    rng = np.random.default_rng(seed)
    dt = 4e-3
    clean = (m.lateral_acceleration, m.yaw_acceleration, m.roll_acceleration, m.mass_lateral_acceleration)
    measured = []
    for values, noise in zip(clean, (density, 2 * density, 2 * density, density), strict=True):
        sampled = values[::4]
        n = len(sampled)
        drift = density * np.cumsum(rng.standard_normal(n)) * np.sqrt(dt)
        measured.append(
            sampled + 0.3 * rng.standard_normal() + drift + noise * np.sqrt(0.5 / dt) * rng.standard_normal(n)
        )
    step = round(length_s / dt)
    return [
        Window(
            wheelset="W1",
            vehicle="V1",
            axle=1,
            start_ns=i * length_s * 10**9,
            length_ns=length_s * 10**9,
            sample_interval_s=dt,
            lateral_acceleration=measured[0][part],
            yaw_acceleration=measured[1][part],
            roll_acceleration=measured[2][part],
            mass_lateral_acceleration=measured[3][part],
            speed=m.speed[::4][part],
            distance=m.distance[::4][part],
            valid=np.ones(step, dtype=bool),
            resolution=(1e-4, 1e-4, 1e-4, 1e-4),
            track_section="S1",
            odometer_m=0.0,
            quality=GOOD,
        )
        for i, part in enumerate(slice(k * step, (k + 1) * step) for k in range(len(measured[0]) // step))
    ]
