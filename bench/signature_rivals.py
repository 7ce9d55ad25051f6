"""Other regressions on the same signatures, which do not know of places: ridge, and a Gaussian process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.signature_cases import Pass
from estimation.signatures.mixed_model import features_of
from estimation.values.arrays import FloatArray

PENALTIES = 10.0 ** np.arange(-3, 4)
LENGTHS = np.array([2.0, 4.0, 8.0, 16.0])  # of the process, in standard deviations of a feature
NOISES = np.array([1e-3, 1e-2, 1e-1])  # over the variance of the conicity


@dataclass(frozen=True, slots=True)
class Regression:
    """A kernel regression of conicity on features: with a linear kernel a ridge, with that of Gauss a process."""

    middle: FloatArray
    scale: FloatArray
    support: FloatArray  # (n, f)
    weights: FloatArray  # (n,)
    mean: float
    length: float | None  # None: linear

    def of(self, one: Pass) -> float:
        """Return the conicity of a pass: the mean over its stretches."""
        x = (_inputs([one]) - self.middle) / self.scale
        return self.mean + float(np.mean(_kernel(x, self.support, self.length) @ self.weights))


def _inputs(passes: Sequence[Pass]) -> FloatArray:
    powers = np.stack([one.powers for item in passes for one in item.signatures])
    speed = np.array([one.speed for item in passes for one in item.signatures])
    return np.column_stack([features_of(powers), np.log(speed)])


def _kernel(a: FloatArray, b: FloatArray, length: float | None) -> FloatArray:
    if length is None:
        return np.asarray(a @ b.T)
    squared = np.sum(a**2, 1)[:, None] + np.sum(b**2, 1)[None] - 2 * a @ b.T
    return np.asarray(np.exp(-0.5 * squared / (length**2 * a.shape[1] / 8)))


def trained(passes: Sequence[Pass], conicity: Sequence[float], *, linear: bool) -> Regression:
    """Return the regression whose errors are least where wheelsets are left out, a sixth of them at a time."""
    x = _inputs(passes)
    y = np.concatenate([np.full(len(one.signatures), c) for one, c in zip(passes, conicity, strict=True)])
    names = np.concatenate([np.full(len(one.signatures), one.wheelset.serial) for one in passes])
    middle, scale, mean = x.mean(axis=0), x.std(axis=0), float(y.mean())
    z = (x - middle) / scale
    folds = [np.isin(names, np.unique(names)[k::6]) for k in range(6)]
    options: list[tuple[float | None, float]] = [(None, float(penalty)) for penalty in PENALTIES]
    if not linear:
        options = [(float(length), float(noise)) for length in LENGTHS for noise in NOISES]
    errors = []
    for length, penalty in options:
        K = _kernel(z, z, length)
        errors.append(sum(_error(K, y - mean, penalty, out) for out in folds))
    length, penalty = options[int(np.argmin(errors))]
    weights = np.linalg.solve(_kernel(z, z, length) + penalty * np.eye(len(z)), y - mean)
    return Regression(middle, scale, z, weights, mean, length)


def _error(K: FloatArray, y: FloatArray, penalty: float, out: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> float:
    weights = np.linalg.solve(K[np.ix_(~out, ~out)] + penalty * np.eye(int((~out).sum())), y[~out])
    return float(np.sum((K[np.ix_(out, ~out)] @ weights - y[out]) ** 2))
