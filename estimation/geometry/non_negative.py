"""Least squares with unknowns that are not negative, by exchanging all that are on the wrong side at once.

Lawson and Hanson free one unknown in a step; of hundreds of slopes nearly all are free in the end. Block principal
pivoting (Portugal, Judice and Vicente 1994; Kim and Park 2011) starts with all of them free and exchanges every one
that is negative, or that is held at 0 and would lower the sum. Where that does not lead on, one at a time does (Murty).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from estimation.values.arrays import BoolArray, FloatArray, IntArray

HELD_SLACK = 1e-12  # of the largest gradient: below, an unknown that is held at 0 stays there
PATIENCE = 3  # exchanges of all without fewer on the wrong side, before it is one at a time


@dataclass(frozen=True, slots=True)
class Bounded:
    """A solution; linear in the right side as long as the same unknowns are free."""

    value: FloatArray  # (n,)
    free: IntArray  # which are not held at 0
    scale: FloatArray  # (n,) by which unknowns are multiplied before they are solved
    factor: tuple[FloatArray, bool]  # of the free ones

    def linear(self, right: FloatArray) -> FloatArray:
        """Return what the unknowns (n, m) are for right sides (n, m), with the same ones free."""
        found = np.zeros(right.shape)
        scale = self.scale[self.free, None]
        found[self.free] = cho_solve(self.factor, scale * right[self.free], check_finite=False) * scale
        return found


def non_negative(gram: FloatArray, right: FloatArray, most: int) -> Bounded | None:
    """Return the least squares of which the first unknown has any sign, and the others are not negative.

    Args:
        gram: (n, n) normal matrix, positive definite.
        right: (n,) right side.

    Returns:
        Bounded or None: None where ``most`` exchanges do not suffice, or the matrix does not determine the unknowns.
    """
    diagonal = np.diag(gram)
    if not (diagonal > 0.0).all():
        return None
    scale = 1.0 / np.sqrt(diagonal)
    matrix, wanted = gram * scale * scale[:, None], right * scale
    free = np.ones(len(right), dtype=np.bool_)
    fewest, patience = len(right) + 1, PATIENCE
    for _ in range(most):
        places = np.flatnonzero(free)
        try:
            factor = cho_factor(matrix[np.ix_(places, places)], lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            return None
        value = np.zeros(len(right))
        value[places] = cho_solve(factor, wanted[places], check_finite=False)
        wrong = _wrong(value, matrix @ value - wanted, free)
        if not wrong.any():
            return Bounded(value * scale, places, scale, factor)
        patience = PATIENCE if wrong.sum() < fewest else patience - 1
        fewest = min(fewest, int(wrong.sum()))
        free = free ^ (wrong if patience >= 0 else _last(wrong))
    return None


def _wrong(value: FloatArray, gradient: FloatArray, free: BoolArray) -> BoolArray:
    """Return which unknowns are negative, or would lower the sum if they were free; never the first one."""
    wrong = np.where(free, value < 0.0, gradient < -HELD_SLACK * np.abs(gradient).max())
    wrong[0] = False
    return wrong


def _last(wrong: BoolArray) -> BoolArray:
    one = np.zeros(len(wrong), dtype=np.bool_)
    one[np.flatnonzero(wrong)[-1]] = True
    return one
