"""How well a survey explains what the passes have measured: y = a d + h_w(R), with the survey's d and all curves free.

Nothing is compared with an alignment that the fleet has found by itself: that one may be wrong, however small its
standard deviation, where wheelsets are alike. The factor ``a`` is 1 for a right survey, its inverse is that of another
unit or scale, and it is near zero for the survey of another section. The sums of the panel hold all that is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from estimation.track.iteration import IterationResult
from estimation.track.panel.normal_equations import PanelState, groups_of
from estimation.track.panel.prior_alignment import PriorAlignment
from estimation.track.panel.solution import curves_of_sum, prior_of_curves
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.intervals import jackknife_std

FEWEST_GROUPS = 4  # of blocks along the section
MOST_ERROR_SHARE = 0.97  # of a survey's mean square that its own error may make up


@dataclass(frozen=True, slots=True)
class SurveyFit:
    """What the passes say of a survey; standard deviations from blocks along the section."""

    factor: float  # of the survey that fits best: 1 for a right one
    factor_std: float
    explained: float  # share of what the curves leave of y that the survey explains
    followed: float  # share of y - a d that the curves explain: little where vehicles obey other equations
    error: float  # m, rms by which survey and passes differ in the band, sensors' noise taken off
    size: float  # m, rms of the survey in the band
    coherent: float = 0.0  # m, rms of what of that follows the motion: no error that a survey has by itself

    @property
    def scale(self) -> float:
        """Survey over truth: an error of the survey makes the factor too small, which is taken back."""
        own = max(self.error**2 - self.coherent**2, 0.0)
        share = min(own / self.size**2, MOST_ERROR_SHARE) if self.size > 0.0 else 0.0
        return (1.0 - share) / self.factor if self.factor != 0.0 else float("inf")


def fit_survey(iterated: IterationResult, survey: PriorAlignment) -> SurveyFit | None:
    """Return how well a survey fits the passes that were placed on it; None where too little of it was passed."""
    state = _on_survey(iterated, survey)
    if state is None:
        return None
    sums = _Sums.of(state, survey.alignment)
    present = np.flatnonzero(sums.square > 0.0)
    if len(present) < FEWEST_GROUPS:
        return None
    factor, explained, followed = sums.fit(present)
    if not np.isfinite(factor):
        return None
    without = [sums.fit(present[present != group])[0] for group in present]
    return SurveyFit(
        factor=factor,
        factor_std=float(jackknife_std(np.array([factor, *without]))),
        explained=explained,
        followed=followed,
        error=_survey_error(state, iterated, survey.alignment),
        size=float(np.sqrt(np.mean(survey.alignment[np.isfinite(survey.std)] ** 2))),
    )


def _on_survey(iterated: IterationResult, survey: PriorAlignment) -> PanelState | None:
    """Return the sums over the passes where the survey is known; None where that is not passed."""
    covered = np.isfinite(survey.std)
    if not (covered & (iterated.state.passes > 0)).any():
        return None
    if (covered | (iterated.state.passes == 0)).all():
        return iterated.state
    return iterated.restricted_to(covered)


@dataclass(frozen=True, slots=True)
class _Sums:
    """Sums of y, the survey d and the basis functions, by group of blocks."""

    state: PanelState
    basis: FloatArray  # (g, w, k) sum of phi d
    displacement: FloatArray  # (g,) sum of y d
    survey: FloatArray  # (g,) sum of d^2
    square: FloatArray  # (g,) sum of y^2

    @classmethod
    def of(cls, state: PanelState, d: FloatArray) -> _Sums:
        group = groups_of(np.arange(len(d)), state.panel)
        count = state.panel.parameters.groups
        basis = np.stack([state.basis_sums[:, :, group == g] @ d[group == g] for g in range(count)])
        along = np.bincount(group, weights=state.displacement * d, minlength=count)
        own = np.bincount(group, weights=state.passes * d * d, minlength=count)
        basis_sums, with_y, squares = (np.asarray(part, dtype=np.float64) for part in (basis, along, own))
        return cls(state, basis_sums, with_y, squares, state.square)

    def fit(self, groups: IntArray) -> tuple[float, float, float]:
        """Return the factor of the survey, the share that it explains, and that of the curves, from some groups."""
        gram, cross = self.state.gram[groups].sum(axis=0), self.state.cross[groups].sum(axis=0)
        basis = self.basis[groups].sum(axis=0)
        prior = prior_of_curves(gram, self.state.panel)
        along, own, square = (float(part[groups].sum()) for part in (self.displacement, self.survey, self.square))
        raw_along, raw_own, raw_square = along, own, square
        for matrix, y, d in zip(gram, cross, basis, strict=True):
            of_y, of_d = linalg.solve(matrix + prior, np.stack([y, d]).T, assume_a="pos").T
            along, own, square = along - float(d @ of_y), own - float(d @ of_d), square - float(y @ of_y)
        if not (own > 0.0 and square > 0.0):
            return float("nan"), 0.0, 0.0
        factor = along / own
        displacement = raw_square - 2.0 * factor * raw_along + factor**2 * raw_own
        return factor, min(along**2 / (own * square), 1.0), 1.0 - (square - factor * along) / displacement


def _survey_error(state: PanelState, iterated: IterationResult, d: FloatArray) -> float:
    """Return the rms, m, of what the mean of y - h(R) over the passes of a place differs from the survey by."""
    known = state.passes >= 1.0
    passes = state.passes[known]
    rest = (state.displacement - curves_of_sum(state, iterated.solution.curves[0]))[known] / passes - d[known]
    free = float(np.mean(iterated.noise**2 / passes))
    return float(np.sqrt(max(float(np.mean(rest**2)) - free, 0.0)))
