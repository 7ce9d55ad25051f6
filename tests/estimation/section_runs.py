"""Runs of differently worn wheelsets over one section of 3 km, each a vehicle of its own, as passes and windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from smooth_wheelset import SmoothTable, mems_windows, run, track
from window_passes import window_passes

from estimation.jobs.settings import EstimationSettings
from estimation.track.passes import Pass
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.simulator.running_gear import RunningGear, simulate_gear
from ingest.simulator.track import TrackTruth

SETTINGS = EstimationSettings()
RUNS = ((0.05, 17.0), (0.10, 18.0), (0.16, 19.0), (0.07, 21.0), (0.12, 22.0), (0.16, 23.0))  # cone, speed
SECONDS = 120


@cache
def windows(number: int, seed: int = 1) -> tuple[Window, ...]:
    """Return the windows of a run, positions right."""
    cone, speed = RUNS[number]
    found = mems_windows(run(SECONDS, seed=seed, cone=cone, speed=speed), seed=10 * seed + number)
    return tuple(_named(window, number) for window in found)


def _named(window: Window, number: int) -> Window:
    return replace(window, wheelset=f"W{number}", vehicle=f"V{number}")


@cache
def turned_windows(number: int, seed: int = 1) -> tuple[Window, ...]:
    """Return the windows of the same wheelset, run the other way: its vehicle's axes are turned half round."""
    cone, speed = RUNS[number]
    truth = track(seed)
    length = float(truth.s[-1])
    seen = TrackTruth(length - truth.s[::-1], -truth.alignment[::-1], truth.gauge_deviation[::-1])
    begin = length - SECONDS * speed - 60.0
    motion = simulate_gear(RunningGear(), [SmoothTable(cone)], seen, np.full(SECONDS * 1000, speed), begin)[0]
    found = mems_windows(motion, seed=10 * seed + number + 500)
    return tuple(_named(replace(w, distance=length - w.distance), number) for w in found)


def made(found: Sequence[Window], *, mounted_reversed: bool = False) -> list[Pass]:
    """Return the passes of windows."""
    return [
        item
        for window in found
        for item in window_passes(window, VehicleParameters(), mounted_reversed=mounted_reversed)
    ]


@cache
def valid_passes(seed: int = 1) -> tuple[Pass, ...]:
    """Return the passes of all runs."""
    return tuple(item for number in range(len(RUNS)) for item in made(windows(number, seed)))


def mirror_mounted(found: Sequence[Window]) -> list[Window]:
    """Return windows as sensors turned half round about the vertical would have made them: axes against the running."""
    return [
        replace(
            w,
            lateral_acceleration=-w.lateral_acceleration,
            roll_acceleration=-w.roll_acceleration,
            mass_lateral_acceleration=-w.mass_lateral_acceleration,
        )
        for w in found
    ]
