"""Where along y - d there are data: a count by displacement, and its uninterrupted range around zero."""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.windows import Motion

WIDTH = 0.25e-3  # m
REACH = 7.0e-3  # m
CELLS = round(2 * REACH / WIDTH)
LEAST_SAMPLES = 100


def usable(motion: Motion) -> BoolArray:
    """Return the samples (n,) that an estimator may use."""
    return np.asarray(
        motion.valid & (motion.block >= 0) & np.isfinite(motion.displacement) & (np.abs(motion.displacement) < REACH)
    )


def counted(displacement: FloatArray, values: FloatArray | None = None) -> FloatArray:
    """Return the number of samples, or the sum of values, (CELLS,) in each cell of ``WIDTH`` over +-``REACH``.

    Args:
        displacement: (n,) m, within the reach.
        values: (n,) of any unit; None to count.
    """
    cell = np.floor((displacement + REACH) / WIDTH).astype(np.int64)
    return np.bincount(cell, values, minlength=CELLS).astype(np.float64)


def beside(x: FloatArray, value: FloatArray, sums: FloatArray, counts: FloatArray) -> FloatArray:
    """Return by how much the mean of each cell is above a curve, straight between cells: (n,).

    Args:
        x, value: (n,) m, the curve.
        sums, counts: (CELLS,) by cell.
    """
    middles = (np.arange(CELLS) + 0.5) * WIDTH - REACH
    known = (counts >= LEAST_SAMPLES) & (middles > x[0]) & (middles < x[-1])
    if not known.any():
        return np.zeros(len(x))
    apart = sums[known] / counts[known] - np.interp(middles[known], x, value)
    return np.asarray(np.interp(x, middles[known], apart))


def covered_range(counts: FloatArray) -> tuple[float, float] | None:
    """Return from where to where, m, every cell has ``LEAST_SAMPLES``, zero inside; None where there is no such run."""
    enough = counts >= LEAST_SAMPLES
    middle = CELLS // 2
    right = middle + int(np.argmin(np.append(enough[middle:], False)))
    left = middle - int(np.argmin(np.append(enough[:middle][::-1], False)))
    if middle in {left, right}:
        return None
    return left * WIDTH - REACH, right * WIDTH - REACH
