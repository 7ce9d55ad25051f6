"""Whether a section is slippery for the most part, or all its vehicles creep by more than their class.

The level of creep is the same for both. More creep than two stds of what a class leaves open is unlikely for all
vehicles alike; then the shape decides: an error of linear creep leaves squares that no friction takes up, slippery
rails leave none of them.
"""

from __future__ import annotations

import numpy as np

from estimation.adhesion.pass_sums import PassSums
from estimation.values.arrays import FloatArray

MOST_CREEP = 2.0  # stds of b that all vehicles have in common, from which the shape is asked
LEAST_SUPPORT = 0.8  # of the squares that an error of linear creep would leave, to be taken for one


def slippery_throughout(sums: PassSums, creep: FloatArray, slope: FloatArray, creep_error_std: float) -> bool:
    """Return whether it is the rails that make the creep of all vehicles large.

    Args:
        creep: (v,) b of the vehicles against usual rails.
        slope: (w,) a of the wheelsets.
    """
    common = float(np.mean(creep))
    if common < MOST_CREEP * creep_error_std:
        return False
    by_rails, by_creep = (_left(sums, b, slope) for b in (creep - common, creep))
    gg, gq = sums.saturated[:, 1], sums.saturated[:, 2]
    square = common**2 * float(sums.squares[:, 2].sum())
    error_alone = square + float(sums.by_place(gg - 2.0 * common * gq).min(axis=1).sum())
    return by_rails - by_creep < LEAST_SUPPORT * error_alone


def _left(sums: PassSums, creep: FloatArray, slope: FloatArray) -> float:
    """Return the squares of e that are left where each place has the friction that fits it best, but for a constant."""
    b, a = creep[sums.vehicle], slope[sums.wheelset]
    _, eq, qq, _, qx, _ = sums.squares.T
    ge, gg, gq, gx = (sums.saturated[:, row] for row in range(4))
    linear = b * (b * qq - 2.0 * eq + 2.0 * a * qx)
    saturated = gg - 2.0 * ge + 2.0 * b[:, None] * gq + 2.0 * a[:, None] * gx
    return float(linear.sum() + sums.by_place(saturated).min(axis=1).sum())
