"""Least squares of R = rL - rR as a series of functions of y - d: what the linear and the cubic fit share.

R c = z2 (Eq. 2 solved for R, the small contact angle term left out) is regressed on the functions, per group of
blocks; beside the target stand its derivatives by the uncertain parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from estimation.estimators.coverage import CELLS, counted, covered_range, usable
from estimation.estimators.interface import CurveEstimate, EstimatorParameters
from estimation.estimators.replicates import FEWEST_GROUPS, Replicates, curve_estimate, nothing
from estimation.geometry.conicity import too_few_blocks
from estimation.tables.bin_table import group_of
from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.motion import Motion
from estimation.values.reasons import Reason, ReasonCode
from estimation.vehicle.regressors import YAW_TARGETS, regression

GROUPS = 16
SPACING = 0.05e-3  # m of y - d at which the curve is given
Basis = Callable[[FloatArray], FloatArray]  # y - d (n,) to functions (n, m)


@dataclass(frozen=True, slots=True)
class SeriesState:
    """Sums over samples; states add up in any order."""

    parameters: EstimatorParameters
    gram: FloatArray  # (g, m, m)
    cross: FloatArray  # (g, m, 5) with R and its derivatives by the logarithms of the parameters, m
    counts: FloatArray  # (CELLS,) effective samples by displacement
    samples: int
    stretches: int

    def __post_init__(self) -> None:
        g, m = self.gram.shape[:2]
        object.__setattr__(self, "gram", frozen_array(self.gram, (g, m, m), name="gram"))
        object.__setattr__(self, "cross", frozen_array(self.cross, (g, m, len(YAW_TARGETS)), name="cross"))
        object.__setattr__(self, "counts", frozen_array(self.counts, (CELLS,), name="counts"))


def empty(parameters: EstimatorParameters, functions: int) -> SeriesState:
    """Return empty sums for ``functions`` basis functions."""
    return SeriesState(
        parameters,
        np.zeros((GROUPS, functions, functions)),
        np.zeros((GROUPS, functions, len(YAW_TARGETS))),
        np.zeros(CELLS),
        0,
        0,
    )


def added(state: SeriesState, motion: Motion, basis: Basis, weight: float) -> SeriesState:
    """Return the state with ``motion`` added.

    Parameters
    ----------
    state
        The sums so far.
    motion
        Motion of the wheelset relative to the track over one window.
    basis
        The basis functions, of y - d in m.
    weight
        Of every sample.
    """
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
        counts=state.counts + weight * counted(motion.displacement[keep]),
        samples=state.samples + int(keep.sum()),
        stretches=state.stretches + 1,
    )


def solved(state: SeriesState, basis: Basis, ridge: float) -> CurveEstimate:
    """Return the curve of the series, its intervals from groups left out and parameters shifted.

    Parameters
    ----------
    state
        Sums over all windows.
    basis
        The basis functions, of y - d in m.
    ridge
        Weight that holds functions without data at zero, as a share of the mean diagonal of the normal equations.
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
    small = ridge * np.trace(gram) / len(gram) * np.eye(len(gram))
    theta = np.linalg.solve(gram + small, cross)
    left_out = [np.linalg.solve(gram - state.gram[g] + small, cross - state.cross[g])[:, 0] for g in present]
    functions = basis(x)
    value = functions @ theta[:, 0]
    shifts = (functions @ theta[:, 1:]).T * state.parameters.uncertainty.yaw()[:, None]
    return curve_estimate(
        Replicates(x, value, np.array(left_out) @ functions.T, value + shifts, state.samples, state.stretches),
        state.parameters,
    )
