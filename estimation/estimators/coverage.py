"""Where along y - d there are data: a count by displacement, and its uninterrupted range around zero."""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.motion import Motion

WIDTH = 0.25e-3  # m
REACH = 7.0e-3  # m
CELLS = round(2 * REACH / WIDTH)
LEAST_SAMPLES = 100


def usable(motion: Motion) -> BoolArray:
    """Return the samples (n,) that an estimator may use."""
    return np.asarray(
        motion.valid & (motion.block >= 0) & np.isfinite(motion.displacement) & (np.abs(motion.displacement) < REACH)
    )


def counted(displacement: FloatArray) -> FloatArray:
    """Return the number of samples (CELLS,) in each cell of ``WIDTH`` over +-``REACH``."""
    cell = np.floor((displacement + REACH) / WIDTH).astype(np.int64)
    return np.bincount(cell, minlength=CELLS).astype(np.float64)


def covered_range(counts: FloatArray) -> tuple[float, float] | None:
    """Return from where to where, m, every cell has ``LEAST_SAMPLES``, zero inside; None where there is no such run."""
    enough = counts >= LEAST_SAMPLES
    middle = CELLS // 2
    right = middle + int(np.argmin(np.append(enough[middle:], False)))
    left = middle - int(np.argmin(np.append(enough[:middle][::-1], False)))
    if middle in {left, right}:
        return None
    return left * WIDTH - REACH, right * WIDTH - REACH
