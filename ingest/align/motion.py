"""How fast the vehicle ran and where it was, on any sampling grid: between neighbouring frames, never beyond."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray, IntArray, frozen_array
from ingest.align.clock import TickedValues
from ingest.catalogue import MOTION, POSITION, VEHICLE_NODE
from ingest.codec import MessageValues

LONGEST_GAP_NS = 1_000_000_000
"""Frames further apart than this are not interpolated between."""

NO_SECTION = -1


@dataclass(frozen=True, slots=True)
class Track:
    """A quantity of the vehicle node at the instants of its frames; NaN where it said "not available"."""

    tick: IntArray  # (n,) strictly increasing
    values: FloatArray  # (n, m)

    def __post_init__(self) -> None:
        n = len(self.tick)
        object.__setattr__(self, "tick", frozen_array(self.tick, (n,), np.int64, name="tick"))
        object.__setattr__(self, "values", frozen_array(self.values, (n, None), name="values"))


@dataclass(frozen=True, slots=True)
class GridMotion:
    """Speed and place of the vehicle's reference point on a grid; NaN or ``NO_SECTION`` where unknown."""

    speed: FloatArray  # (n,) m/s
    distance: FloatArray  # (n,) m along the section
    forward: FloatArray  # (n,) 1 where distance grows or stands, -1 where it falls
    section: IntArray  # (n,) number
    position_quality: FloatArray  # (n,) 0 to 1, 0 where unknown
    odometer_m: float  # at the first grid point


@dataclass(frozen=True, slots=True)
class VehicleMotion:
    """Frames of the vehicle node on the vehicle's clock."""

    interval_ns: int
    motion: Track  # speed, odometer
    position: Track  # track section, distance, quality

    def on_grid(self, first_tick: int, count: int) -> GridMotion:
        """Return the motion at ``count`` sampling instants from ``first_tick``."""
        reach = LONGEST_GAP_NS // self.interval_ns
        grid = np.arange(count, dtype=np.int64)
        moved, where = (_near(track, first_tick, count, reach) for track in (self.motion, self.position))
        speed, _ = _between(grid, moved.tick, moved.values[:, 0], reach)
        one_section = np.zeros(len(where.tick), dtype=np.bool_)
        one_section[:-1] = where.values[1:, 0] == where.values[:-1, 0]
        distance, slope = _between(grid, where.tick, where.values[:, 1], reach, one_section)
        before = np.clip(np.searchsorted(where.tick, grid, side="right") - 1, 0, None)
        known = np.zeros(count, dtype=np.bool_)
        if len(where.tick):
            known = ~(np.isnan(distance) | np.isnan(where.values[before, 0]))
        section, quality = np.full(count, NO_SECTION, np.int64), np.zeros(count)
        section[known] = where.values[before[known], 0].astype(np.int64)
        quality[known] = np.nan_to_num(where.values[before[known], 2], nan=0.0)
        forward = np.where(slope < 0.0, -1.0, 1.0)
        return GridMotion(speed, distance, forward, section, quality, self._odometer(moved))

    def _odometer(self, moved: Track) -> float:
        """Return the odometer at tick 0 of ``moved``, from the frame with both values nearest to it; NaN without."""
        usable = np.flatnonzero(~np.isnan(moved.values).any(axis=1))
        if len(usable) == 0:
            return float("nan")
        nearest = usable[np.argmin(np.abs(moved.tick[usable]))]
        speed, odometer = moved.values[nearest]
        return float(odometer - speed * moved.tick[nearest] * self.interval_ns * 1e-9)


def vehicle_motion(messages: Mapping[int, TickedValues], interval_ns: int) -> VehicleMotion:
    """Return place and speed of a vehicle; without frames of its vehicle node everything is unknown.

    Parameters
    ----------
    messages
        Its frames on its clock, by arbitration id.
    interval_ns
        Sampling interval, ns.
    """
    motion = _track(messages, MOTION, ("speed", "odometer"))
    return VehicleMotion(
        interval_ns, motion, _track(messages, POSITION, ("track_section", "distance", "position_quality"))
    )


def _track(messages: Mapping[int, TickedValues], kind: str, names: tuple[str, ...]) -> Track:
    found = (m for m in messages.values() if m.plan.kind == kind and m.plan.node == VEHICLE_NODE)
    ticked = next(found, None)
    if ticked is None:
        return Track(np.empty(0, np.int64), np.empty((0, len(names))))
    values = MessageValues(ticked.plan, np.arange(len(ticked.tick)), ticked.raw).values()
    values[ticked.conflict] = np.nan
    return Track(ticked.tick, values[:, [ticked.plan.names.index(name) for name in names]])


def _near(track: Track, first_tick: int, count: int, reach: int) -> Track:
    """Return the part of a track that can matter to a grid, with ticks counted from the grid's first."""
    low, high = np.searchsorted(track.tick, [first_tick - reach, first_tick + count + reach])
    return Track(track.tick[low:high] - first_tick, track.values[low:high])


def _between(
    grid: IntArray, tick: IntArray, values: FloatArray, reach: int, joined: BoolArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return linear values (n,) between neighbours at most ``reach`` apart, and their slope; NaN elsewhere.

    ``joined`` (k,) says of each frame whether it may be joined to the next.
    """
    if len(tick) == 0:
        return np.full(len(grid), np.nan), np.full(len(grid), np.nan)
    step = np.diff(tick, append=tick[-1] + 1)
    slope = np.diff(values, append=np.nan) / step
    slope[step > reach] = np.nan
    if joined is not None:
        slope[~joined] = np.nan
    at = np.searchsorted(tick, grid, side="right") - 1
    since = grid - tick[at]
    inside = np.where(at >= 0, values[at] + slope[at] * since, np.nan)
    on_frame = (at >= 0) & (since == 0)
    return np.where(on_frame, values[at], inside), np.where(at >= 0, slope[at], np.nan)
