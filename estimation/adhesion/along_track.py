"""The friction of places that adjoin: what passes say of each, and that friction mostly changes little over a place.

A chain over the places with 1/mu on a grid (a hidden Markov model, Rabiner 1989). From a place to the next one the
logarithm of 1/mu changes with a std; some places have nothing in common with the one before, as leaf fall has a
sharp end: they begin with what is known of rails beforehand.

What the passes of a place have wrong in common: the std of 1/mu that no pass more makes smaller.

All passes meet the same track: what its alignment, its gauge, its cross level and curves put into e is the same in all
of them, and their scatter does not show it. It is in what is left of e, though: were all of that common to the passes,
a place would be known as one pass alone would know it. How much of it is common the places show themselves. Creep
cannot be less than linear: a place that seems to say so is wrong by that much at least.

By how much the linear creep of vehicles differs from that of their class, from the level of their creep.

The level of a place is what e shows in proportion to q, whatever its shape. Half of the places of a section, at least,
are rails as rails are: over the places of a vehicle the median of what exceeds the creep of usual rails is its b, as
far as b is likely at all. The shape of e over q says nothing of b here: what alignment, curves, cross level and contact
jumps put into e has a shape, too, and quiet sensors would make it sure that a b of that shape, and rails of a tenth of
their friction, are there.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.adhesion.parameters import FrictionParameters
from estimation.adhesion.pass_sums import PassSums
from estimation.values.arrays import BoolArray, FloatArray, IntArray, frozen_array
from estimation.values.opinions import INVERSE

POINTS = 160
GRID = frozen_array(np.geomspace(1.0, INVERSE[-1], POINTS), (POINTS,), name="GRID")
"""(g,) 1/mu, each a constant part above the one before: steps in the logarithm are alike."""

WRONG_SHARE, WRONG_BY = 0.05, 3.0  # of places, whose error is so many times that of the others
LEAST_LIKELIHOOD = 1e-12  # of the largest: no place makes another one impossible


def along_track(
    cells: IntArray, misfits: FloatArray, place_std: FloatArray, parameters: FrictionParameters
) -> tuple[FloatArray, FloatArray]:
    """Return 1/mu of the places and its std (c,), each from all of them.

    Args:
        cells: (c,) numbers of the places, rising; the chain begins again behind a gap.
        misfits: (c, k) twice the negative logarithm of the likelihood at each of ``INVERSE``, but for a constant.
        place_std: (c,) error of 1/mu of each place that all its passes share.
    """
    width = np.gradient(GRID)
    prior = np.exp(-0.5 * ((GRID - parameters.usual) / parameters.usual_std) ** 2) * width
    prior /= prior.sum()
    logarithm = np.log(GRID)
    steps = np.exp(-0.5 * ((logarithm[:, None] - logarithm) / parameters.change_std) ** 2)
    steps = (1.0 - parameters.fresh) * steps / steps.sum(axis=1, keepdims=True) + parameters.fresh * prior
    likelihoods = _likelihoods(misfits, place_std, width)
    adjoins = np.diff(cells) == 1
    forward, back = np.empty_like(likelihoods), np.ones_like(likelihoods)
    for place, likelihood in enumerate(likelihoods):
        before = forward[place - 1] @ steps if place and adjoins[place - 1] else prior
        forward[place] = _normal(before * likelihood)
    for place in range(len(cells) - 2, -1, -1):
        if adjoins[place]:
            back[place] = _normal(steps @ (back[place + 1] * likelihoods[place + 1]))
    posterior = forward * back
    posterior /= posterior.sum(axis=1, keepdims=True)
    mean = posterior @ GRID
    return mean, np.sqrt(np.maximum(posterior @ GRID**2 - mean**2, 0.0))


def _likelihoods(misfits: FloatArray, place_std: FloatArray, width: FloatArray) -> FloatArray:
    """Return the likelihood (c, g) of 1/mu on the grid, over its largest; the error of a place widens it."""
    values = CubicSpline(INVERSE, misfits, axis=1)(GRID)
    own = np.exp(-0.5 * (values - values.min(axis=1, keepdims=True)))
    widened = np.empty_like(own)
    for std in np.unique(place_std):
        spread = (1.0 - WRONG_SHARE) * _spread(std, width) + WRONG_SHARE * _spread(WRONG_BY * std, width)
        widened[place_std == std] = own[place_std == std] @ spread.T
    return np.asarray(widened / widened.max(axis=1, keepdims=True) + LEAST_LIKELIHOOD)


def _spread(std: float, width: FloatArray) -> FloatArray:
    """Return the probabilities (g, g) of what a place shows, by row, at each 1/mu that it may have, by column."""
    spread = np.exp(-0.5 * ((GRID[:, None] - GRID) / std) ** 2) * width
    return np.asarray(spread / spread.sum(axis=1, keepdims=True))


def _normal(values: FloatArray) -> FloatArray:
    return np.asarray(values / values.sum())


BEST = 2.0  # 1/mu of the best rails: what places show below is error
LOWEST = 0.1  # share of the places that may be below by their errors alone
BELOW = 1.2816  # stds from the mean to that quantile
LEAST_COMMON = 0.4  # std of what is common over all that is left: no section shows less
PLACES_BEFORE = 20.0  # that are worth as much as the expectation that all of it is common
TINY = np.finfo(float).tiny


def common_std(sums: PassSums, inverse: FloatArray, creep: FloatArray, slope: FloatArray, usual: float) -> FloatArray:
    """Return the std of 1/mu (c,) that what all passes of a place have in common leaves.

    Args:
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


MEDIAN_ERROR = 1.2533  # std of a median over that of a mean
ROBUST = 1.4826  # std over median absolute deviation


def creep_levels(
    sums: PassSums, slope: FloatArray, slippery: BoolArray, before: FrictionParameters
) -> tuple[FloatArray, float]:
    """Return b (v,) of the vehicles, and the std that what all share leaves to it.

    Args:
        slippery: (c,) places that are no usual rails; a vehicle that has met them for the most part is held against all
            of its.
    """
    usual = sums.at(np.full(len(sums.cells), before.usual))[2]
    entry = sums.vehicle * len(sums.cells) + sums.place
    left = sums.squares[:, 1] - slope[sums.wheelset] * sums.squares[:, 4] - usual
    passed, index = np.unique(entry, return_inverse=True)
    square = _summed(sums.squares[:, 2], index, len(passed)) + TINY
    exceeds, expected = _summed(left, index, len(passed)) / square, _summed(usual, index, len(passed)) / square
    vehicle = passed // len(sums.cells)
    by_rails = before.level_std * float(np.median(expected)) / before.usual
    usual_rails = ~slippery[passed % len(sums.cells)]
    found = []
    for one in range(len(sums.vehicles)):
        of_vehicle = vehicle == one
        chosen = of_vehicle & usual_rails
        chosen = chosen if 2 * chosen.sum() >= of_vehicle.sum() else of_vehicle
        found.append(_shrunk(exceeds[chosen], by_rails, before.creep_error_std))
    return np.array(found), float(1.0 / np.sqrt(before.creep_error_std**-2 + by_rails**-2))


def _shrunk(exceeds: FloatArray, by_rails: float, likely: float) -> float:
    """Return the median of what places (p,) exceed the usual by, as far as a b of std ``likely`` is its cause."""
    middle = float(np.median(exceeds))
    spread = ROBUST * float(np.median(np.abs(exceeds - middle)))
    sampled = MEDIAN_ERROR * spread / np.sqrt(len(exceeds))
    return float(middle * likely**2 / (likely**2 + by_rails**2 + sampled**2))


def _summed(values: FloatArray, index: IntArray, count: int) -> FloatArray:
    return np.asarray(np.bincount(index, weights=values, minlength=count), np.float64)
