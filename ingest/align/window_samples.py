"""The loops over every sample of a window, compiled: which samples count, and where they are on its grid."""

from __future__ import annotations

import numpy as np

from estimation.compiled import compiled
from estimation.values.arrays import BoolArray, FloatArray, IntArray


@compiled(nogil=True)
def good_samples(
    slot: IntArray, valid: BoolArray, clipped: BoolArray, speed: FloatArray, guard: int
) -> tuple[BoolArray, int]:
    """Return which samples (k,) are valid where the speed is known, and how many that is.

    Args:
        slot: (k,) where each is on the grid, ascending.
        valid: (k, m) of each signal.
        clipped: (k,) which samples clip; they spoil those near them.
        speed: (n,) on the grid; NaN where not known.
        guard: How many slots near to a clipped sample others are left out.
    """
    good = np.zeros(len(slot), np.bool_)
    count = 0
    for i in range(len(slot)):
        fit = not np.isnan(speed[slot[i]])
        for j in range(valid.shape[1]):
            fit &= valid[i, j]
        good[i] = fit
        count += fit
    last = -guard - 1
    for i in range(len(slot)):
        if clipped[i]:
            last = slot[i]
            at = i
            while at >= 0 and slot[i] - slot[at] <= guard:
                count -= good[at]
                good[at] = False
                at -= 1
        elif slot[i] - last <= guard:
            count -= good[i]
            good[i] = False
    return good, count


@compiled(nogil=True)
def range_of(numbers: IntArray, slot: IntArray, good: BoolArray) -> tuple[int, int]:
    """Return the smallest and the largest of the numbers (n,) at the slots (k,) of good samples, at least one."""
    smallest, largest = np.iinfo(np.int64).max, np.iinfo(np.int64).min
    for i in range(len(slot)):
        if good[i]:
            smallest = min(smallest, numbers[slot[i]])
            largest = max(largest, numbers[slot[i]])
    return smallest, largest


@compiled(nogil=True)
def on_section(distance: FloatArray, forward: FloatArray, section: IntArray, number: int, offset: float) -> FloatArray:
    """Return the distance (n,) of a wheelset along a section, NaN where it is off it.

    Args:
        distance, forward, section: (n,) of the vehicle's reference point.
        offset: Of the wheelset behind the reference point, m.
    """
    found = np.full(len(distance), np.nan)
    for i in range(len(distance)):
        own = distance[i] - forward[i] * offset
        if section[i] == number and own >= 0.0:
            found[i] = own
    return found


@compiled(nogil=True)
def gridded(values: FloatArray, slot: IntArray, good: BoolArray, count: int, signals: int) -> FloatArray:
    """Return the first signals (signals, count) of good samples on the grid, NaN elsewhere.

    Args:
        values: (k, m) by sample.
        slot, good: (k,) of the samples.
        count, signals: Length of the grid; how many of the m signals.
    """
    found = np.full((signals, count), np.nan)
    for i in range(len(slot)):
        if good[i]:
            for j in range(signals):
                found[j, slot[i]] = values[i, j]
    return found


@compiled(nogil=True)
def gaps_of(valid: BoolArray) -> tuple[int, int]:
    """Return how many gaps there are among valid samples (n,), and the length of the longest."""
    gaps = longest = length = 0
    for i in range(len(valid)):
        if valid[i]:
            length = 0
        else:
            gaps += length == 0
            length += 1
            longest = max(longest, length)
    return gaps, longest


@compiled(nogil=True)
def between_frames(
    count: int, tick: IntArray, values: FloatArray, slope: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return linear values on a grid that begins at 0, their slopes, and the frame at or before each slot.

    Values and slopes are NaN before the first frame, the frame is -1 there.

    Args:
        tick: (k,) slots of the frames, strictly increasing; they may be before the grid or behind it.
        values, slope: (k,) at each frame, and until the next.
    """
    found, slopes, before = np.full(count, np.nan), np.full(count, np.nan), np.full(count, -1)
    at = -1
    for i in range(count):
        while at + 1 < len(tick) and tick[at + 1] <= i:
            at += 1
        if at >= 0:
            before[i] = at
            since = i - tick[at]
            found[i] = values[at] + slope[at] * since if since else values[at]
            slopes[i] = slope[at]
    return found, slopes, before
