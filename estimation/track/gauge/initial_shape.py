"""What the gauge does to wheelsets, from nothing: the residuals of a panel without gauge vary together.

A residual of the panel is nearly e(s) h1(R), so the covariance of residuals at one place over (wheelset, R) is the
product of h1 with itself: its leading eigenvectors are h1 and, where the gauge varies much, what its square does. No
start is needed. Passes at a place mostly have R of one sign, so what h1 is at R > 0 says little of R < 0; wheelsets are
taken as alike on both sides, h1(-R) = -h1(R). Which mixture of the two leading vectors h1 is, a trial tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.filters.local_cubic import high_pass, local_cubic_kernel
from estimation.track.gauge.least_squares_step import GaugePrior, gauge_step, with_gauge_effect
from estimation.track.panel.basis import PanelParameters, basis_functions, columns, on_grid
from estimation.track.panel.normal_equations import init, update
from estimation.track.panel.solution import PanelSolution, residual_of_passes, result
from estimation.track.passes import Pass
from estimation.values.arrays import FloatArray

CLIPPED = 1e-3  # m of residual
FEWEST = 300.0  # samples of a knot that count
SIZE = 0.2  # m of h1 for a metre of gauge, rms: half is the most, at the flange
MIXTURES = (0.0, 45.0, 90.0, 135.0)  # degrees between the two leading vectors
TRIAL_LENGTH = 4000.0  # m
LEAST_GAUGE = 0.3e-3  # m, std in the first trial: noise alone makes less, and as little would not matter


def initial_gauge_effect(
    passes: Sequence[Pass], solution: PanelSolution, panel: PanelParameters, prior: GaugePrior
) -> FloatArray | None:
    """Return h1 (w, gauge_hats), m for ``panel.gauge_unit`` of gauge, of a panel solved without gauge.

    None where a gauge that would explain the residuals hardly varies.
    """
    first, second, weight = _leading(passes, solution, panel)
    candidates = []
    for degrees in MIXTURES:
        mixed = np.cos(np.radians(degrees)) * first + np.sin(np.radians(degrees)) * second
        size = np.sqrt((mixed**2 * weight).sum() / weight.sum())
        odd = mixed * SIZE * panel.gauge_unit / size
        candidates.append(np.concatenate([-odd[:, :0:-1], np.zeros((len(odd), 1)), odd[:, 1:]], axis=1))
    return _tried(candidates, solution.wheelsets, passes, panel, prior)


def _leading(
    passes: Sequence[Pass], solution: PanelSolution, panel: PanelParameters
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the two leading vectors over (w, knots of R >= 0), and how many samples each knot has."""
    weights = local_cubic_kernel(panel.cutoff_wavelength, panel.step)
    knots = panel.gauge_knots[panel.gauge_basis_count // 2 :]
    k, w = len(knots), len(solution.wheelsets)
    sums, own, count = np.zeros((panel.points, w * k)), np.zeros((w * k, w * k)), np.zeros(w * k)
    for item in passes:
        felt = on_grid(item, panel)
        if felt is None:
            continue
        number = solution.wheelsets.index(item.wheelset)
        rest = felt.displacement - item.side * (solution.curves[0, number] @ columns(felt, panel))
        at = felt.points[felt.inside]
        residual = high_pass(rest, weights)[felt.inside] - solution.alignment[at]
        met = np.isfinite(residual)
        residual = item.side * np.clip(np.where(met, residual, 0.0), -CLIPPED, CLIPPED)
        R = felt.difference[felt.inside]
        hats = basis_functions(np.minimum(np.abs(R), panel.reach), knots) * met
        felt_there = panel.weight_of(item.wheelset) * hats * np.sign(R) * residual
        mine = slice(number * k, (number + 1) * k)
        sums[at, mine] += item.side * felt_there.T
        own[mine, mine] += felt_there @ felt_there.T
        count[mine] += hats.sum(axis=1)
    weight = np.maximum(count, FEWEST)
    covariance = (sums.T @ sums - own) / np.sqrt(np.outer(weight, weight))
    _, vectors = np.linalg.eigh(covariance)
    second, first = (vectors[:, -2:] / np.sqrt(weight)[:, None]).T
    return first.reshape(w, k), second.reshape(w, k), weight.reshape(w, k)


def _tried(
    candidates: Sequence[FloatArray],
    wheelsets: Sequence[str],
    passes: Sequence[Pass],
    panel: PanelParameters,
    prior: GaugePrior,
) -> FloatArray | None:
    """Return the candidate with which one round leaves the least on a part of the section; None without a gauge."""
    length = min(TRIAL_LENGTH, panel.length)
    begin = 0.5 * (panel.length - length)
    part = [cut for item in passes if (cut := _cut(item, begin, begin + length)) is not None]
    small = replace(panel, length=length, gauge=None)
    start = result(update(init(small), part), std=False)
    zero = replace(small, gauge=np.zeros(small.points))
    met = [wheelsets.index(name) for name in start.wheelsets]
    tried: list[float] = []
    for effect in candidates:
        gauge = gauge_step(part, with_gauge_effect(start, effect[met], zero), zero, prior)
        if not tried and gauge.std() < LEAST_GAUGE:
            return None
        given = replace(small, gauge=gauge)
        state = update(init(given), part)
        tried.append(residual_of_passes(state, result(state, std=False)))
    return candidates[int(np.argmin(tried))]


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
