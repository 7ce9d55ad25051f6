"""Speed and odometer of a vehicle: what neither can be, and whether they go together."""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import FloatArray, IntArray

MOST_SPEED = 200.0  # m/s
MOST_ODOMETER = 1e11  # m; the registry takes no more either
SPARE_M = 30.0  # by which odometer and speed may differ within a window
SPARE_SHARE = 0.2  # of the distance run, besides: wheels slip, and their radius on file is another
STEPS = 2.0  # of the odometer, besides


def possible_motion(values: FloatArray) -> FloatArray:
    """Return speed and odometer (n, 2) with NaN where no vehicle has such a one.

    Args:
        values: (n, 2) m/s and m.
    """
    found = values.copy()
    with np.errstate(invalid="ignore"):
        found[~(np.abs(found[:, 0]) <= MOST_SPEED), 0] = np.nan
        found[~((found[:, 1] >= 0.0) & (found[:, 1] <= MOST_ODOMETER)), 1] = np.nan
    return found


def odometer_excess(tick: IntArray, values: FloatArray, interval_s: float, longest: int) -> float:
    """Return by how much odometer and integral of the speed differ beyond what they may, m; 0 where they do not.

    Args:
        values: (n, 2) speed, m/s, and odometer, m; NaN where not known.
    """
    known = ~np.isnan(values).any(axis=1)
    at, (speed, odometer) = tick[known], values[known].T
    near = np.diff(at) <= longest
    run = (0.5 * interval_s * np.diff(at) * (np.abs(speed[1:]) + np.abs(speed[:-1])))[near]
    steps = np.abs(np.diff(odometer))[near]
    if not near.any():
        return 0.0
    step = float(np.median(steps[steps > 0.0])) if steps.any() else 0.0
    allowed = SPARE_M + SPARE_SHARE * float(run.sum()) + STEPS * step
    return max(float(np.abs(np.cumsum(steps - run)).max()) - allowed, 0.0)
