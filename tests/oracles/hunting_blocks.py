"""Hunting looked for block by block, each in full, as the fast form must find it."""

from __future__ import annotations

import numpy as np

from estimation.motion import hunting
from estimation.values.arrays import FloatArray
from estimation.values.windows import NOT_HUNTING, Hunting


def find_hunting(lateral: FloatArray, yaw: FloatArray, speed: FloatArray, interval_s: float) -> Hunting:
    """Return how much of some running time a wheelset hunts, at which frequency and how far."""
    size = round(hunting.HUNTS.block_s / interval_s)
    running, found = 0, []
    for start in range(0, len(lateral) - size + 1, size):
        part = slice(start, start + size)
        fast = float(np.nan_to_num(np.mean(speed[part])))
        if fast < hunting.HUNTS.least_speed:
            continue
        running += 1
        line = hunting._line(lateral[part], yaw[part], fast, interval_s)
        if line is not None and line.hunts:
            found.append(line)
    if not found:
        return NOT_HUNTING
    frequency = float(np.median([line.frequency_hz for line in found]))
    return Hunting(len(found) / running, frequency, float(np.median([line.amplitude for line in found])))
