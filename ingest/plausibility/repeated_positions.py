"""Positions that a vehicle repeats while it runs: without reception, in a tunnel, many units send their last one again.

The first of equal positions was measured, where another one was before it. Where the next one that differs is as far
on as the speed says, the vehicle has been where the speed puts it in between; otherwise its place is not known there.
"""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import FloatArray, IntArray

LEAST_RUN = 2.0  # m: less is the resolution of a position
SPARE_M = 1.0  # by which positions before and behind may differ from the speed
SPARE_SHARE = 0.02  # of the distance run, besides
SECTION, DISTANCE = 0, 1


def without_repeats(tick: IntArray, values: FloatArray, run: FloatArray) -> FloatArray:
    """Return positions (n, m) with those that repeat replaced by where the vehicle was, or NaN.

    Args:
        tick: (n,) instants of the frames.
        values: (n, m) section and distance, m, and what else is sent; NaN where not available.
        run: (n,) m that the vehicle has run by the speed; NaN where that is not known.
    """
    if len(tick) < 2:  # noqa: PLR2004 - nothing is repeated
        return values
    place = values[:, (SECTION, DISTANCE)]
    begins = np.flatnonzero(np.concatenate([[True], np.any(place[1:] != place[:-1], axis=1)]))
    behind = np.append(begins[1:], len(tick))
    with np.errstate(invalid="ignore"):
        repeated = run[np.minimum(behind, len(tick) - 1)] - run[begins] > LEAST_RUN
    repeated &= behind - begins > 1
    if not repeated.any():
        return values
    found = values.copy()
    for first, last in zip(begins[repeated], behind[repeated], strict=True):
        found[first + 1 : last, DISTANCE] = _between(values, run, int(first), int(last))
    if repeated[0]:
        found[: behind[0], DISTANCE] = np.nan  # it may have been repeated before
    return found


def _between(values: FloatArray, run: FloatArray, first: int, behind: int) -> FloatArray:
    """Return the distances of the frames between ``first`` and ``behind``, by the speed."""
    nowhere = np.full(behind - first - 1, np.nan)
    if behind == len(run) or values[behind, SECTION] != values[first, SECTION]:
        return nowhere
    moved, rolled = values[behind, DISTANCE] - values[first, DISTANCE], run[behind] - run[first]
    if not abs(abs(moved) - rolled) <= SPARE_M + SPARE_SHARE * rolled:
        return nowhere
    passed = (run[first + 1 : behind] - run[first]) / rolled
    return np.asarray(values[first, DISTANCE] + moved * passed)
