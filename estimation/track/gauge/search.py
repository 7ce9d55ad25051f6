"""The gauge deviation along a section by search: at every place the one at which the passes agree, and smooth.

With h(R, e) of every wheelset known, each gauge deviation puts every pass at a place on the track; at the right one all
passes agree on the alignment there. Their disagreement has several minima over e, so all of a grid are looked
at, and the best smooth way through them along the section is found by dynamic programming.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.filters.local_cubic import high_pass
from estimation.track.gauge.least_squares_step import FEWEST_PASSES
from estimation.track.gridded_pass import GriddedPass
from estimation.track.panel.basis import Panel, gauge_at
from estimation.track.panel.solution import PanelSolution
from estimation.track.profile_life import ProfileLife
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.track import GaugeShift


@dataclass(frozen=True, slots=True)
class SearchParameters:
    """How the gauge deviation is looked for."""

    most: float = 7e-3  # m
    step: float = 0.25e-3  # m
    noise: float = 0.12e-3  # m of y - d - h(R, e) of a pass
    change: float = 0.5e-3  # m from one grid point to the next, std
    std: float = 2e-3  # m, expected
    most_cost: float = 30.0  # that one place may make: an impact is no proof

    @property
    def levels(self) -> FloatArray:
        """Gauge deviations (l,) that are looked at, m."""
        count = round(self.most / self.step)
        return np.asarray(np.arange(-count, count + 1) * self.step, dtype=np.float64)


def search_gauge(
    passes: Sequence[GriddedPass],
    solution: PanelSolution,
    panel: Panel,
    shifts: Mapping[ProfileLife, GaugeShift],
    parameters: SearchParameters,
) -> FloatArray:
    """Return the gauge deviation (n,), m, with mean zero, at which ``passes`` agree best.

    Args:
        passes, solution, panel: As solved last; ``panel.gauge`` is where the slow part of y - d is taken at.
    """
    levels = parameters.levels
    sums, squares = np.zeros((2, panel.grid.points, len(levels)))
    count, met = np.zeros((2, panel.grid.points))
    for item in passes:
        placed = _placed(item, solution, panel, shifts)
        if placed is None:
            continue
        at, at_nominal, R = placed
        each = at_nominal[:, None] - item.side * shifts[item.life].over(R, levels)
        weight = panel.known.weight_of(item.life)
        sums[at] += weight * each
        squares[at] += weight * (each * each)
        count[at] += weight
        met[at] += 1
    disagreement = squares - sums**2 / np.where(count > 0.0, count, 1.0)[:, None]
    cost = disagreement / (2.0 * parameters.noise**2)
    cost = np.minimum(cost - cost.min(axis=1, keepdims=True), parameters.most_cost)
    enough = met >= FEWEST_PASSES
    cost[~enough] = 0.0
    gauge = levels[_best_way(cost + 0.5 * (levels / parameters.std) ** 2, levels / parameters.change)]
    return np.asarray(np.where(enough, gauge - gauge[enough].mean(), 0.0)) if enough.any() else gauge


def _placed(
    item: GriddedPass, solution: PanelSolution, panel: Panel, shifts: Mapping[ProfileLife, GaugeShift]
) -> tuple[IntArray, FloatArray, FloatArray] | None:
    """Return grid points (m,), d plus the shift as this pass sees it (m,), m, and R (m,)."""
    curve = solution.curve_of(item.life)
    if item.empty or curve is None:
        return None
    p = panel.parameters
    R = np.clip(item.difference, -p.reach, p.reach)
    nominal = item.side * (np.interp(R, p.knots, curve[: p.basis_count]) + curve[-1] * item.stiffness_term)
    shift = item.side * shifts[item.life].at(item.difference, gauge_at(item.points, panel))
    whole = nominal + shift
    y = high_pass(item.displacement - whole, panel.grid.kernel) + whole
    return item.used_points, (y - nominal)[item.inside], item.difference[item.inside]


def _best_way(cost: FloatArray, level: FloatArray) -> IntArray:
    """Return the indices (n,) of the way with the least sum of ``cost`` (n, l) and half the squares of its steps."""
    step = 0.5 * (level[:, None] - level[None, :]) ** 2  # (to, from)
    n, count = cost.shape
    came_from = np.zeros((n, count), dtype=np.int64)
    total = cost[0]
    for i in range(1, n):
        ways = total[None, :] + step
        came_from[i] = ways.argmin(axis=1)
        total = ways[np.arange(count), came_from[i]] + cost[i]
    way = np.zeros(n, dtype=np.int64)
    way[-1] = int(total.argmin())
    for i in range(n - 1, 0, -1):
        way[i - 1] = came_from[i, way[i]]
    return way
