"""Worn P8 wheelsets on 56E1 rails, the speed of a journey, and what MEMS sensors measure of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.made_values import made_window
from estimation.contact.geometry import WheelsetOnTrack
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.wear import WearFamily, wear_course, worn
from estimation.values.arrays import FloatArray
from estimation.values.windows import Window
from ingest.simulator.motion import STEP, WheelsetMotion
from ingest.simulator.sensors import Channel, SensorNode, draw_offsets, measure

NODE = SensorNode(  # 100 ug per root hertz, angular channels at twice that, offsets, drift
    Channel(1e-3, 0.2, 1e-3), Channel(2e-3, 0.2, 1e-3), Channel(2e-3, 0.2, 1e-3), Channel(1e-3, 0.2, 1e-3)
)


def worn_p8(depth: float, skew: float) -> WheelsetOnTrack:
    """Return a wheelset whose wheels have lost so much of their tread, m, the left one more by a share."""
    wheel, rail = wheel_profile("P8"), rail_profile("56E1")
    left, right = (worn(wheel, wear_course(WearFamily.P8_ON_56E1, depth * (1 + side * skew))) for side in (1, -1))
    return WheelsetOnTrack(left, right, rail, rail, 1 / 20, 1.435)


def course(way: float, mean_speed: float, rng: np.random.Generator) -> FloatArray:
    """Return the speed (n,), m/s, of a journey over so many metres."""
    t = np.arange(round(way / (1.05 * mean_speed) / STEP)) * STEP
    return np.asarray(mean_speed * (1 + 0.04 * np.sin(2 * np.pi * t / rng.uniform(60, 200) + rng.uniform(0, 6))))


def measured(
    motion: WheelsetMotion,
    wheelset: str,
    start_ns: int,
    rng: np.random.Generator,
    **others: Any,  # noqa: ANN401 - any field of a window
) -> Window:
    """Return a whole journey as one window, as its node measures it."""
    values = measure(motion, NODE, rng, draw_offsets(NODE, rng)).values
    fields = {"speed": motion.speed[:: NODE.stride], "distance": motion.distance[:: NODE.stride]}
    return made_window(values, wheelset, start_ns, STEP * NODE.stride, **(fields | others))
