"""Weighted least squares on mergeable sufficient statistics.

For ``z = X theta`` the sums ``X'X``, ``X'z``, ``z'z`` and the weight are sufficient for ``theta``. They add:
a window is reduced in one pass, windows merge in any grouping, older ones with a smaller weight, and the answer equals
that of the recursion sample by sample (Eq. 10-14 of the paper; the tests hold the oracle).

A sample has ``p`` regressors and ``t`` targets (the first is the measurement, the others are its derivatives by
uncertain parameters, see ``estimation.vehicle.regressors``). The packed moments of a cell are, in this order: the upper
triangle of ``X'X`` row by row (p (p + 1) / 2), ``X'Z`` row by row (p t), and ``z'z`` of the first target (1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.values.arrays import FloatArray, FrozenArrays

SMALLEST_EIGENVALUE = 1e-10  # of the scaled normal matrix; below it a direction is not in the data


def packed_size(regressors: int, targets: int) -> int:
    """Return the length of the packed moments of one cell."""
    return regressors * (regressors + 1) // 2 + regressors * targets + 1


@dataclass(frozen=True, slots=True)
class Solution(FrozenArrays):
    """Least-squares solution of each cell; NaN where the normal matrix is singular."""

    theta: Annotated[FloatArray, "c", "p", "t"]  # one column a target
    residual_variance: FloatArray  # (c,) of the first target
    inverse: Annotated[FloatArray, "c", "p", "p"]  # inverse of X'X (through the scaled eigenvectors)


def solve(packed: FloatArray, weight: FloatArray, regressors: int, targets: int) -> Solution:
    """Solve the normal equations of every cell after scaling each regressor to unit length.

    Args:
        packed: (c, packed_size) moments.
    """
    p, t = regressors, targets
    c = len(packed)
    gram, cross, square = unpack(packed, p, t)
    scale = np.sqrt(np.einsum("cii->ci", gram))
    safe = np.where(scale > 0, scale, np.inf)
    scaled = gram / (safe[:, :, None] * safe[:, None, :])
    scaled_inverse = np.full_like(scaled, np.nan)
    filled = np.all(scale > 0, axis=1)  # the others have directions that are not in the data
    values, vectors = np.linalg.eigh(scaled[filled])
    ok = values[:, 0] > SMALLEST_EIGENVALUE
    inverse_values = np.full_like(values, np.nan)
    inverse_values[ok] = 1.0 / values[ok]
    scaled_inverse[filled] = np.einsum("cij,cj,ckj->cik", vectors, inverse_values, vectors)
    inverse = scaled_inverse / (safe[:, :, None] * safe[:, None, :])
    theta = np.einsum("cij,cjt->cit", inverse, cross)
    first = theta[:, :, 0]
    explained = np.einsum("ci,ci->c", first, cross[:, :, 0])
    freedom = np.maximum(weight - p, 1.0)
    residual_variance = np.maximum(square - explained, 0.0) / freedom
    return Solution(theta.reshape(c, p, t), residual_variance, inverse)


def unpack(packed: FloatArray, regressors: int, targets: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return X'X (c, p, p), X'Z (c, p, t) and z'z (c,) from packed moments (c, packed_size)."""
    p, t = regressors, targets
    c = len(packed)
    triangle = p * (p + 1) // 2
    rows, columns = np.triu_indices(p)
    gram = np.empty((c, p, p))
    gram[:, rows, columns] = packed[:, :triangle]
    gram[:, columns, rows] = packed[:, :triangle]
    cross = packed[:, triangle : triangle + p * t].reshape(c, p, t)
    return gram, cross, packed[:, -1]
