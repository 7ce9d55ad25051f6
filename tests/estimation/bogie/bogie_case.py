"""Runs of a coach's bogie on a known track, from the simulator, with the noise of its sensors."""

from __future__ import annotations

from functools import cache

import numpy as np
from bogie_run import BOGIE, COACH, WHEELBASE, of_bogie, wheelset
from scipy.interpolate import CubicSpline
from smooth_wheelset import SmoothTable, track

from estimation.bogie.signals import BogieRun
from estimation.bogie.simulation import Gear
from estimation.contact.conicity import equivalent_conicity
from estimation.motion.integration import standard_displacement
from ingest.simulator.motion import WheelsetMotion
from ingest.simulator.running_gear import RunningGear, simulate_gear

DT, STRIDE = 0.004, 4
CONES = (0.1, 0.14)
GEAR = Gear(wheelset(COACH), BOGIE, 0.0)
CLASS = of_bogie(COACH)
AMPLITUDES = np.array([1.5e-3, 2.0e-3])
LATERAL_NOISE, ANGULAR_NOISE = 1e-3, 2e-3  # m/s2 and rad/s2 per root hertz


@cache
def motions(seconds: int, seed: int, cones: tuple[float, float] = CONES) -> tuple[WheelsetMotion, ...]:
    """Return the motion of the leading and the trailing wheelset."""
    tables = [SmoothTable(cone) for cone in cones]
    gear = RunningGear(wheelset(COACH), BOGIE)
    return simulate_gear(gear, tables, track(seed), np.full(seconds * 1000, 20.0), 500.0)


def true_conicity(row: int) -> np.ndarray:
    """Return the conicity at ``AMPLITUDES`` of the leading (0) or trailing (1) wheelset."""
    table = SmoothTable(CONES[row])
    difference = (table.rolling_radius_left - table.rolling_radius_right)[:, 0]
    return equivalent_conicity(table.standard_displacement, difference, AMPLITUDES)


def runs(
    count: int,
    seed: int,
    *,
    noise: float = 1.0,
    mirrored: bool = False,
    cones: tuple[float, float] = CONES,
    noise_seed: int = 0,
) -> list[tuple[int, BogieRun]]:
    """Return runs of a minute, each with its group; ``mirrored``: over an alignment with the other sign."""
    rng, both = np.random.default_rng(seed + 100 * noise_seed), motions(60 * count, seed, cones)
    return [(number, _run(both, number, rng, noise, seed, mirrored=mirrored)) for number in range(count)]


def _run(
    both: tuple[WheelsetMotion, ...],
    number: int,
    rng: np.random.Generator,
    noise: float,
    seed: int,
    *,
    mirrored: bool,
) -> BogieRun:
    part = slice(number * 60_000, (number + 1) * 60_000, STRIDE)

    def measured(name: str, *, angular: bool) -> np.ndarray:
        """Return displacement, rate and acceleration (3, 2, n) of both wheelsets."""
        names = {"lateral": ("lateral_displacement", "lateral_velocity", "lateral_acceleration"),
                 "mass": ("mass_lateral_displacement", "mass_lateral_velocity", "mass_lateral_acceleration"),
                 "yaw": ("yaw", "yaw_rate", "yaw_acceleration"),
                 "roll": ("roll", "roll_rate", "roll_acceleration")}[name]  # fmt: skip
        true = np.stack([[getattr(motion, one)[part] for motion in both] for one in names])
        density = ANGULAR_NOISE if angular else LATERAL_NOISE
        return true + np.stack([_noise(rng, noise * density, true.shape[2]) for _ in both], axis=1)

    lateral, yaw = measured("lateral", angular=False), measured("yaw", angular=True)
    roll, above = measured("roll", angular=True), measured("mass", angular=False)
    sign = -1.0 if mirrored else 1.0
    ahead, places, of = [], [], track(seed)
    for motion in both:
        at = motion.distance[part]
        before = at[0] - 20.0 * DT * np.arange(1000, 0, -1)
        places.append(np.concatenate([before, at]))
        ahead.append(sign * CubicSpline(of.s, of.alignment)(places[-1]))
    height = GEAR.vehicle.nominal_radius
    relative = [
        standard_displacement(lateral[0, row] - ahead[row][1000:], roll[0, row], height, level=False)
        for row in range(2)
    ]
    return BogieRun(
        interval_s=DT,
        speed=both[0].speed[part],
        lateral=lateral,
        yaw=yaw,
        roll=roll[:2],
        frame_lateral=above[:2].mean(axis=1),
        frame_yaw=(above[:, 0] - above[:, 1]) / WHEELBASE,
        relative=np.stack(relative),
        stretch=1.0,
        swapped=False,
        ahead=np.stack(ahead),
        place=np.stack(places),
    )


def _noise(rng: np.random.Generator, density: float, n: int) -> np.ndarray:
    acceleration = density * np.sqrt(0.5 / DT) * rng.standard_normal(n)
    rate = DT * np.cumsum(acceleration)
    t = np.arange(n)
    rate -= np.polyval(np.polyfit(t, rate, 1), t)
    return np.stack([DT * np.cumsum(rate), rate, acceleration])
