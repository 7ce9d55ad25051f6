"""The solution of a panel: curves, alignment, whether they can be separated; and what was known before as a pass."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from estimation.filters import between_known, high_pass, local_cubic_kernel, valid_support
from estimation.track.gridded_pass import GriddedPass, SectionGrid
from estimation.track.panel.basis import MeasuredCurve, Panel, PanelParameters, PanelState, groups_of
from estimation.track.passes import ProfileLife
from estimation.values.arrays import FloatArray, IntArray, as_slice
from estimation.values.quantities import jackknife_std
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import AlignmentSource, TrackAlignment

SINGLE_WHEELSET = Reason(
    ReasonCode.SINGLE_WHEELSET, "one wheelset alone cannot separate the track from its own geometry"
)


@dataclass(frozen=True, slots=True)
class PanelSolution:
    """Curves and alignment with their standard deviations from blocks along the section."""

    reason: Reason | None  # why passes could not separate alignment and geometry, and no profile did; else None
    curves_fixed: bool  # by measured profiles
    lives: tuple[ProfileLife, ...]  # of the wheelsets
    knots: FloatArray  # (k,) R, m
    curves: FloatArray  # (1 + g, w, c) h(R) = y - d, m, and further columns: from all data, then without each group
    weight: FloatArray  # (w, k) how much of the data each knot has seen, in samples
    alignment: FloatArray  # (n,) high-passed d, m; NaN where too few passes
    alignment_std: FloatArray  # (n,) m
    common_std: FloatArray  # (n,) m, the share of it that the curves' uncertainty makes
    passes: FloatArray  # (n,) sum of their weights

    def curve_of(self, life: ProfileLife) -> FloatArray | None:
        """Return the coefficients (c,) of a wheelset from all data; None where it has no curve."""
        return self.curves[0, self.lives.index(life)] if life in self.lives else None

    def used(self, passes: Iterable[GriddedPass]) -> Iterator[tuple[GriddedPass, FloatArray]]:
        """Yield the passes that are not empty and whose wheelset has a curve, with its coefficients (c,)."""
        for item in passes:
            curve = self.curve_of(item.life)
            if curve is not None and not item.empty:
                yield item, curve


def result(state: PanelState, *, std: bool = True, parameters: PanelParameters) -> PanelSolution:
    """Return alignment and curves as the passes so far determine them; quicker without std."""
    p = state.panel.parameters
    n = state.panel.grid.points
    enough = state.passes >= p.least_passes
    parts = _normal_equations(state, by_group=std)
    total = _sum_of(parts)
    share = np.zeros(n)
    share[enough] = 1.0 / state.passes[enough]
    reason = _too_little(state, parameters)
    curves_fixed = reason is not None and not state.has_alignment and bool(enough.any()) and bool(_measured(state))
    curves = _curves(total, parts if std else (), state, curves_fixed=curves_fixed, parameters=parameters)
    alignments = (state.displacement - _by_curves(curves, state)) * share
    c, met = curves[0].reshape(-1), state.passes > 0
    within = state.square.sum() - (state.displacement[met] ** 2 / state.passes[met]).sum()
    squares = within - 2 * c @ total[1] + c @ total[0] @ c
    freedom = max(float(np.maximum(state.passes[met] - 1, 0.0).sum()) - len(c), 1.0)
    residual = float(np.sqrt(max(squares, 0.0) / freedom))
    common = jackknife_std(alignments)
    certainty = np.hypot(common, residual * np.sqrt(share))
    return PanelSolution(
        reason=None if curves_fixed else reason,
        curves_fixed=curves_fixed,
        lives=state.lives,
        knots=p.knots,
        curves=curves,
        weight=np.einsum("gwkk->wk", state.gram)[:, : p.basis_count],
        alignment=np.where(enough, alignments[0], np.nan),
        alignment_std=np.where(enough, certainty, np.nan),
        common_std=np.where(enough, common, np.nan),
        passes=state.passes,
    )


_Equations = tuple[FloatArray, FloatArray]
"""Normal matrix (w k, w k) and right side (w k,) of the curves, the alignment eliminated."""


def _normal_equations(state: PanelState, *, by_group: bool) -> list[_Equations]:
    group = groups_of(np.arange(state.panel.grid.points), state.panel)
    met = state.passes > 0
    if by_group:
        return [
            _reduced(state, gram, cross, np.flatnonzero(met & (group == g)))
            for g, (gram, cross) in enumerate(zip(state.gram, state.cross, strict=True))
        ]
    return [_reduced(state, state.gram.sum(axis=0), state.cross.sum(axis=0), np.flatnonzero(met))]


def _sum_of(parts: Sequence[_Equations]) -> _Equations:
    if len(parts) == 1:
        return parts[0]
    normal, right = parts[0][0].copy(), parts[0][1].copy()
    for part in parts[1:]:
        normal += part[0]
        right += part[1]
    return normal, right


def _reduced(state: PanelState, gram: FloatArray, cross: FloatArray, at: IntArray) -> _Equations:
    where = as_slice(at)
    G = state.basis_sums.reshape(-1, state.panel.grid.points)[:, where]
    per_pass = 1.0 / state.passes[where]
    root = G * np.sqrt(per_pass).astype(np.float32)
    normal = linalg.block_diag(*gram) - root @ root.T
    return normal, cross.ravel() - G @ (per_pass * state.displacement[where]).astype(np.float32)


def curves_of_sum(state: PanelState, curves: FloatArray) -> FloatArray:
    """Return the sum over passes (n,), m, of what curves (w, c) make of displacement."""
    return np.asarray(_by_curves(curves[None], state)[0])


def prior_of_curves(gram: FloatArray, panel: Panel) -> FloatArray:
    """Return the normal matrix (c, c) of what is known of one wheelset's columns, for sums (w, c, c) of all."""
    size = float(np.einsum("wkk->wk", gram)[:, : panel.parameters.basis_count].mean())
    return _prior(size if size > 0.0 else 1.0, panel)


def _by_curves(curves: FloatArray, state: PanelState) -> FloatArray:
    """Return the sum over passes (r, n), m, of what curves (r, w, c) make of displacement; rounded to a nanometre."""
    summed = state.basis_sums.reshape(-1, state.panel.grid.points)
    return np.asarray(curves.reshape(len(curves), -1).astype(np.float32) @ summed, dtype=np.float64)


def _curves(
    whole: _Equations,
    groups: Sequence[_Equations],
    state: PanelState,
    *,
    curves_fixed: bool,
    parameters: PanelParameters,
) -> FloatArray:
    w, p, c = len(state.lives), state.panel.parameters, state.panel.unknowns
    if w == 0:
        return np.zeros((1 + len(groups), 0, 1))
    diagonal = np.diag(whole[0])
    size = float(diagonal.reshape(w, -1)[:, : p.basis_count].mean())
    prior = linalg.block_diag(
        *[_prior(size if size > 0.0 else 1.0, state.panel)] * w
    )  # all passes too short: nothing was met
    prior += _no_common_shift(w, state.panel, 1e2 * float(diagonal.max(initial=0.0)))
    fixed = parameters.fixed_curve_weight * size if curves_fixed else None
    measured, measured_right = _prior_of_measured(state, fixed, parameters)
    prior += measured
    if curves_fixed:  # the passes determine the stiffness as little as the curves: it is as assumed
        stiffness = np.arange(c - 1, w * c, c)
        prior[stiffness, stiffness] += parameters.fixed_curve_weight * diagonal[stiffness]
    normal, right = whole[0] + prior, whole[1] + measured_right
    curves = [_solved(normal, right)]
    curves += [_solved(normal - left[0], right - left[1]) for left in groups]
    found = np.stack(curves).reshape(len(curves), w, c)
    found[:, :, : p.basis_count] -= found[:, :, [p.basis_count // 2]]
    return found


def _solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    try:
        factor = linalg.cho_factor(normal, lower=True, check_finite=False)
    except linalg.LinAlgError:
        return np.asarray(linalg.solve(normal, right, assume_a="sym"))
    return np.asarray(linalg.cho_solve(factor, right, check_finite=False))


def _prior(scale: float, panel: Panel) -> FloatArray:
    p, count = panel.parameters, panel.parameters.basis_count
    blocks = [scale * (_rough(count, p.roughness) + 1e-6 * np.ones((count, count)) / count)]
    if panel.gauge is not None:
        k = p.gauge_basis_count
        blocks += [scale * (_rough(k, 3 * p.roughness) + panel.parameters.gauge_ridge * np.eye(k))] * 2
    return linalg.block_diag(*blocks, np.full((1, 1), panel.parameters.stiffness_term_prior))


def _measured(state: PanelState) -> dict[int, MeasuredCurve]:
    measured = state.panel.measured
    return {number: measured[life] for number, life in enumerate(state.lives) if life in measured}


def _prior_of_measured(
    state: PanelState, fixed_weight: float | None, parameters: PanelParameters
) -> tuple[FloatArray, FloatArray]:
    """Return normal matrix (w c, w c) and right side (w c,) of h0 as measured, up to a constant."""
    # `fixed_weight` is that of a knot where only the measurement determines the curve; None weights it by its std
    w, p, c = len(state.lives), state.panel.parameters, state.panel.unknowns
    matrix, right = np.zeros((w * c, w * c)), np.zeros(w * c)
    for number, curve in _measured(state).items():
        displacement, reached = curve.at(p.knots)
        samples = (parameters.pass_std / curve.std) ** 2 * parameters.correlated_samples
        by_std = samples * parameters.independent_parts / p.basis_count
        weight = reached * (by_std if fixed_weight is None else fixed_weight)
        if not weight.any():
            continue
        block = np.diag(weight) - np.outer(weight, weight) / weight.sum()  # less its mean: the filter takes constants
        of_curve = slice(number * c, number * c + p.basis_count)
        matrix[of_curve, of_curve], right[of_curve] = block, block @ displacement
    return matrix, right


def _no_common_shift(w: int, panel: Panel, strength: float) -> FloatArray:
    """Return the normal matrix (w c, w c) of the mean of h1(0) and that of h2(0) over the wheelsets being zero."""
    # a common shift of all wheelsets in proportion to the gauge deviation, or its square, is inseparable from the track
    p, c = panel.parameters, panel.unknowns
    if panel.gauge is None:
        return np.zeros((w * c, w * c))
    middle = p.basis_count + p.gauge_basis_count // 2
    first, second = (np.tile(np.eye(c)[at], w) / w for at in (middle, middle + p.gauge_basis_count))
    return np.asarray(strength * (np.outer(first, first) + np.outer(second, second)))


def _rough(k: int, roughness: float) -> FloatArray:
    bend = np.diff(np.eye(k), 2, axis=0)
    return np.asarray(roughness * bend.T @ bend + 1e-9 * np.eye(k))


def residual_of_passes(state: PanelState, solution: PanelSolution) -> float:
    """Return the rms of y - d - h(R) over the passes alone, m, what they have shaped d and h by taken off."""
    c = solution.curves[0].reshape(len(state.lives), -1)
    d = np.nan_to_num(solution.alignment)
    count = np.where(np.isfinite(solution.alignment), state.passes, 0)
    rest = state.displacement - _by_curves(c[None], state)[0]
    squares = (
        state.square.sum()
        - 2.0 * np.einsum("wk,gwk->", c, state.cross)
        + np.einsum("wj,gwjk,wk->", c, state.gram, c)
        - 2.0 * float(d @ rest)
        + float(count @ (d * d))
    )
    own = state.passes[count > 0] / solution.passes[count > 0]  # share of d that the passes made
    freedom = max(float(count.sum()) - float(own.sum()) - c.size, 1.0)
    return float(np.sqrt(max(float(squares), 0.0) / freedom))


def between_pass_std_ratio(state: PanelState) -> float:
    """Return the std of R between the passes of a place over the std of R."""
    several = state.passes > 1
    count = state.passes[several]
    sums, squares = state.difference[0, several], state.difference[1, several]
    within = float((squares - sums**2 / count).sum() / max(int((count - 1).sum()), 1))
    total = float(squares.sum() / max(int(count.sum()), 1))
    return float(np.sqrt(max(within, 0.0) / total)) if total > 0 else 0.0


def too_few_passes(least: int, most: int) -> Reason:
    """Return that no place has enough passes, where the best one has ``most``."""
    return Reason(ReasonCode.TOO_FEW_PASSES, f"no place with {least} passes: {most} at most, {least - most} to go")


def _too_little(state: PanelState, parameters: PanelParameters) -> Reason | None:
    """Return why the passes alone cannot separate the track from the wheelsets; None where they can."""
    least = state.panel.parameters.least_passes
    if not (state.passes >= least).any():
        return too_few_passes(least, int(state.passes.max(initial=0)))
    if len(state.lives) < parameters.least_wheelsets:
        return SINGLE_WHEELSET
    diversity = between_pass_std_ratio(state)
    if diversity < parameters.least_diversity:
        text = f"the passes are too alike: diversity {diversity:.2f}, {parameters.least_diversity} is needed"
        return Reason(ReasonCode.PASSES_ALIKE, text)
    return None


@dataclass(frozen=True, slots=True)
class PriorAlignment:
    """Evidence on the grid: filtered alignment (n,), zero where there is none, and its std (n,), inf there."""

    alignment: FloatArray
    std: FloatArray
    passes: FloatArray
    gauge: FloatArray
    gauge_std: FloatArray
    gauge_known: bool
    surveyed: bool = False  # and not what passes have found

    @property
    def has_alignment(self) -> bool:
        """Whether it holds an alignment anywhere; it may hold the gauge alone."""
        return bool(np.isfinite(self.std).any())


def prior_on_grid(evidence: TrackAlignment, grid: SectionGrid, cutoff_wavelength: float) -> PriorAlignment:
    """Return the prior alignment on the panel's grid; one that has its cut-off already is not filtered again."""
    s = grid.s
    certain = np.isfinite(evidence.alignment) & np.isfinite(evidence.alignment_std)
    inside = between_known(s, evidence.s, certain)
    d = np.interp(s, evidence.s, np.where(certain, evidence.alignment, 0.0))
    std = np.interp(s, evidence.s, np.where(certain, evidence.alignment_std, 0.0))
    if evidence.cutoff_wavelength != cutoff_wavelength:
        weights = local_cubic_kernel(cutoff_wavelength, grid.step)
        inside = valid_support(inside, weights)
        d = high_pass(d, weights)
    passes = np.interp(s, evidence.s, evidence.passes.astype(np.float64))
    return PriorAlignment(
        np.where(inside, d, 0.0),
        np.where(inside, std, np.inf),
        np.where(inside, np.rint(passes), 0.0),
        np.interp(s, evidence.s, evidence.gauge_deviation),
        np.interp(s, evidence.s, evidence.gauge_deviation_std),
        evidence.gauge_known,
        surveyed=evidence.source == AlignmentSource.RECORDED,
    )


def add_prior(state: PanelState, known: PriorAlignment, noise: float, most_weight: float) -> PanelState:
    """Return the sums with the evidence added, as heavy as its variance makes it against a pass's ``noise`` (m)."""
    with np.errstate(divide="ignore"):
        weight = np.minimum((noise / known.std) ** 2, most_weight)
    d = known.alignment
    panel = state.panel
    group = groups_of(np.arange(panel.grid.points), panel)
    square = state.square + np.bincount(group, weights=weight * d * d, minlength=panel.parameters.groups)
    return replace(
        state,
        panel=replace(panel, parameters=replace(panel.parameters, least_passes=1)),
        displacement=state.displacement + weight * d,
        passes=state.passes + weight,
        square=square,
        has_alignment=known.has_alignment,
    )


def fleet_step(state: PanelState, solution: PanelSolution, known: PriorAlignment) -> float | None:
    """Return by how much the fleet as a whole is to be moved onto the prior alignment, m; None where they do not meet.

    Journeys move towards the alignment of all, most of which they have made themselves: as a whole they would come
    nearer by the share of the evidence in it, round by round, while stiffness ratios make up for what is left.
    """
    weight = solution.passes - state.passes
    observed = (weight > 0) & (state.passes > 0) & np.isfinite(solution.alignment)
    passes_of_fleet = np.where(observed, state.passes, 1)
    of_passes = (solution.passes * np.nan_to_num(solution.alignment) - weight * known.alignment) / passes_of_fleet
    slope = np.where(observed, np.gradient(np.where(observed, of_passes, 0.0), state.panel.grid.step), 0.0)
    square = float(slope @ slope)
    return float(slope @ np.where(observed, of_passes - known.alignment, 0.0)) / square if square > 0.0 else None
