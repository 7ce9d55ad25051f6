"""What could be known of a step at all: the odds of a detector that has the truth about a life.

It knows noise, weather, and the laws of outliers, of wear and of steps, from which the lives are drawn; in one form the
wear of the life itself. Levels on both sides, place, size and outliers are integrated over. The outliers have no noise
besides and the size has the prior of the product, so that it is a guide and no strict bound.
"""

from __future__ import annotations

import numpy as np

from bench.steps_lives import MIXED, OUTLIERS, RATES, Case, Life
from estimation.trend.change_point import StepModel
from estimation.values.arrays import FloatArray

NEWEST = 16  # intervals that it looks at
DOUBLES = 0.003  # chance of two outliers on end, of which there may be some everywhere
ALIKE = 0.1  # relative, by which these differ
NODES = np.linspace(-5.0, 5.0, 15)  # standard deviations about every point: a level is near some point
SLOPES = np.linspace(*RATES, 25)  # per km
TINY = float(np.finfo(np.float64).tiny)
MODEL = StepModel()


def odds(given: Life, until: int, *, wear: bool) -> float:
    """Return the log odds of a step among the newest intervals.

    Args:
        wear: Known, rather than its law.
    """
    part = slice(max(0, until - NEWEST), until)
    records, noise = given.records[part], given.noise[part]
    x = np.array([one.mileage_km for one in records])
    value = np.array([one.known[-1].value for one in records]) - given.weather[part]
    if wear:
        pairs = [_evidence(value - given.worn[part], noise)]
    else:
        pairs = [_evidence(value - slope * (x - x[-1]), noise) for slope in SLOPES]
    nothing, stepped = np.array(pairs).T
    return float(np.logaddexp.reduce(stepped) - np.logaddexp.reduce(nothing))


def _evidence(value: FloatArray, noise: FloatArray) -> tuple[float, float]:
    """Return log evidence of no step and of a step of any place, in an interval or between two."""
    level = np.unique((value + np.outer(NODES, noise)).ravel())
    weight = np.gradient(level)
    off = value[:, None] - level
    before, behind = _forward(off, noise), _forward(off[::-1], noise[::-1])[::-1]
    size = level - level[:, None]
    prior = np.exp(-0.5 * (size / MODEL.step_std) ** 2) / (MODEL.step_std * np.sqrt(2.0 * np.pi))
    prior *= weight[:, None] * weight
    stepped = 0.0
    for at in range(MODEL.least_good, len(value) - MODEL.least_good + 1):
        stepped += 0.5 * float(before[at] @ prior @ behind[at])
        if at + 1 <= len(value) - MODEL.least_good:
            share = np.divide(value[at] - level[:, None], size, out=np.zeros_like(size), where=size != 0.0)
            within = (share > MIXED[0]) & (share < MIXED[1])
            density = within / np.maximum((MIXED[1] - MIXED[0]) * np.abs(size), noise[at])
            stepped += 0.5 * float(before[at] @ (prior * density) @ behind[at + 1])
    nothing = float(weight @ before[-1])
    return float(np.log(max(nothing, TINY))), float(np.log(max(MODEL.step_chance * stepped, TINY)))


def _forward(off: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the likelihood (k + 1, n) of the first points about each level, with outliers alone or two on end."""
    chance = Case(0).singles
    size = np.abs(off)
    outlier = 0.5 * ((size > OUTLIERS[0]) & (size < OUTLIERS[1])) / (OUTLIERS[1] - OUTLIERS[0])
    good = _normal(off, noise[:, None])
    found = np.ones((len(off) + 1, off.shape[1]))
    for i in range(len(off)):
        found[i + 1] = found[i] * ((1.0 - chance - DOUBLES) * good[i] + chance * outlier[i])
        if i > 0:
            apart = np.hypot(ALIKE * off[i - 1], np.hypot(noise[i], noise[i - 1]))
            found[i + 1] += found[i - 1] * DOUBLES * outlier[i - 1] * _normal(off[i] - off[i - 1], apart)
    return found


def _normal(off: FloatArray, std: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-0.5 * (off / std) ** 2) / (std * np.sqrt(2.0 * np.pi)))
