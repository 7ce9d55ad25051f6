"""Least squares of R = rL - rR as a series of functions of y - d: what the linear and the cubic fit share.

R c = z2 (Eq. 2 solved for R, the small contact angle term left out) is regressed on the functions, per group of
blocks; beside the target stand its derivatives by the uncertain parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from estimation.estimators.interface import (
    CELLS,
    CurveEstimate,
    EstimatorParameters,
    beside,
    counted,
    covered_range,
    usable,
)
from estimation.estimators.replicates import FEWEST_GROUPS, Replicates, curve_estimate, nothing
from estimation.geometry.conicity import too_few_blocks
from estimation.tables.bin_table import group_of
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Motion
from estimation.vehicle.regressors import YAW_TARGETS, regression

GROUPS = 16
SMALLEST_VARIANCE = 1e-18  # m2
SPACING = 0.05e-3  # m of y - d at which the curve is given
Basis = Callable[[FloatArray], FloatArray]  # y - d (n,) to functions (n, m)


@dataclass(frozen=True, slots=True)
class SeriesState(FrozenArrays):
    """Sums over samples; states add up in any order."""

    parameters: EstimatorParameters
    gram: Annotated[FloatArray, "g", "m", "m"]
    cross: Annotated[FloatArray, "g", "m", len(YAW_TARGETS)]  # m, with R and its derivatives by the log parameters
    squares: float  # m2, weighted sum of R^2
    sums: Annotated[FloatArray, CELLS]  # m, weighted sum of R by displacement
    counts: Annotated[FloatArray, CELLS]  # effective samples by displacement
    samples: int
    stretches: int


def empty(parameters: EstimatorParameters, functions: int) -> SeriesState:
    """Return empty sums for ``functions`` basis functions."""
    return SeriesState(
        parameters,
        np.zeros((GROUPS, functions, functions)),
        np.zeros((GROUPS, functions, len(YAW_TARGETS))),
        0.0,
        np.zeros(CELLS),
        np.zeros(CELLS),
        0,
        0,
    )


def added(state: SeriesState, motion: Motion, basis: Basis, weight: float) -> SeriesState:
    """Return the state with ``motion`` added."""
    keep = usable(motion)
    equations = regression(motion, state.parameters.vehicle)
    targets = equations.yaw_targets[keep] / equations.yaw[keep, -1:]
    functions = basis(motion.displacement[keep])
    groups = group_of(motion.block[keep], GROUPS)
    gram, cross = state.gram.copy(), state.cross.copy()
    for group in np.unique(groups):
        in_group = groups == group
        weighted = weight * functions[in_group].T
        gram[group] += weighted @ functions[in_group]
        cross[group] += weighted @ targets[in_group]
    return replace(
        state,
        gram=gram,
        cross=cross,
        squares=state.squares + weight * float(targets[:, 0] @ targets[:, 0]),
        sums=state.sums + weight * counted(motion.displacement[keep], targets[:, 0]),
        counts=state.counts + weight * counted(motion.displacement[keep]),
        samples=state.samples + int(keep.sum()),
        stretches=state.stretches + 1,
    )


def solved(state: SeriesState, basis: Basis, ridge: float) -> CurveEstimate:
    """Return the curve of the series, its intervals from groups left out and parameters shifted.

    Args:
        ridge: Weight that holds functions without data at zero, as a share of the mean diagonal of the normal
            equations.
    """
    span = covered_range(state.counts)
    if span is None:
        reason = Reason(ReasonCode.TOO_FEW_SAMPLES, "too few samples around the centre")
        return nothing(reason, state.parameters, state.samples, state.stretches)
    present = np.flatnonzero(np.trace(state.gram, axis1=1, axis2=2) > 0)
    if len(present) < FEWEST_GROUPS:  # what is left without one of them may not determine the functions
        return nothing(too_few_blocks(len(present)), state.parameters, state.samples, state.stretches)
    low, high = span
    x = np.linspace(low, high, round((high - low) / SPACING) + 1)
    gram, cross = state.gram.sum(axis=0), state.cross.sum(axis=0)
    small = _small(gram, ridge)
    theta = np.linalg.solve(gram + small, cross[:, 0])
    left_out = [np.linalg.solve(gram - state.gram[g] + small, cross[:, 0] - state.cross[g, :, 0]) for g in present]
    functions = basis(x)
    value = functions @ theta
    own = functions @ np.linalg.cholesky(_own_covariance(state, theta, gram + small))
    return curve_estimate(
        Replicates(
            x,
            value,
            np.array(left_out) @ functions.T,
            np.vstack([value + shifts(state, functions, ridge), value + misfit(state, x, value)]),
            state.samples,
            state.stretches,
            own.T,
        ),
        state.parameters,
    )


def shifts(state: SeriesState, functions: FloatArray, ridge: float) -> FloatArray:
    """Return what one std of each uncertain parameter changes of the curve (6, n), m.

    Args:
        functions: (n, m) the basis functions where the curve is given.
    """
    gram, cross = state.gram.sum(axis=0), state.cross.sum(axis=0)
    theta = np.linalg.solve(gram + _small(gram, ridge), cross[:, 1:])
    return np.asarray((functions @ theta).T * state.parameters.uncertainty.yaw()[:, None])


def misfit(state: SeriesState, x: FloatArray, value: FloatArray) -> FloatArray:
    """Return what the curve cannot follow (n,), m: by how much the mean of R is above it, cell by cell.

    Args:
        x, value: (n,) m, the curve.
    """
    return beside(x, value, state.sums, state.counts)


def _small(gram: FloatArray, ridge: float) -> FloatArray:
    return np.asarray(ridge * np.trace(gram) / len(gram) * np.eye(len(gram)))


def _own_covariance(state: SeriesState, theta: FloatArray, gram: FloatArray) -> FloatArray:
    """Return the covariance (m, m) of least squares that takes every residual for independent."""
    cross = state.cross.sum(axis=0)[:, 0]
    squares = max(float(state.squares - theta @ cross), 0.0)
    count = max(float(state.counts.sum()) - len(theta), 1.0)
    inverse = np.linalg.inv(gram)
    return np.asarray(0.5 * (inverse + inverse.T) * max(squares / count, SMALLEST_VARIANCE))
