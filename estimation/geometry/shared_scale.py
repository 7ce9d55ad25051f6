"""The yaw equation of a wheelset in a bogie: errors of sensors beside a curve in every bin.

A stiff yaw spring turns a scale error e of the yaw sensor into the moment k_psi e psi, one between the two frame
sensors into k_psi e ym / wheelbase, and an angle b by which the yaw sensor is turned about the lateral axis into
k_psi b phi. Per bin they could not be parted from noise. But they are the same for all bins, and known beforehand
within the accuracy of sensors and of their mounting. Elimination of the bins' own unknowns leaves one equation for
each; so the sums of the bins are all that is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.tables.least_squares import SMALLEST_EIGENVALUE, Solution, unpack
from estimation.values.arrays import BoolArray, FloatArray

SMALLEST = float(np.finfo(np.float64).tiny)  # variance, so that without any sample the shared coefficients are zero


@dataclass(frozen=True, slots=True)
class _Eliminated:
    """Normal equations of r replicates of b bins of which the own coefficients of the bins have been eliminated."""

    gram: FloatArray  # (r, b, p, p)
    cross: FloatArray  # (r, b, p, t)
    square: FloatArray  # (r, b)
    inverse: FloatArray  # (r, b, p - q, p - q) of what belongs to the bins
    solvable: BoolArray  # (r, b)
    alone: FloatArray  # (r, b, p - q, t) coefficients of the bins if the shared ones were zero
    of_shared: FloatArray  # (r, b, p - q, q) by how much each shared one lowers them
    left: FloatArray  # (r, q, q) of the shared coefficients
    right: FloatArray  # (r, q, t)
    variance: FloatArray  # (r,) of the residuals without the shared coefficients

    def penalty(self, prior_std: FloatArray | float) -> FloatArray:
        """Return the matrices (r, q, q) by which what is known beforehand weighs."""
        known = np.diag(np.broadcast_to(1.0 / np.square(prior_std), self.left.shape[-1:]))
        return np.asarray(np.maximum(self.variance, SMALLEST)[:, None, None] * known)


def solve_with_shared_scales(
    packed: FloatArray,
    weight: FloatArray,
    shared: int,
    regressors: int,
    targets: int,
    prior_std: FloatArray | float,
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
        (q,) or one for all: of the shared coefficients, which are zero beforehand.

    Returns
    -------
    Solution of r b cells; the shared coefficients stand in each.
    """
    r, b = weight.shape
    p, t, q = regressors, targets, shared
    found = _eliminated(packed, weight, q, p, t)
    common = np.linalg.solve(found.left + found.penalty(prior_std), found.right)[:, None]
    own = found.alone - found.of_shared @ common
    theta = np.concatenate([np.broadcast_to(common, (r, b, q, t)), own], axis=2)
    theta = np.where(found.solvable[:, :, None, None], theta, np.nan)
    residual = found.square - 2.0 * np.einsum("rbi,rbi->rb", theta[..., 0], found.cross[..., 0])
    residual += np.einsum("rbi,rbij,rbj->rb", theta[..., 0], found.gram, theta[..., 0])
    whole = np.zeros_like(found.gram)
    whole[:, :, q:, q:] = found.inverse
    cells = r * b
    return Solution(
        theta.reshape(cells, p, t),
        (np.maximum(residual, 0.0) / np.maximum(weight - p, 1.0)).reshape(cells),
        whole.reshape(cells, p, p),
    )


def left_open(
    packed: FloatArray,
    weight: FloatArray,
    shared: int,
    regressors: int,
    targets: int,
    prior_std: FloatArray | float,
) -> FloatArray:
    """Return by how much the bins' own coefficients change with each shared one by the std that is left of it.

    Where the data say nothing of a shared coefficient, that is its std known beforehand.

    Parameters
    ----------
    packed
        (b, packed_size) moments of b bins.
    weight
        (b,) sums of weights.
    shared, regressors, targets, prior_std
        As :func:`solve_with_shared_scales` takes them.

    Returns
    -------
    (b, p - q, q); NaN where a bin has no solution.
    """
    found = _eliminated(packed[None], weight[None], shared, regressors, targets)
    penalty = found.penalty(prior_std)[0]
    share = np.diag(np.linalg.inv(found.left[0] + penalty)) * np.diag(penalty)
    std = np.sqrt(share) * prior_std
    return np.where(found.solvable[0, :, None, None], -found.of_shared[0] * std, np.nan)


def _eliminated(packed: FloatArray, weight: FloatArray, q: int, p: int, t: int) -> _Eliminated:
    r, b = weight.shape
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
    return _Eliminated(gram, cross, square, inverse, solvable, alone, of_shared, left, right, variance)


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
