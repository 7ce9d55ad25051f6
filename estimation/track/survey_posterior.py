"""The alignment that follows from a survey and the passes of an epoch: the mean of both, by place and band.

It holds all waves of the survey, and what the passes know better. It is published as the survey with what has been
found on it; the next epoch takes it as its survey.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.track.iteration import IterationResult
from estimation.track.panel.stiffness_ratio import error_of_difference
from estimation.track.position_std import position_std
from estimation.track.results import findings
from estimation.track.section_parameters import SectionParameters
from estimation.track.survey_bands import EDGES, SurveyBands, survey_bands, survey_on_grid
from estimation.values.arrays import FloatArray
from estimation.values.track import TrackAlignment

STATED = EDGES[1]  # m, longest wavelength of the published std: longer ones are not in the motion
INDEPENDENT = 5.0  # m along the track, of errors of a survey
MOST_DIFFERENCE_ERROR = 0.08  # of rL - rR, by the stiffness ratio: beyond, it is as assumed


@dataclass(frozen=True, slots=True)
class SurveyPosterior:
    """The alignment, the survey as it was on the same grid, and what both rest on."""

    alignment: TrackAlignment
    before: TrackAlignment
    bands: SurveyBands

    @property
    def in_motion(self) -> FloatArray:
        """The survey (n,), m, with what differs in the waves that the published std is of."""
        changed = np.sum([one.posterior - one.survey for one in self.bands.up_to(STATED)], axis=0)
        return np.asarray(self.before.alignment + changed)

    @property
    def std_factor(self) -> float:
        """Std of the survey that the passes show, over that on file."""
        filed = float(np.median(self.before.alignment_std[self.bands.known]))
        return self.bands.survey_std() / max(filed, 1e-9)


def survey_posterior(
    iterated: IterationResult, survey: TrackAlignment, parameters: SectionParameters
) -> SurveyPosterior | None:
    """Return what a survey and the passes that were placed on it give together; None where they do not meet.

    Args:
        survey: With the std on file.
        parameters: What the scatter of passes does not show of their errors.
    """
    grid, p = iterated.panel.grid, parameters
    of_gauge = p.systematic_per_gauge[0] * float(np.std(survey.gauge_deviation))
    bands = survey_bands(iterated, survey, float(np.hypot(p.systematic, of_gauge)))
    if bands is None:
        return None
    on_grid, filed, known = survey_on_grid(survey, grid)
    nothing = np.where(known, 0.0, np.nan)
    gauge, gauge_std = (
        np.interp(grid.s, survey.s, one) for one in (survey.gauge_deviation, survey.gauge_deviation_std)
    )
    passes = np.interp(grid.s, survey.s, survey.passes.astype(np.float64))
    before = replace(
        survey,
        s=grid.s,
        alignment=on_grid + nothing,
        alignment_std=filed + nothing,
        gauge_deviation=gauge,
        gauge_deviation_std=gauge_std,
        passes=np.rint(passes).astype(np.int64),
    )
    d = bands.long_waves + np.sum([one.posterior for one in bands.bands], axis=0)
    std = np.hypot(bands.posterior_std(STATED), _of_positions(iterated, d))
    ratios_known = error_of_difference(iterated.ratios, iterated.passes) <= MOST_DIFFERENCE_ERROR
    found = replace(
        before,
        version=0,
        alignment=d + nothing,
        alignment_std=std + nothing,
        passes=before.passes + np.rint(bands.passes).astype(np.int64),
        scale_std=_scale_std(bands, iterated, survey, p),
        findings=findings(iterated, gauge_estimated=False).findings if ratios_known else survey.findings,
    )
    return SurveyPosterior(found, before, bands)


def _of_positions(iterated: IterationResult, d: FloatArray) -> FloatArray:
    """Return the std (n,), m, of y - d by the errors of the positions that windows are given."""
    stds = list(position_std(iterated).values())
    known = [one for one in stds if np.isfinite(one)]
    return np.abs(np.gradient(d, iterated.panel.grid.step)) * (float(np.median(known)) if known else 0.0)


def _scale_std(bands: SurveyBands, iterated: IterationResult, survey: TrackAlignment, p: SectionParameters) -> float:
    """Return the relative std of a common scale of y - d: of the curves, as far as the alignment is the passes'.

    The survey, an alignment without their errors, fixes that scale as well as its own errors average out.
    """
    slope_std = 0.0 if iterated.slope is None else iterated.slope.std
    of_passes = float(np.hypot(p.scale_error, slope_std))
    independent = max(np.count_nonzero(bands.compared) * iterated.panel.grid.step / INDEPENDENT, 1.0)
    of_survey = bands.survey_std() / max(bands.curves, 1e-9) / np.sqrt(independent)
    both = of_passes * of_survey / float(np.hypot(of_passes, of_survey))
    weights = np.array([np.mean(one.passes[bands.compared] ** 2) for one in bands.bands])
    share = np.array([np.mean(one.share[bands.compared]) for one in bands.bands])
    of_all = float(weights @ share / weights.sum()) if weights.sum() > 0.0 else 0.0
    return float(np.hypot(of_all * both, (1.0 - of_all) * survey.scale_std))
