"""What the passes of a section say of its surveyed gauge: a right one makes them agree better, a wrong one does not.

The gauge moves wheelsets of different wear apart. Where the passes of a place disagree by more than their sensors make
them, and the gauge on file takes nothing off that, it is that of another place, or of another time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.track.gauge.initial_shape import LEAST_GAUGE
from estimation.track.gauge.wheel_functions import contact_samples, gauge_factor
from estimation.track.iteration import IterationResult
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackAlignment


@dataclass(frozen=True, slots=True)
class GaugeLimits:
    """When a surveyed gauge is right."""

    visible: float = 0.1e-3  # m, rms of y - d - h(R) without it, from which on a gauge shows
    least_explained: float = 0.15  # of that rms
    most_scale: float = 1.3  # by which it may be too large or too small


def judge_gauge(
    iterated: IterationResult | None, survey: TrackAlignment, limits: GaugeLimits | None = None
) -> Reason | None:
    """Return what is wrong with a surveyed gauge; None where nothing is, or where the passes cannot show it.

    Parameters
    ----------
    iterated
        Where the rounds with the survey ended; None where there were none.
    survey
        With its gauge.
    limits
        When a gauge is right.
    """
    p = limits or GaugeLimits()
    varies = survey.gauge_known and float(np.std(survey.gauge_deviation)) >= LEAST_GAUGE
    if iterated is None or not varies or iterated.panel.gauge is None:
        return None
    before, after = iterated.noise_without_gauge, iterated.noise
    if before < p.visible:
        return None
    if after > (1.0 - p.least_explained) * before:
        text = (
            f"its gauge explains nothing of the {1e3 * before:.2f} mm by which passes disagree: {1e3 * after:.2f} mm"
            " remain; it is that of another place, or displaced"
        )
        return Reason(ReasonCode.SURVEY_GAUGE_UNRELATED, text)
    factor = gauge_factor(contact_samples(iterated.passes, iterated.solution, iterated.panel))
    if 1.0 / p.most_scale <= factor <= p.most_scale:
        return None
    text = f"its gauge is {1.0 / factor:.2g} times what the wheelsets show"
    return Reason(ReasonCode.SURVEY_GAUGE_UNIT, text)
