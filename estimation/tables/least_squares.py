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

from estimation.compiled import compiled
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray
from estimation.vehicle.regressors import (
    YAW_TARGET_COLUMNS,
    Coefficients,
    Signals,
    lateral_equation,
    radius_factor,
    yaw_moments,
    yaw_regressors,
    yaw_targets,
)

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
    """Solve the normal equations of cells, packed (c, packed_size), after scaling each regressor to unit length."""
    p, t = regressors, targets
    c = len(packed)
    gram, cross, square = unpack(packed, p, t)
    inverse = inverses(gram)
    theta = np.einsum("cij,cjt->cit", inverse, cross)
    first = theta[:, :, 0]
    explained = np.einsum("ci,ci->c", first, cross[:, :, 0])
    freedom = np.maximum(weight - p, 1.0)
    residual_variance = np.maximum(square - explained, 0.0) / freedom
    return Solution(theta.reshape(c, p, t), residual_variance, inverse)


def inverses(gram: FloatArray) -> FloatArray:
    """Return the inverses (c, p, p) of normal matrices, scaled to unit diagonals first; NaN where singular."""
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
    return np.asarray(scaled_inverse / (safe[:, :, None] * safe[:, None, :]))


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


LATERAL_REGRESSORS = 4
LATERAL_COLUMNS = 11  # with the targets
NOISE = 6  # of the targets of Eq. 2
OUTSIDE = -1
GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio
HALF = np.uint64(32)


@compiled(nogil=True)
def group(block: int, groups: int) -> int:
    """Return the group of a block: in turn, and each round begins at another group."""
    turn = np.uint64(block // groups) * GOLDEN >> HALF  # spreads any regular step evenly
    return int((block + np.int64(turn * np.uint64(groups) >> HALF)) % groups)


@compiled(nogil=True)
def assign(
    displacement: FloatArray, valid: BoolArray, block: IntArray, groups: int,
    first_edge: float, width: float, bins: int, cell: IntArray, u: FloatArray,
) -> int:  # fmt: skip
    """Write the cell of each sample, or ``OUTSIDE``, and where in its bin it is; return how many have a cell."""
    inside, last_block, first_cell = 0, -1, 0
    for i in range(len(displacement)):
        cell[i] = OUTSIDE
        position = (displacement[i] - first_edge) / width
        if valid[i] and block[i] >= 0 and 0.0 <= position < bins:
            if block[i] != last_block:
                last_block, first_cell = block[i], group(block[i], groups) * bins
            index = int(position)
            cell[i] = first_cell + index
            u[i] = position - index - 0.5
            inside += 1
    return inside


@compiled(nogil=True, error_model="numpy")
def radius_difference(signals: Signals, k: Coefficients, cell: IntArray, difference: FloatArray) -> None:
    """Write rL - rR by Eq. 2 with the other terms left out; NaN where a sample has no cell."""
    c = radius_factor(k)
    for i in range(len(cell)):
        difference[i] = np.nan
        if cell[i] != OUTSIDE:
            difference[i] = yaw_moments(signals, k, i)[0] / c


@compiled(nogil=True)
def add_products(row: FloatArray, regressors: int, sums: FloatArray, at: int) -> None:
    """Add to ``sums[at]`` (p + 1, m) the products of p regressors with what is not before them in the row (m,).

    And the square of the measurement.
    """
    for a in range(regressors):
        x = row[a]
        for j in range(a, len(row)):
            sums[at, a, j] += x * row[j]
    sums[at, regressors, 0] += row[regressors] * row[regressors]


@compiled(nogil=True, error_model="numpy")
def add_samples(
    signals: Signals, k: Coefficients, noise: float, cell: IntArray, u: FloatArray, slot: IntArray,
    weight: FloatArray, lateral: FloatArray, yaw: FloatArray,
) -> None:  # fmt: skip
    """Add every sample to the sums of its cell, which are in slot ``slot[cell]``; ``noise`` is the variance of R."""
    equation, row, yaw_row = np.empty(9), np.empty(LATERAL_COLUMNS), np.empty(yaw.shape[2])
    regressors = yaw.shape[2] - YAW_TARGET_COLUMNS
    for i in range(len(cell)):
        if cell[i] == OUTSIDE:
            continue
        at, v = slot[cell[i]], u[i]
        weight[at] += 1.0
        lateral_equation(signals, k, i, equation)
        row[0], row[1], row[2], row[3] = equation[0], equation[0] * v, equation[1], equation[1] * v
        for j in range(2, len(equation)):
            row[j + 2] = equation[j]
        add_products(row, LATERAL_REGRESSORS, lateral, at)
        yaw_regressors(signals, k, i, yaw_row)
        yaw_targets(signals, k, i, yaw_row, regressors - 1)
        c = yaw_row[regressors - 1]
        yaw_row[regressors - 3], yaw_row[regressors - 2], yaw_row[regressors - 1] = c, c * v, c * v * v
        yaw_row[regressors + NOISE] += c * noise
        add_products(yaw_row, regressors, yaw, at)


@compiled(nogil=True)
def pack(sums: FloatArray, packed: FloatArray) -> None:
    """Write sums (c, p + 1, m) as ``least_squares`` lays moments out (c, q)."""
    regressors = sums.shape[1] - 1
    for c in range(len(sums)):
        k = 0
        for a in range(regressors):
            for b in range(a, regressors):
                packed[c, k] = sums[c, a, b]
                k += 1
        for a in range(regressors):
            for j in range(regressors, sums.shape[2]):
                packed[c, k] = sums[c, a, j]
                k += 1
        packed[c, k] = sums[c, regressors, 0]
