"""What the passes of a section say of its surveyed gauge: a right one makes them agree better, a wrong one does not.

The gauge moves wheelsets of different wear apart. Where the passes of a place disagree by more than their sensors make
them, and the gauge on file takes less off that than one of its size should, it is that of another place, or of another
time. A gauge that is too small to be seen beside what else makes passes disagree is not judged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.track.alignment_std import GAUGE_EFFECT
from estimation.track.gauge.initial_shape import LEAST_GAUGE
from estimation.track.gauge.wheel_functions import contact_samples, gauge_factor_with_std
from estimation.track.iteration import IterationResult
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackAlignment


@dataclass(frozen=True, slots=True)
class GaugeLimits:
    """When a surveyed gauge is right."""

    visible: float = 0.1e-3  # m, rms of y - d - h(R) without it, from which on a gauge shows
    least_expected: float = 0.1  # of the square of that, which a gauge of its size must make for it to be judged
    least_explained: float = 0.25  # of what is expected
    most_scale: float = 1.3  # by which it may be too large or too small, besides the std of that
    stds: float = 3.0  # that count as beyond doubt


def judge_gauge(
    iterated: IterationResult | None, survey: TrackAlignment, *, converged: bool, limits: GaugeLimits | None = None
) -> Reason | None:
    """Return what is wrong with a surveyed gauge; None where nothing is, or where the passes cannot show it.

    Args:
        iterated: Where the rounds with the survey ended; None where there were none.
        converged: Whether positions and stiffness ratios have converged: until then nothing is refused.
    """
    p = limits or GaugeLimits()
    size = float(np.std(survey.gauge_deviation))
    if iterated is None or iterated.panel.gauge is None or not (converged and survey.gauge_known):
        return None
    before, after = iterated.noise_without_gauge, iterated.noise
    if size < LEAST_GAUGE or before < p.visible:
        return None
    expected = min((GAUGE_EFFECT * size / before) ** 2, 1.0)
    if expected < p.least_expected:
        return None
    if 1.0 - (after / before) ** 2 < p.least_explained * expected:
        return Reason(ReasonCode.SURVEY_GAUGE_UNRELATED, _gauge_unrelated(before, after))
    factor, std = gauge_factor_with_std(contact_samples(iterated.passes, iterated.solution, iterated.panel))
    if abs(np.log(factor)) > np.log(p.most_scale) + p.stds * std:  # never where the std is not known
        return Reason(ReasonCode.SURVEY_GAUGE_UNIT, f"it is {1.0 / factor:.2g} times what the wheelsets show")
    return None


def _gauge_unrelated(before: float, after: float) -> str:
    return (
        f"of the {1e3 * before:.2f} mm by which passes disagree {1e3 * after:.2f} mm remain with it;"
        " it is that of another place, or displaced"
    )
