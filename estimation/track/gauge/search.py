"""The gauge deviation along a section from the passes alone: least squares, then a search (``docs/gauge.md``).

Gauge moves each wheel against its own rail: a wheelset of difference R sits at h(R, e) = h0(R) + e h1(R) + e^2 h2(R).
For given h this is linear in a small change of e, and for given e in h: both are solved in turn, d eliminated. That
ends near where it starts. Disagreement has several minima over e, so all of a grid are looked at then, and dynamic
programming finds the best smooth way along the section.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg

from estimation.filters import high_pass
from estimation.track.gridded_pass import GriddedPass
from estimation.track.panel.basis import Panel, gauge_at, gauge_curves, pass_residual
from estimation.track.panel.solution import PanelSolution
from estimation.track.parameters import TRACK
from estimation.track.passes import ProfileLife
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.track import GaugeShift


@dataclass(frozen=True, slots=True)
class GaugePrior:
    """What is known of the gauge deviation beforehand."""

    std: float = 2e-3  # m
    smooth: float = 5.0  # m along the track
    noise: float = 0.15e-3  # m of y - d - h(R, e) of a pass


@dataclass(frozen=True, slots=True)
class _LinearisedPass:
    points: IntArray  # (m,) clipped to the section
    on: BoolArray  # (m,) on the section
    inside: BoolArray  # (m,) where the residual can be used
    residual: FloatArray  # (m,) times ``root``
    slope: FloatArray  # (m,) dh/de, times ``root``
    root: float  # of the weight of the pass


def with_gauge_effect(solution: PanelSolution, effect: FloatArray, panel: Panel) -> PanelSolution:
    """Return a solution without gauge with h1 (w, gauge_basis_count) put in, m for ``gauge_unit`` of gauge."""
    h0, stiffness_term = solution.curves[:, :, : panel.parameters.basis_count], solution.curves[:, :, -1:]
    h1 = np.broadcast_to(effect, (len(h0), *effect.shape))
    return replace(solution, curves=np.concatenate([h0, h1, np.zeros_like(h1), stiffness_term], axis=2))


def gauge_step(
    passes: Sequence[GriddedPass], solution: PanelSolution, panel: Panel, prior: GaugePrior
) -> tuple[FloatArray, bool, int]:
    """Return the gauge (n,), m, mean zero, after a Gauss-Newton step; whether it converged; steps of the gradients."""
    assert panel.gauge is not None
    rows = [_linearised(item, curve, panel) for item, curve in solution.used(passes)]
    count, weight = np.zeros((2, panel.grid.points))
    for row in rows:
        count[row.points[row.inside]] += 1
        weight[row.points[row.inside]] += row.root**2
    share = np.where(count >= TRACK.fewest_place_passes, 1.0 / np.where(weight > 0.0, weight, 1.0), 0.0)
    reach = int(np.ceil(2 * prior.smooth / panel.grid.step))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * panel.grid.step * 2.5 / prior.smooth) ** 2)
    smooth = np.asarray(kernel / np.sqrt((kernel**2).sum()))  # a process of unit variance driven by white noise
    system = _GaugeSystem(rows, share, smooth, panel.grid.kernel)
    change, converged, steps = system.solve((prior.noise / prior.std) ** 2)
    gauge = panel.gauge + change
    known = share > 0
    if not known.any():
        return panel.gauge, converged, steps
    return np.where(known, gauge - gauge[known].mean(), 0.0), converged, steps


def _linearised(item: GriddedPass, curve: FloatArray, panel: Panel) -> _LinearisedPass:
    p, on = panel.parameters, panel.grid.contains(item.points)
    root = float(np.sqrt(panel.weight_of(item.life)))
    R = np.clip(item.difference, -p.reach, p.reach)
    first, second = (np.interp(R, p.gauge_knots, values) for values in gauge_curves(curve, panel))
    slope = (first + 2 * gauge_at(item.points, panel) / p.gauge_unit * second) / p.gauge_unit
    return _LinearisedPass(
        points=np.clip(item.points, 0, panel.grid.points - 1),
        on=on,
        inside=item.inside,
        residual=np.where(item.inside, root * pass_residual(item, curve, panel), 0.0),
        slope=np.where(on, root * item.side * slope, 0.0),
        root=root,
    )


@dataclass(frozen=True, slots=True)
class _GaugeSystem:
    rows: Sequence[_LinearisedPass]
    share: FloatArray  # (n,) one over the weights of the passes, zero where there are too few
    smooth: FloatArray  # kernel of K
    kernel: FloatArray  # of F

    def solve(self, ridge: float) -> tuple[FloatArray, bool, int]:
        """Return K u (n,), whether conjugate gradients converged, and their steps."""
        n, steps = len(self.share), 0

        def count(_: FloatArray) -> None:
            nonlocal steps
            steps += 1

        operator = LinearOperator((n, n), matvec=lambda u: self._normal(u) + ridge * u, dtype=np.float64)
        right = self._smoothed(self._adjoint(self._without_alignment([row.residual for row in self.rows])))
        u, failed = cg(operator, right, rtol=TRACK.cg_tolerance, atol=0.0, maxiter=TRACK.most_cg_steps, callback=count)
        return self._smoothed(np.asarray(u)), failed == 0, steps

    def _normal(self, u: FloatArray) -> FloatArray:
        gauge = self._smoothed(u)
        rows = [np.where(row.inside, high_pass(row.slope * gauge[row.points], self.kernel), 0.0) for row in self.rows]
        return self._smoothed(self._adjoint(self._without_alignment(rows)))

    def _smoothed(self, values: FloatArray) -> FloatArray:
        return np.convolve(values, self.smooth, "same")

    def _without_alignment(self, rows: Sequence[FloatArray]) -> list[FloatArray]:
        mean = np.zeros(len(self.share))
        for one, row in zip(self.rows, rows, strict=True):
            mean[one.points[one.inside]] += one.root * row[one.inside]
        mean *= self.share
        return [
            np.where(one.inside & (self.share[one.points] > 0), row - one.root * mean[one.points], 0.0)
            for one, row in zip(self.rows, rows, strict=True)
        ]

    def _adjoint(self, rows: Sequence[FloatArray]) -> FloatArray:
        total = np.zeros(len(self.share))
        for one, row in zip(self.rows, rows, strict=True):
            np.add.at(total, one.points[one.on], (one.slope * high_pass(row, self.kernel))[one.on])
        return total


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
    """Return the gauge deviation (n,), m, with mean zero, at which passes agree best, starting at ``panel.gauge``."""
    levels = parameters.levels
    sums, squares = np.zeros((2, panel.grid.points, len(levels)))
    count, met = np.zeros((2, panel.grid.points))
    p = panel.parameters
    for item, curve in solution.used(passes):
        R, at = np.clip(item.difference, -p.reach, p.reach), item.used_points
        nominal = item.side * (np.interp(R, p.knots, curve[: p.basis_count]) + curve[-1] * item.stiffness_term)
        whole = nominal + item.side * shifts[item.life].at(item.difference, gauge_at(item.points, panel))
        y = high_pass(item.displacement - whole, panel.grid.kernel) + whole  # d plus the shift as this pass sees it
        shift = item.side * shifts[item.life].over(item.difference[item.inside], levels)
        each = (y - nominal)[item.inside][:, None] - shift
        weight = panel.weight_of(item.life)
        sums[at] += weight * each
        squares[at] += weight * (each * each)
        count[at] += weight
        met[at] += 1
    disagreement = squares - sums**2 / np.where(count > 0.0, count, 1.0)[:, None]
    cost = disagreement / (2.0 * parameters.noise**2)
    cost = np.minimum(cost - cost.min(axis=1, keepdims=True), parameters.most_cost)
    enough = met >= TRACK.fewest_place_passes
    cost[~enough] = 0.0
    gauge = levels[_best_way(cost + 0.5 * (levels / parameters.std) ** 2, levels / parameters.change)]
    return np.asarray(np.where(enough, gauge - gauge[enough].mean(), 0.0)) if enough.any() else gauge


def _best_way(cost: FloatArray, level: FloatArray) -> IntArray:
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
