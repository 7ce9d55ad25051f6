"""By how much the regression of y on R makes the curves too flat, and what is not known of that.

R of a pass is off: by the noise of its sensors, by terms that its equation leaves out, by a gauge deviation that is not
modelled. Between the passes of a place such errors stand against differences of R that are small where wheelsets are
alike. They flatten y = d + h(R) as noise of a regressor does, and what h lacks goes into the alignment, with a small
standard deviation from blocks of data. Were all of the disagreement in R, the regression of R on y - d would be right,
and h too flat by the share r2 of the differences of y that the curves explain; were it all in y, h would be right. The
truth is near the first: the shares that were seen in simulations of many tracks and fleets are below.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.track.panel.normal_equations import PanelState
from estimation.track.panel.solution import PanelSolution, curves_of_sum
from estimation.values.arrays import FloatArray

EXCESS_SHARE = 1.4  # of 1 / r2 - 1, by which curves are too flat
EXCESS_STD = 0.5  # of 1 / r2 - 1: what is not known of that


@dataclass(frozen=True, slots=True)
class SlopeCorrection:
    """Factor that curves are to be multiplied with, and its std."""

    factor: float = 1.0
    std: float = 0.0
    explained: float = 1.0  # r2: share of the differences of y between the passes of a place that the curves explain


def slope_correction(state: PanelState, solution: PanelSolution) -> SlopeCorrection:
    """Return by how much the curves of a panel are too flat."""
    known = state.passes > 0.0
    passes, y = state.passes[known], state.displacement[known]
    curves = solution.curves[0]
    fitted = curves_of_sum(state, curves)[known]
    gram = np.einsum("wj,gwjk,wk->", curves, state.gram, curves)
    own = float(gram - (fitted**2 / passes).sum())
    along = float(np.einsum("wk,gwk->", curves, state.cross) - (fitted * y / passes).sum())
    whole = float(state.square.sum() - (y**2 / passes).sum())
    if not (own > 0.0 and whole > 0.0 and along > 0.0):
        return SlopeCorrection(1.0, float("inf"), 0.0)
    explained = min(along**2 / (own * whole), 1.0)
    excess = 1.0 / explained - 1.0
    return SlopeCorrection(1.0 + EXCESS_SHARE * excess, EXCESS_STD * excess, explained)


def corrected(state: PanelState, solution: PanelSolution, factor: float) -> PanelSolution:
    """Return a solution with its curves multiplied by ``factor``, and the alignment that follows from them.

    Args:
        factor: Of all curves.
    """
    passes = np.where(state.passes > 0.0, state.passes, 1.0)
    added = (factor - 1.0) * curves_of_sum(state, _without_stiffness(solution.curves[0])) / passes
    return replace(
        solution,
        curves=np.concatenate([factor * solution.curves[:, :, :-1], solution.curves[:, :, -1:]], axis=2),
        alignment=solution.alignment - added,
    )


def common_slope(solution: PanelSolution, other: PanelSolution) -> float:
    """Return the factor by which the curves of ``solution`` come nearest to those of another.

    Args:
        solution, other: Of the same wheelsets, perhaps in another order; the second without a gauge.
    """
    count = len(solution.knots)
    along, own = 0.0, 0.0
    for number, life in enumerate(solution.lives):
        curve = other.curve_of(life)
        if curve is None:
            continue
        weight, mine = solution.weight[number], solution.curves[0, number, :count]
        along += float((weight * mine) @ curve[:count])
        own += float((weight * mine) @ mine)
    return along / own if along > 0.0 else 1.0


def _without_stiffness(curves: FloatArray) -> FloatArray:
    return np.concatenate([curves[:, :-1], np.zeros_like(curves[:, -1:])], axis=1)
