"""Contact jumps of an estimated curve: where it rises steeply within a short way, it rises in one place.

A contact point jumps at one displacement. What is left of the error of y - d spreads the step over some 0.1 mm, evenly
to both sides; so the jump is in the mean of the rise. A rise that is spread further is left as it is: wheels have steep
parts without any jump.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimation.values.arrays import FloatArray

STEEP = 3.0  # times the median slope
LEAST_STEP = 0.12e-3  # m of R
MOST_SPREAD = 0.08e-3  # m, std of the rise over y - d
REACH = 4.0e-3  # m of y - d: beyond are the flanges
BESIDE = 1e-8  # m, from a jump to the points on both of its sides


class Stepped(NamedTuple):
    """A curve with points close to both sides of each jump."""

    displacement: FloatArray  # (n,) m
    difference: FloatArray  # (n,) m
    jumps: FloatArray  # (j,) m, where they are


def stepped(x: FloatArray, curve: FloatArray) -> Stepped:
    """Return a curve whose contact jumps are each in one place.

    Args:
        x, curve: (n,) m, displacement at even distances, and R.
    """
    width = x[1] - x[0]
    middles, rise = 0.5 * (x[1:] + x[:-1]), np.diff(curve)
    near = np.abs(middles) < REACH
    usual = float(np.median(rise[near])) if near.any() else 0.0
    steep = near & (rise > STEEP * max(usual, 0.0)) & (rise > 0.0)
    beyond = np.where(steep, rise - usual, 0.0)
    bounds = np.flatnonzero(np.diff(np.concatenate([[0], steep.astype(np.int64), [0]])))
    places, steps = [], []
    smooth = rise.copy()
    for first, behind in bounds.reshape(-1, 2):
        part = slice(first, behind)
        step = float(beyond[part].sum())
        place = float(beyond[part] @ middles[part]) / step
        spread = np.sqrt(float(beyond[part] @ (middles[part] - place) ** 2) / step + width**2 / 12.0)
        if step >= LEAST_STEP and spread <= MOST_SPREAD:
            places.append(place)
            steps.append(step)
            smooth[part] -= beyond[part]
    jumps, heights = np.array(places), np.array(steps)
    points = np.sort(np.concatenate([x, jumps - BESIDE, jumps + BESIDE]))
    base = np.interp(points, x, np.append(curve[0], curve[0] + np.cumsum(smooth)))
    return Stepped(points, base + (points[:, None] > jumps) @ heights, jumps)
