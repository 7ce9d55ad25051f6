"""The yaw equation of a wheelset in a bogie: errors of sensors beside a curve in every bin.

A stiff yaw spring turns a scale error e of the yaw sensor into the moment k_psi e psi, one between the two frame
sensors into k_psi e ym / wheelbase, and an angle b by which the yaw sensor is turned about the lateral axis into
k_psi b phi. Per bin they could not be parted from noise. But they are the same for all bins, and known beforehand
within the accuracy of sensors and of their mounting. Elimination of the bins' own unknowns leaves one equation for
each; so the sums of the bins are all that is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.tables.least_squares import SMALLEST_EIGENVALUE, Solution, unpack
from estimation.values.arrays import BoolArray, FloatArray

SMALLEST = 1e-200  # variance, so that without any sample the shared coefficients are zero


@dataclass(frozen=True, slots=True)
class SharedSolution:
    """What :func:`solve_with_shared_scales` returns."""

    solution: Solution  # of r b cells; the shared coefficients stand in each
    sensitivity: FloatArray  # (b, p - q, q): own coefficients of replicate 0 per std of what is left of the shared ones


def solve_with_shared_scales(
    packed: FloatArray,
    weight: FloatArray,
    regressors: int,
    targets: int,
    prior_stds: Sequence[float],
    counted_as_one: Sequence[float] | None = None,
) -> SharedSolution:
    """Return the least-squares solution of every bin with the first coefficients common to all bins of a replicate.

    Args:
        packed: (r, b, packed_size) moments of r replicates of b bins.
        weight: (r, b) sums of weights.
        regressors: Number p of all regressors.
        targets: Number t of targets.
        prior_stds: (q,) of the coefficients that are shared, which are those of the first regressors and zero
            beforehand.
        counted_as_one: (q,) samples that say as much of a shared coefficient as one with an error of its own would; by
            default one.
    """
    r, b = weight.shape
    p, t, q = regressors, targets, len(prior_stds)
    gram, cross, square = (part.reshape(r, b, *part.shape[1:]) for part in unpack(packed.reshape(r * b, -1), p, t))
    inverse, solvable = _inverse(gram[:, :, q:, q:])
    alone = inverse @ cross[:, :, q:, :]
    of_shared = inverse @ gram[:, :, q:, :q]
    coupling = gram[:, :, :q, q:]
    known_bins = solvable[:, :, None, None]
    left = np.where(known_bins, gram[:, :, :q, :q] - coupling @ of_shared, 0.0).sum(axis=1)
    right = np.where(known_bins, cross[:, :, :q, :] - coupling @ alone, 0.0).sum(axis=1)
    unshared = np.maximum(square - np.einsum("rbi,rbi->rb", alone[..., 0], cross[:, :, q:, 0]), 0.0)
    freedom = np.maximum(np.where(solvable, weight - (p - q), 0.0).sum(axis=1), 1.0)
    variance = np.maximum(np.where(solvable, unshared, 0.0).sum(axis=1) / freedom, SMALLEST)
    counted = np.ones(q) if counted_as_one is None else np.asarray(counted_as_one)
    known = variance[:, None, None] * np.diag(counted / np.square(prior_stds))
    common = np.linalg.solve(left + known, right)[:, None]
    own = alone - of_shared @ common
    theta = np.concatenate([np.broadcast_to(common, (r, b, q, t)), own], axis=2)
    theta = np.where(known_bins, theta, np.nan)
    residual = square - 2.0 * np.einsum("rbi,rbi->rb", theta[..., 0], cross[..., 0])
    residual += np.einsum("rbi,rbij,rbj->rb", theta[..., 0], gram, theta[..., 0])
    whole = np.zeros_like(gram)
    whole[:, :, q:, q:] = inverse
    cells = r * b
    solution = Solution(
        theta.reshape(cells, p, t),
        (np.maximum(residual, 0.0) / np.maximum(weight - p, 1.0)).reshape(cells),
        whole.reshape(cells, p, p),
    )
    size = np.sqrt(variance[0] * counted)
    unknown = size[:, None] * np.linalg.inv(left[0] + known[0]) * size
    moved = np.where(known_bins[0], -of_shared[0] @ np.linalg.cholesky(unknown), np.nan)
    return SharedSolution(solution, np.asarray(moved))


def _inverse(gram: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the inverses (..., q, q) of symmetric matrices, and which of them have one (...)."""
    scale = np.sqrt(np.einsum("...ii->...i", gram))
    safe = np.where(scale > 0.0, scale, np.inf)
    scaled = gram / (safe[..., :, None] * safe[..., None, :])
    values, vectors = np.linalg.eigh(scaled)
    solvable = values[..., 0] > SMALLEST_EIGENVALUE
    divided = np.where(solvable[..., None], 1.0 / np.where(solvable[..., None], values, 1.0), 0.0)
    inverse = np.einsum("...ij,...j,...kj->...ik", vectors, divided, vectors)
    return inverse / (safe[..., :, None] * safe[..., None, :]), np.asarray(solvable)
