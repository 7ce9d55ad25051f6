"""The friction of places that adjoin: what passes say of each, and that friction mostly changes little over a place.

A chain over the places with 1/mu on a grid (a hidden Markov model, Rabiner 1989). From a place to the next one the
logarithm of 1/mu changes with a std; some places have nothing in common with the one before, as leaf fall has a
sharp end: they begin with what is known of rails beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.values.adhesion import INVERSE
from estimation.values.arrays import FloatArray, IntArray, frozen_array

POINTS = 160
GRID = frozen_array(np.geomspace(1.0, INVERSE[-1], POINTS), (POINTS,), name="GRID")
"""(g,) 1/mu, each a constant part above the one before: steps in the logarithm are alike."""

WRONG_SHARE, WRONG_BY = 0.05, 3.0  # of places, whose error is so many times that of the others
LEAST_LIKELIHOOD = 1e-12  # of the largest: no place makes another one impossible


@dataclass(frozen=True, slots=True)
class Along:
    """1/mu of c places."""

    mean: FloatArray  # (c,)
    std: FloatArray  # (c,)

    def __post_init__(self) -> None:
        for name in ("mean", "std"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (len(self.mean),), name=name))


@dataclass(frozen=True, slots=True)
class AlongParameters:
    """What is known of 1/mu beforehand."""

    usual: float  # mean
    usual_std: float
    change_std: float  # of the logarithm of 1/mu from a place to the next
    fresh: float  # share of places that have nothing in common with the one before


def along_track(cells: IntArray, misfits: FloatArray, place_std: FloatArray, parameters: AlongParameters) -> Along:
    """Return 1/mu of the places, each from all of them.

    Args:
        cells: (c,) numbers of the places, rising; the chain begins again behind a gap.
        misfits: (c, k) twice the negative logarithm of the likelihood at each of ``INVERSE``, but for a constant.
        place_std: (c,) error of 1/mu of each place that all its passes share.
        parameters: What is known beforehand.
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
    return Along(mean, np.sqrt(np.maximum(posterior @ GRID**2 - mean**2, 0.0)))


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
