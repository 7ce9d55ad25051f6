"""Which samples of a second clipped, where its status frame says that some did."""

from __future__ import annotations

import numpy as np

from estimation.motion.blows import struck
from estimation.values.arrays import BoolArray, FloatArray, runs
from estimation.values.windows import ACCELERATIONS

OF_BOX = [ACCELERATIONS.index(name) for name in ("lateral_acceleration", "yaw_acceleration", "roll_acceleration")]
LATERAL, _, ROLL = OF_BOX


def narrowed(marked: BoolArray, values: FloatArray, interval_s: float) -> BoolArray:
    """Return the marked samples (n,), of seconds that blows explain only those that the blows have spoilt.

    They do where the largest accelerations of the axle box are in them. What hunts or runs rough clips all the time.

    Args:
        marked: (n,) samples of the seconds in which the axle box clipped.
        values: (n, 4) in the order of ``ACCELERATIONS``, at the ends of their ranges too; NaN where not known.
    """
    if not marked.any():
        return marked
    spoilt = struck(values[:, LATERAL], values[:, ROLL], interval_s)
    found = marked.copy()
    for first, behind in runs(marked):
        part = slice(int(first), int(behind))
        sizes = np.nan_to_num(np.abs(values[part, :][:, OF_BOX]))
        if spoilt[part].any() and spoilt[part][np.argmax(sizes, axis=0)].all():
            found[part] = spoilt[part]
    return found
