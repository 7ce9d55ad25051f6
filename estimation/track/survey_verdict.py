"""What the passes of a section say of its survey: right, wrong, or not to be decided.

The passes decide by how well the survey explains them, with all that is uncertain left free: the curves of all
wheelsets, stiffness ratios, the position of every journey, the survey's own error (``survey_fit``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimation.track.journeys import Journey
from estimation.track.survey_fit import SurveyFit
from estimation.values.reasons import Reason, ReasonCode, combined
from estimation.values.track import Correction

CONFIRMED = "agrees with what the fleet has measured"


@dataclass(frozen=True, slots=True)
class VerdictLimits:
    """When a survey is right."""

    least_explained: float = 0.5  # of what the curves leave of y
    most_error: float = 0.5  # of the survey's size: beyond, it is worth no more than none
    most_scale: float = 0.06  # by which a survey may be too large or too small, besides its std
    widest_factor: float = 0.05  # std of the factor beyond which the passes do not know it
    largest_shift: float = 3.0  # m, of all journeys, besides the uncertainty of their mean
    least_followed: float = 0.5  # share of y - d that the curves must explain for vehicles to follow their equations
    stds: float = 3.0  # that count as beyond doubt


@dataclass(frozen=True, slots=True)
class SurveyVerdict:
    """``refused`` where the survey is wrong beyond doubt; without a reason nothing has been decided yet.

    ``contradicted`` where something is wrong, but not what: nothing is estimated from such passes.
    """

    refused: bool
    reason: Reason | None
    contradicted: bool = False


def survey_verdict(
    fit: SurveyFit | None,
    corrections: Mapping[Journey, Correction],
    *,
    converged: bool,
    limits: VerdictLimits | None = None,
) -> SurveyVerdict:
    """Return what the passes say of a survey.

    Parameters
    ----------
    fit
        How well it explains them; None where too little of it was passed.
    corrections
        Of the journeys that were placed on it.
    converged
        Whether positions and stiffness ratios have converged: until then nothing but another section is refused.
    limits
        When a survey is right.
    """
    p = limits or VerdictLimits()
    if fit is None or not fit.factor_std <= p.widest_factor:
        return SurveyVerdict(refused=False, reason=_open("the passes do not cover enough of the section"))
    if fit.followed < p.least_followed:
        text = (
            f"the curves explain {fit.followed:.0%} of the passes: they do not follow the equations of their vehicles"
            " on this survey; which of parameters, survey and positions is wrong is open"
        )
        return SurveyVerdict(refused=False, reason=Reason(ReasonCode.MODEL_CONTRADICTED, text), contradicted=True)
    if fit.explained < p.least_explained and fit.error > p.most_error * fit.size:
        text = (
            f"it explains {fit.explained:.0%} of what the curves leave of the passes,"
            f" and differs from them by {1e3 * fit.error:.2f} mm of its {1e3 * fit.size:.2f} mm"
        )
        return SurveyVerdict(refused=True, reason=Reason(ReasonCode.SURVEY_UNRELATED, text))
    if not converged:
        return SurveyVerdict(refused=False, reason=None)
    wrong = combined([_scaled(fit, p), _displaced(corrections, p), _different(fit, p)])
    if wrong is not None:
        return SurveyVerdict(refused=True, reason=wrong)
    return SurveyVerdict(refused=False, reason=Reason(ReasonCode.SURVEY_CONFIRMED, CONFIRMED))


def place_of(corrections: Mapping[Journey, Correction]) -> tuple[float, float]:
    """Return the mean by which journeys were moved and its std, m.

    Parameters
    ----------
    corrections
        Of their positions.
    """
    offsets = [correction.offset for correction in corrections.values()]
    if not offsets:
        return 0.0, 0.0
    return float(np.mean(offsets)), float(np.std(offsets) / np.sqrt(len(offsets)))


def _open(text: str) -> Reason:
    return Reason(ReasonCode.SURVEY_NOT_ASSESSABLE, text)


def _scaled(fit: SurveyFit, p: VerdictLimits) -> Reason | None:
    # what the curves leave of the passes is error of R: it flattens them, and the factor makes up for that
    allowed = p.most_scale + p.stds * fit.factor_std + (1.0 - fit.followed)
    if abs(float(np.log(fit.scale))) <= float(np.log1p(allowed)) if fit.scale > 0.0 else False:
        return None
    if fit.scale < 0.0:
        return Reason(ReasonCode.SURVEY_MIRRORED, "left and right are exchanged: it is the mirror image")
    return Reason(ReasonCode.SURVEY_UNIT, f"it is {fit.scale:.3g} times what the fleet has measured")


def _displaced(corrections: Mapping[Journey, Correction], p: VerdictLimits) -> Reason | None:
    mean, std = place_of(corrections)
    if abs(mean) <= p.largest_shift + p.stds * std:
        return None
    direction = "along" if mean > 0.0 else "back"
    text = f"it is {abs(mean):.1f} m too far {direction}, or all positions are as much off the other way"
    return Reason(ReasonCode.SURVEY_DISPLACED, text)


def _different(fit: SurveyFit, p: VerdictLimits) -> Reason | None:
    if fit.error <= p.most_error * fit.size:
        return None
    text = f"it differs from the passes by {1e3 * fit.error:.2f} mm of its {1e3 * fit.size:.2f} mm"
    return Reason(ReasonCode.SURVEY_DIFFERS, text)
