"""Where an estimated curve rL - rR begins: band-limited signals carry no offset, in displacement or radius."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.values.geometry import WheelsetGeometry

SEARCHED = 0.6e-3  # m
SEARCH_STEP = 5e-6  # m
MOST_DEVIATION = 3.0  # standard deviations that one bin counts at most


@dataclass(frozen=True, slots=True)
class CurveOrigin:
    """The point of a known curve from which the estimated one is counted."""

    displacement: float  # m
    difference: float  # rL - rR there, m


def curve_origin(
    found: WheelsetGeometry, displacement: FloatArray, difference: FloatArray, crossing: float
) -> CurveOrigin:
    """Return the point of a known curve rL - rR from which an estimated one is counted.

    The estimated curve has its origin at the mean of both: it may be anywhere along the known curve, with its own R
    zero on average. The place where it fits best is taken; a wheelset of unlike wheels runs nearer to the track centre
    than its zero crossing is.

    Args:
        displacement, difference: (n,) m, the known curve.
        crossing: Its zero crossing, m.
    """
    centre, R = found.bin_centres, found.rolling_radius_difference
    known = np.isfinite(R.value)
    if not known.any():
        return CurveOrigin(crossing, 0.0)
    best = (np.inf, crossing, 0.0)
    low, high = min(crossing, 0.0) - SEARCHED, max(crossing, 0.0) + SEARCHED
    for shift in np.linspace(low, high, round((high - low) / SEARCH_STEP) + 1):
        curve = np.interp(centre + shift, displacement, difference)
        mean = float(found.samples @ curve / found.samples.sum())
        deviation = (R.value - curve + mean)[known] / R.std[known]
        misfit = float(np.minimum(deviation**2, MOST_DEVIATION**2).sum())
        best = min(best, (misfit, float(shift), mean))
    return CurveOrigin(best[1], best[2])
