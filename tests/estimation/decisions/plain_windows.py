"""Windows without a simulator: a vehicle at constant speed on a straight section, every acceleration zero."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from estimation.values.quantities import Status
from estimation.values.track import TrackAlignment, TrackLayout
from estimation.values.windows import Window, WindowQuality

DT = 0.02  # s
SPEED = 20.0  # m/s
GOOD = WindowQuality(
    coverage=1.0,
    longest_gap_s=0.0,
    gaps=0,
    clipped=0.0,
    invalid=0.0,
    speed_min_m_s=SPEED,
    speed_max_m_s=SPEED,
    position_quality=1.0,
    sensor_fault=False,
)


def plain_window(seconds: float = 30.0, **changes: Any) -> Window:  # noqa: ANN401 - any field
    """Return a window of ``seconds``, with some fields changed."""
    n = round(seconds / DT)
    zero = np.zeros(n)
    window = Window(
        wheelset="W1",
        vehicle="V1",
        axle=1,
        start_ns=0,
        length_ns=n * round(DT * 1e9),
        sample_interval_s=DT,
        lateral_acceleration=zero,
        yaw_acceleration=zero,
        roll_acceleration=zero,
        mass_lateral_acceleration=zero,
        speed=np.full(n, SPEED),
        distance=SPEED * DT * np.arange(n),
        valid=np.ones(n, dtype=np.bool_),
        resolution=(1e-4, 1e-4, 1e-4, 1e-4),
        track_section="S1",
        odometer_m=0.0,
        quality=GOOD,
    )
    return replace(window, **changes)


def plain_track(length: float = 1000.0, **changes: Any) -> TrackAlignment:  # noqa: ANN401 - any field
    """Return a section of perfectly straight track of constant gauge, with some fields changed."""
    s = np.arange(0.0, length + 1.0)
    zero = np.zeros(len(s))
    track = TrackAlignment(
        section="S1",
        version=1,
        s=s,
        alignment=zero,
        alignment_std=zero,
        gauge_deviation=zero,
        gauge_deviation_std=zero,
        passes=np.zeros(len(s), dtype=np.int64),
        status=Status.ESTIMATED,
    )
    return replace(track, **changes)


def layout(*points: tuple[float, float, float]) -> TrackLayout:
    """Return a layout of (s, curvature, cant)."""
    return TrackLayout("S1", 1, *np.array(points).T)
