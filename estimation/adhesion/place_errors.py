"""What the passes of a place have wrong in common: the std of 1/mu that no pass more makes smaller.

All passes meet the same track: what its alignment, its gauge, its cross level and curves put into e is the same in all
of them, and their scatter does not show it. It is in what is left of e, though: were all of that common to the passes,
a place would be known as one pass alone would know it. How much of it is common the places show themselves. Creep
cannot be less than linear: a place that seems to say so is wrong by that much at least.
"""

from __future__ import annotations

import numpy as np

from estimation.adhesion.pass_sums import PassSums
from estimation.values.arrays import FloatArray

BEST = 2.0  # 1/mu of the best rails: what places show below is error
LOWEST = 0.1  # share of the places that may be below by their errors alone
BELOW = 1.2816  # stds from the mean to that quantile
LEAST_COMMON = 0.4  # std of what is common over all that is left: no section shows less
PLACES_BEFORE = 20.0  # that are worth as much as the expectation that all of it is common
TINY = np.finfo(float).tiny


def common_std(sums: PassSums, inverse: FloatArray, creep: FloatArray, slope: FloatArray, usual: float) -> FloatArray:
    """Return the std of 1/mu (c,) that what all passes of a place have in common leaves.

    Args:
        inverse: (c,) 1/mu of the places.
        creep: (v,) b of the vehicles.
        slope: (w,) a of the wheelsets.
        usual: 1/mu about which creep is taken to be in proportion to it.
    """
    b, a = creep[sums.vehicle], slope[sums.wheelset]
    _, gg, gq, _ = sums.at(np.full(len(sums.cells), usual))
    samples, left = sums.by_place(sums.samples), sums.by_place(_left(sums, inverse, b, a))
    variance = np.maximum(left / samples, left.sum() / samples.sum())
    one_pass = usual * np.sqrt(np.maximum(variance, 0.0) * sums.counts / (sums.by_place(gg) + TINY))
    level = sums.by_place(sums.squares[:, 1] - b * sums.squares[:, 2] - a * sums.squares[:, 4])
    by_level = usual * level / (sums.by_place(gq) + TINY)
    return np.asarray(_common_share((by_level - BEST) / (one_pass + TINY)) * one_pass)


def _common_share(beyond: FloatArray) -> float:
    """Return the std of what is common, in parts of what one pass leaves, from where places (c,) seem to be."""
    shown = max(-float(np.quantile(beyond, LOWEST)) / BELOW, LEAST_COMMON)
    places = len(beyond)
    return float(np.sqrt((places * shown**2 + PLACES_BEFORE) / (places + PLACES_BEFORE)))


def _left(sums: PassSums, inverse: FloatArray, b: FloatArray, a: FloatArray) -> FloatArray:
    """Return the sum of squares (n,) of what is left of e; ``b`` and ``a`` (n,) are those of each entry."""
    ee, eq, qq, ex, qx, xx = sums.squares.T
    ge, gg, gq, gx = sums.at(inverse)
    linear = b * (b * qq - 2.0 * eq + 2.0 * gq) + a * (a * xx - 2.0 * ex + 2.0 * gx) + 2.0 * a * b * qx
    return np.asarray(np.maximum(ee + gg - 2.0 * ge + linear, 0.0))
