"""What the passes of a section say of its survey: right, wrong, or not to be decided.

It is judged by how well it explains them, y = a d + h_w(R), with all that is uncertain left free: curves, stiffness
ratios, positions, the survey's own error. The factor ``a`` is 1 for a right survey, its inverse is that of another
unit or scale, and it is near zero for the survey of another section. A survey is refused where another scale, place or
section is beyond what the passes themselves may be wrong by; short of that it is kept, and the doubt names who else
may be wrong. Nothing is compared with an alignment that the fleet has found by itself: that may be wrong as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from estimation.track.iteration import IterationResult
from estimation.track.panel.basis import PanelState, groups_of, init, update
from estimation.track.panel.solution import PriorAlignment, curves_of_sum, prior_of_curves
from estimation.track.parameters import TRACK
from estimation.track.passes import Journey
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.quantities import jackknife_std
from estimation.values.reasons import Reason, ReasonCode, combined
from estimation.values.track import Correction


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
        share = min(own / self.size**2, TRACK.most_survey_error_share) if self.size > 0.0 else 0.0
        return (1.0 - share) / self.factor if self.factor != 0.0 else float("inf")


def fit_survey(iterated: IterationResult, survey: PriorAlignment) -> SurveyFit | None:
    """Return how well a survey fits the passes that were placed on it; None where too little of it was passed."""
    covered, passed = np.isfinite(survey.std), iterated.state.passes > 0
    if not (covered & passed).any():
        return None
    state, last = iterated.state, iterated.panel.grid.points - 1
    if not (covered | ~passed).all():
        kept = [replace(item, inside=item.inside & covered[np.clip(item.points, 0, last)]) for item in iterated.passes]
        state = update(init(iterated.panel), kept)
    sums = _Sums.of(state, survey.alignment)
    present = np.flatnonzero(sums.square > 0.0)
    if len(present) < TRACK.fewest_blocks:
        return None
    factor, explained, followed = sums.fit(present)
    if not np.isfinite(factor):
        return None
    without = [sums.fit(present[present != group])[0] for group in present]
    known, d = state.passes >= 1.0, survey.alignment
    passes = state.passes[known]
    rest = (state.displacement - curves_of_sum(state, iterated.solution.curves[0]))[known] / passes - d[known]
    free = float(np.mean(iterated.noise**2 / passes))  # of sensors
    return SurveyFit(
        factor=factor,
        factor_std=float(jackknife_std(np.array([factor, *without]))),
        explained=explained,
        followed=followed,
        error=float(np.sqrt(max(float(np.mean(rest**2)) - free, 0.0))),
        size=float(np.sqrt(np.mean(d[covered] ** 2))),
    )


@dataclass(frozen=True, slots=True)
class _Sums:
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


CONFIRMED = "agrees with what the fleet has measured"
NOT_COVERED = "the passes do not cover enough of the section"
MIRRORED = Reason(ReasonCode.SURVEY_MIRRORED, "left and right are exchanged: it is the mirror image")


@dataclass(frozen=True, slots=True)
class VerdictLimits:
    """When a survey is right."""

    understated: float = 5.0  # times the std on file that a survey's errors may be, for it to be of this section
    least_factor: float = 0.5  # of the factor that a survey with such errors has
    related: float = 6.0  # stds of the factor: journeys that are placed on another section's survey make 1 to 2
    least_of_unlike: float = 0.75  # the same where it is unlike what the passes show:
    least_explained: float = 0.5  # of what the curves leave of y
    most_error: float = 0.5  # of the survey's size
    most_scale: float = 0.06  # by which a survey may be too large or too small, besides its std
    widest_factor: float = 0.1  # relative std of the factor beyond which the passes do not know it
    largest_shift: float = 3.0  # m, of all journeys, besides the uncertainty of their mean
    least_followed: float = 0.5  # share of y - d that the curves must explain for vehicles to follow their equations
    stds: float = 3.0  # that count as beyond doubt
    slow: float = 0.9  # share that the curves explain below which passes may be at fault: slow, stiff or struck
    few_journeys: int = 4


@dataclass(frozen=True, slots=True)
class Witnesses:
    """Who says so: what passes may be wrong by in common, which their scatter does not show."""

    corrections: Mapping[Journey, Correction]
    slope_std: float = 0.0  # relative, of all curves together

    @property
    def vehicles(self) -> int:
        """How many vehicles have passed."""
        return len({vehicle for vehicle, _ in self.corrections})


@dataclass(frozen=True, slots=True)
class SurveyVerdict:
    """``refused`` where the survey is wrong beyond doubt; without a reason nothing has been decided yet.

    ``contradicted`` where something is wrong, but not what: nothing is estimated from such passes. ``harmless`` where
    all that is wrong is its zero point, which the positions of journeys on it make up for. ``elsewhere`` where another
    section, place or the other side fits better. ``doubted_scale`` is the relative scale error of a survey that is kept
    although the passes show one.
    """

    refused: bool
    reason: Reason | None
    contradicted: bool = False
    harmless: bool = False
    elsewhere: bool = False
    doubted_scale: float = 0.0


def survey_verdict(fit: SurveyFit | None, witnesses: Witnesses, filed_std: float, *, converged: bool) -> SurveyVerdict:
    """Return what the passes say of a survey.

    Its errors, however large, are no reason to refuse it: they are learnt, and it counts by them.

    Args:
        fit: How well it explains them; None where too little of it was passed.
        filed_std: Of the survey, m, as on file.
        converged: Whether positions and stiffness ratios have: until then nothing but another section is refused.
    """
    p = VerdictLimits()
    if fit is None or not np.isfinite(fit.factor_std):
        return SurveyVerdict(refused=False, reason=_open(NOT_COVERED))
    if fit.followed < p.least_followed:
        text = (
            f"the curves explain {fit.followed:.0%} of the passes: they do not follow the equations of their vehicles"
            " on this survey; which of parameters, survey and positions is wrong is open"
        )
        contradiction = Reason(ReasonCode.MODEL_CONTRADICTED, text)
        return SurveyVerdict(refused=False, reason=contradiction, contradicted=True, elsewhere=True)
    mirrored = fit.factor + p.stds * fit.factor_std < 0.0
    if mirrored or _unrelated(fit, filed_std, p):
        text = (
            f"it explains {fit.explained:.0%} of what the curves leave of the passes,"
            f" and differs from them by {1e3 * fit.error:.2f} mm of its {1e3 * fit.size:.2f} mm"
        )
        reason = MIRRORED if mirrored else Reason(ReasonCode.SURVEY_UNRELATED, text)
        return SurveyVerdict(refused=True, reason=reason, elsewhere=not mirrored)
    if not converged:
        return SurveyVerdict(refused=False, reason=None)
    if not fit.factor_std <= p.widest_factor * abs(fit.factor):
        elsewhere = _displaced(witnesses, p, alone=True) is not None
        return SurveyVerdict(refused=False, reason=_open(NOT_COVERED), elsewhere=elsewhere)
    return _judged(fit, witnesses, filed_std, p)


def is_mirrored(
    verdict: SurveyVerdict, fit: SurveyFit | None, image: SurveyVerdict, image_fit: SurveyFit | None
) -> bool:
    """Return whether a survey that does not fit is a mirror image: waves may look alike half a wave away."""
    if fit is None or image_fit is None or image.refused or image.contradicted or image.elsewhere:
        return False
    related = image_fit.factor > VerdictLimits().related * image_fit.factor_std
    return verdict.elsewhere and related and image_fit.explained > fit.explained


def _judged(fit: SurveyFit, witnesses: Witnesses, filed_std: float, p: VerdictLimits) -> SurveyVerdict:
    open_scale = p.stds * witnesses.slope_std + (1.0 - fit.followed)
    scaled = _scaled(fit, open_scale, p)
    displaced = _displaced(witnesses, p)
    wrong = combined([scaled, displaced])
    if wrong is not None:
        harmless = scaled is None and not _explains_little(fit, filed_std, p)
        return SurveyVerdict(refused=True, reason=wrong, harmless=harmless, elsewhere=displaced is not None)
    scaled, displaced = _scaled(fit, 0.0, p), _displaced(witnesses, p, alone=True)
    doubted = combined([scaled, displaced])
    if doubted is not None:
        text = f"it is kept, although {doubted.text}: as well {_at_fault(fit, witnesses, p)} may be wrong"
        scale = 0.0 if scaled is None else abs(float(np.log(fit.scale)))
        elsewhere = displaced is not None
        return SurveyVerdict(refused=False, reason=_open(text), elsewhere=elsewhere, doubted_scale=scale)
    return SurveyVerdict(refused=False, reason=Reason(ReasonCode.SURVEY_CONFIRMED, CONFIRMED))


def _unrelated(fit: SurveyFit, filed_std: float, p: VerdictLimits) -> bool:
    below = min(p.related * fit.factor_std, p.least_factor - p.stds * fit.factor_std)
    if fit.factor < below and fit.error > fit.size:  # a straight line would be nearer to it
        return True
    least = p.least_of_unlike if _explains_little(fit, filed_std, p) else p.least_factor
    share = min(p.understated * filed_std / fit.size, 1.0) if fit.size > 0.0 else 1.0
    return fit.factor + p.stds * fit.factor_std < least * (1.0 - share**2)


def _explains_little(fit: SurveyFit, filed_std: float, p: VerdictLimits) -> bool:
    return fit.explained < p.least_explained and fit.error > max(p.most_error * fit.size, p.understated * filed_std)


def _at_fault(fit: SurveyFit, witnesses: Witnesses, p: VerdictLimits) -> str:
    found = []
    if witnesses.vehicles == 1:
        found.append("the only vehicle that has passed")
    if len(witnesses.corrections) < p.few_journeys:
        found.append(f"the few passes ({len(witnesses.corrections)} journeys)")
    if fit.followed < p.slow:
        found.append(f"the passes, of which the curves explain {fit.followed:.0%}: slow, stiff, struck or on switches")
    return " or ".join(found) or "what all vehicles have in common"


def place_of(corrections: Mapping[Journey, Correction]) -> tuple[float, float]:
    """Return the mean by which journeys were moved and its std, m."""
    offsets = [correction.offset for correction in corrections.values()]
    if not offsets:
        return 0.0, 0.0
    return float(np.mean(offsets)), float(np.std(offsets) / np.sqrt(len(offsets)))


def _open(text: str) -> Reason:
    return Reason(ReasonCode.SURVEY_NOT_ASSESSABLE, text)


def _scaled(fit: SurveyFit, open_scale: float, p: VerdictLimits) -> Reason | None:
    """Return that a survey has another scale, by more than its fit and what the passes leave open (relative)."""
    allowed = p.most_scale + p.stds * fit.factor_std / abs(fit.factor) + open_scale
    if fit.scale > 0.0 and abs(float(np.log(fit.scale))) <= float(np.log1p(allowed)):
        return None
    return Reason(ReasonCode.SURVEY_UNIT, f"it is {fit.scale:.3g} times what the fleet has measured")


def _displaced(witnesses: Witnesses, p: VerdictLimits, *, alone: bool = False) -> Reason | None:
    """Return that a survey is displaced; of one vehicle, whose positions may all be off, only where ``alone``."""
    mean, std = place_of(witnesses.corrections)
    if abs(mean) <= p.largest_shift + p.stds * std or (witnesses.vehicles == 1 and not alone):
        return None
    direction = "along" if mean > 0.0 else "back"
    text = f"it is {abs(mean):.1f} m too far {direction}, or all positions are as much off the other way"
    return Reason(ReasonCode.SURVEY_DISPLACED, text)
