"""What the gauge does to wheelsets, from nothing: the residuals of a panel without gauge vary together.

A residual of the panel is nearly e(s) h1(R), so the covariance of residuals at one place over (wheelset, R) is the
product of h1 with itself: its leading eigenvectors are h1 and, where the gauge varies much, what its square does. No
start is needed. Passes at a place mostly have R of one sign, so h1 at R > 0 leaves R < 0 open; wheelsets are
taken as alike on both sides, h1(-R) = -h1(R). A trial shows which mixture of the two leading vectors h1 is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.track.gauge.search import GaugePrior, gauge_step, with_gauge_effect
from estimation.track.gridded_pass import GriddedPass, grid_pass
from estimation.track.panel.basis import Panel, basis_functions, pass_residual
from estimation.track.panel.normal_equations import init, update
from estimation.track.panel.solution import PanelSolution, residual_of_passes, result
from estimation.track.passes import Pass, ProfileLife
from estimation.values.arrays import FloatArray

CLIPPED = 1e-3  # m of residual
FEWEST = 300.0  # samples of a knot that count
SIZE = 0.2  # m of h1 for a metre of gauge, rms: half is the most, at the flange
MIXTURES = (0.0, 45.0, 90.0, 135.0)  # degrees between the two leading vectors
TRIAL_LENGTH = 4000.0  # m
LEAST_GAUGE = 0.3e-3  # m, std in the first trial: noise alone makes less, and as little would not matter


def initial_gauge_effect(
    passes: Sequence[GriddedPass], solution: PanelSolution, panel: Panel, prior: GaugePrior
) -> FloatArray | None:
    """Return h1 (w, gauge_basis_count), m for ``gauge_unit`` of gauge, from the residuals of a panel without gauge.

    None where a gauge that would explain the residuals hardly varies.

    Args:
        solution, panel: As solved without gauge.
    """
    vectors = _leading_vectors(passes, solution, panel)
    candidates = []
    for degrees in MIXTURES:
        mixed = np.cos(np.radians(degrees)) * vectors.first + np.sin(np.radians(degrees)) * vectors.second
        size = np.sqrt((mixed**2 * vectors.weight).sum() / vectors.weight.sum())
        odd = mixed * SIZE * panel.parameters.gauge_unit / size
        candidates.append(np.concatenate([-odd[:, :0:-1], np.zeros((len(odd), 1)), odd[:, 1:]], axis=1))
    return _best_candidate(candidates, solution.lives, passes, panel, prior)


@dataclass(frozen=True, slots=True)
class _LeadingVectors:
    """The two leading eigenvectors over (w, knots of R >= 0), and how many samples each knot has."""

    first: FloatArray  # (w, k)
    second: FloatArray  # (w, k)
    weight: FloatArray  # (w, k)


def _leading_vectors(passes: Sequence[GriddedPass], solution: PanelSolution, panel: Panel) -> _LeadingVectors:
    knots = panel.parameters.gauge_knots[panel.parameters.gauge_basis_count // 2 :]
    k, w = len(knots), len(solution.lives)
    sums, own, count = np.zeros((panel.grid.points, w * k)), np.zeros((w * k, w * k)), np.zeros(w * k)
    for item in passes:
        curve = solution.curve_of(item.life)
        if item.empty or curve is None:
            continue
        at = item.used_points
        residual = pass_residual(item, curve, panel)[item.inside] - solution.alignment[at]
        known = np.isfinite(residual)
        residual = item.side * np.clip(np.where(known, residual, 0.0), -CLIPPED, CLIPPED)
        R = item.difference[item.inside]
        basis = basis_functions(np.minimum(np.abs(R), panel.parameters.reach), knots) * known
        products = panel.known.weight_of(item.life) * basis * np.sign(R) * residual
        number = solution.lives.index(item.life)
        columns = slice(number * k, (number + 1) * k)
        sums[at, columns] += item.side * products.T
        own[columns, columns] += products @ products.T
        count[columns] += basis.sum(axis=1)
    weight = np.maximum(count, FEWEST)
    covariance = (sums.T @ sums - own) / np.sqrt(np.outer(weight, weight))
    _, vectors = np.linalg.eigh(covariance)
    second, first = (vectors[:, -2:] / np.sqrt(weight)[:, None]).T
    return _LeadingVectors(first.reshape(w, k), second.reshape(w, k), weight.reshape(w, k))


def _best_candidate(
    candidates: Sequence[FloatArray],
    lives: Sequence[ProfileLife],
    passes: Sequence[GriddedPass],
    panel: Panel,
    prior: GaugePrior,
) -> FloatArray | None:
    """Return the candidate with which one round leaves the least on a part of the section; None without a gauge."""
    section = panel.grid.length
    length = min(TRIAL_LENGTH, section)
    begin = 0.5 * (section - length)
    small = Panel.of(replace(panel.parameters, length=length), replace(panel.known, gauge=None))
    part = [
        grid_pass(cut, small.grid, item.ratio)
        for item in passes
        if (cut := _cut(item.source, begin, begin + length)) is not None
    ]
    start = result(update(init(small), part), std=False)
    zero = small.with_gauge(np.zeros(small.grid.points))
    kept = [lives.index(life) for life in start.lives]
    residuals: list[float] = []
    for effect in candidates:
        gauge = gauge_step(part, with_gauge_effect(start, effect[kept], zero), zero, prior).gauge
        if not residuals and gauge.std() < LEAST_GAUGE:
            return None
        state = update(init(small.with_gauge(gauge)), part)
        residuals.append(residual_of_passes(state, result(state, std=False)))
    return candidates[int(np.argmin(residuals))]


def _cut(item: Pass, begin: float, end: float) -> Pass | None:
    """Return a pass between two places, m, counted from the first; None where it has not been there."""
    within = (item.at >= begin) & (item.at <= end)
    if within.sum() < 2:  # noqa: PLR2004 - a pass has a length
        return None
    return replace(
        item,
        at=item.at[within] - begin,
        displacement=item.displacement[within],
        difference=item.difference[within],
        stiffness_term=None if item.stiffness_term is None else item.stiffness_term[within],
    )
