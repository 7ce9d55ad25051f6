"""The yaw equation of a wheelset in a bogie: scale errors of sensors beside a curve in every bin.

A stiff yaw spring turns a scale error e of the yaw sensor into the moment k_psi e psi, and one between the two frame
sensors into k_psi e ym / wheelbase. Per bin they could not be parted from noise. But they are the same for all bins,
and known beforehand within the accuracy of sensors. Elimination of the bins' own unknowns leaves one equation for each;
so the sums of the bins are all that is needed.
"""

from __future__ import annotations

import numpy as np

from estimation.tables.least_squares import SMALLEST_EIGENVALUE, Solution, unpack
from estimation.values.arrays import BoolArray, FloatArray


def solve_with_shared_scales(
    packed: FloatArray, weight: FloatArray, shared: int, regressors: int, targets: int, prior_std: float
) -> Solution:
    """Return the least-squares solution of every bin with the first coefficients common to all bins of a replicate.

    Parameters
    ----------
    packed
        (r, b, packed_size) moments of r replicates of b bins.
    weight
        (r, b) sums of weights.
    shared
        Number q of regressors, the first ones, whose coefficients are shared.
    regressors
        Number p of all regressors.
    targets
        Number t of targets.
    prior_std
        Of the shared coefficients, which are zero beforehand.

    Returns
    -------
    Solution of r b cells; the shared coefficients stand in each.
    """
    r, b = weight.shape
    p, t, q = regressors, targets, shared
    gram, cross, square = (part.reshape(r, b, *part.shape[1:]) for part in unpack(packed.reshape(r * b, -1), p, t))
    inverse, solvable = _inverse(gram[:, :, q:, q:])
    alone = inverse @ cross[:, :, q:, :]
    of_shared = inverse @ gram[:, :, q:, :q]
    coupling = gram[:, :, :q, q:]
    counted = solvable[:, :, None, None]
    left = np.where(counted, gram[:, :, :q, :q] - coupling @ of_shared, 0.0).sum(axis=1)
    right = np.where(counted, cross[:, :, :q, :] - coupling @ alone, 0.0).sum(axis=1)
    unshared = np.maximum(square - np.einsum("rbi,rbi->rb", alone[..., 0], cross[:, :, q:, 0]), 0.0)
    freedom = np.maximum(np.where(solvable, weight - (p - q), 0.0).sum(axis=1), 1.0)
    variance = np.where(solvable, unshared, 0.0).sum(axis=1) / freedom
    common = np.linalg.solve(left + (variance / prior_std**2)[:, None, None] * np.eye(q), right)[:, None]
    own = alone - of_shared @ common
    theta = np.concatenate([np.broadcast_to(common, (r, b, q, t)), own], axis=2)
    theta = np.where(counted, theta, np.nan)
    residual = square - 2.0 * np.einsum("rbi,rbi->rb", theta[..., 0], cross[..., 0])
    residual += np.einsum("rbi,rbij,rbj->rb", theta[..., 0], gram, theta[..., 0])
    whole = np.zeros_like(gram)
    whole[:, :, q:, q:] = inverse
    cells = r * b
    return Solution(
        theta.reshape(cells, p, t),
        (np.maximum(residual, 0.0) / np.maximum(weight - p, 1.0)).reshape(cells),
        whole.reshape(cells, p, p),
    )


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
