"""What an epoch makes of the alignment in force: the next version, or the survey kept.

Where a surveyed gauge varies, the survey is kept with what its gauge does to the wheelsets that have passed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from estimation.track.gauge.wheel_functions import WHEELS
from estimation.track.panel.basis import MeasuredCurve
from estimation.track.panel.solution import prior_on_grid
from estimation.track.parameters import TRACK
from estimation.track.passes import Pass, PassOutcome, PassStatus, ProfileLife
from estimation.track.results import shrunk
from estimation.track.screening.screen import Screened, screen
from estimation.track.section import SectionEstimate, estimate_section
from estimation.track.settings import (
    AlignmentSettings,
    SectionParameters,
    carry_over_findings,
    changed_vehicles,
    gauge_shift_changed,
    requires_reestimation,
)
from estimation.track.survey_check import check_survey, judge_gauge, worth_more
from estimation.track.survey_posterior import SurveyPosterior, survey_posterior
from estimation.track.survey_verdict import (
    MIRRORED,
    SurveyFit,
    SurveyVerdict,
    Witnesses,
    fit_survey,
    is_mirrored,
    place_of,
    survey_verdict,
)
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of, combined, prefixed
from estimation.values.track import AlignmentSource, TrackAlignment, TrackSectionRecord

NOT_USED = "not used: "
GAUGE_NOT_USED = "its gauge is not used: "


class UpdateOutcome(StrEnum):
    """What an epoch makes of the alignment in force."""

    UNESTIMATED = "unestimated"  # the passes identify nothing, and nothing is in force
    KEPT = "kept"  # the passes identify nothing; the fleet's alignment stays
    NEW_VERSION = "new_version"  # of the fleet
    SURVEY_KEPT = "survey_kept"
    SURVEY_REFUSED = "survey_refused"  # it is wrong, and the fleet finds none by itself: none is known
    SURVEY_EXTENDED = "survey_extended"  # kept as a version of its own, with gauge shifts or without a wrong gauge

    @property
    def makes_version(self) -> bool:
        """Whether a version is added."""
        return self in {UpdateOutcome.NEW_VERSION, UpdateOutcome.SURVEY_REFUSED, UpdateOutcome.SURVEY_EXTENDED}

    @property
    def windows_wait(self) -> bool:
        """Whether the windows of the epoch are looked at again together with those that come."""
        return self in {UpdateOutcome.UNESTIMATED, UpdateOutcome.SURVEY_REFUSED}

    @property
    def positions_valid(self) -> bool:
        """Whether measured positions are used unless they are far off: on a survey."""
        return self in {UpdateOutcome.SURVEY_KEPT, UpdateOutcome.SURVEY_EXTENDED}


@dataclass(frozen=True, slots=True)
class AlignmentUpdate:
    """What the passes of an epoch make of a section.

    ``alignment`` is in force from now on, None where there is none; ``pass_outcomes`` are of the passes in their
    order. ``survey`` is what the fleet finds of the survey in force, where it was checked and could be.
    """

    outcome: UpdateOutcome
    estimate: SectionEstimate
    alignment: TrackAlignment | None
    pass_outcomes: tuple[PassOutcome, ...]
    survey: Reason | None = None


def update_alignment(
    section: TrackSectionRecord,
    passes: Sequence[Pass],
    in_force: TrackAlignment | None,
    settings: AlignmentSettings,
    *,
    survey_checked: bool,
    measured: Mapping[ProfileLife, MeasuredCurve] | None = None,
) -> AlignmentUpdate:
    """Return what an epoch makes of an alignment; a confirmed survey (``survey_checked``) is not refused any more."""
    parameters = replace(settings.section, panel=replace(settings.section.panel, length=section.length_m))
    screened = screen(passes, in_force, replace(settings.screening, positions=parameters.positions))
    settings = replace(settings, section=parameters)
    epoch = _Epoch(section.code, screened, settings, measured)
    if in_force is not None and in_force.source == AlignmentSource.RECORDED and np.isfinite(in_force.alignment).any():
        return _with_survey(epoch, in_force, survey_checked=survey_checked)
    return _without_surveyed_alignment(epoch, in_force, survey_checked=survey_checked)


@dataclass(frozen=True, slots=True)
class Weighed:
    """What passes and a survey give: the solution, and the mean of both; None where they do not meet."""

    estimate: SectionEstimate
    posterior: SurveyPosterior | None


@dataclass(frozen=True, slots=True)
class _Epoch:
    section: str
    screened: Screened
    settings: AlignmentSettings  # with the length of the section
    measured: Mapping[ProfileLife, MeasuredCurve] | None

    @property
    def parameters(self) -> SectionParameters:
        return self.settings.section

    @property
    def vehicles(self) -> dict[str, str]:
        return {item.wheelset: item.vehicle for item in self.screened.used}

    def estimate(self, prior: TrackAlignment | None) -> SectionEstimate:
        return estimate_section(self.section, self.screened.used, prior, self.parameters, self.measured)

    def weigh(self, survey: TrackAlignment) -> Weighed:
        """Return what the passes and a survey give, the survey with the std that the passes show of it."""
        weighed = self._weighed(survey, survey)
        factor = 1.0 if weighed.posterior is None else weighed.posterior.std_factor
        if not 1.0 / self.settings.same_survey_std <= factor <= self.settings.same_survey_std:
            again = self._weighed(replace(survey, alignment_std=factor * survey.alignment_std), survey)
            # held less by the survey, the journeys of a wheelset alone may come to rest at another wave of the track
            before, after = weighed.estimate.iterated, again.estimate.iterated
            lost = before is not None and before.placed_on_survey and (after is None or not after.placed_on_survey)
            weighed = weighed if lost else again
        return weighed

    def _weighed(self, prior: TrackAlignment, survey: TrackAlignment) -> Weighed:
        estimate = self.estimate(prior)
        if estimate.iterated is None or not survey.gauge_known:  # a gauge that is not known is an error of all passes
            return Weighed(estimate, None)
        return Weighed(estimate, survey_posterior(estimate.iterated, survey, self.parameters))

    def judge(self, weighed: Weighed, survey: TrackAlignment) -> SurveyVerdict | None:
        """Return what the passes say of the survey that they were placed on; None where they were not."""
        judged = self._judged(weighed, survey)
        if judged is None or not judged[0].elsewhere:
            return None if judged is None else judged[0]
        image = replace(survey, alignment=-survey.alignment)
        other = self._judged(self.weigh(image), image)
        exchanged = other is not None and is_mirrored(*judged, *other)
        return SurveyVerdict(refused=True, reason=MIRRORED) if exchanged else judged[0]

    def _judged(self, weighed: Weighed, survey: TrackAlignment) -> tuple[SurveyVerdict, SurveyFit | None] | None:
        iterated = weighed.estimate.iterated
        if iterated is None:
            return None
        cutoff = self.parameters.panel.cutoff_wavelength
        fit = fit_survey(iterated, prior_on_grid(survey, iterated.panel.grid, cutoff))
        if fit is not None and weighed.posterior is not None:
            fit = replace(fit, coherent=weighed.posterior.bands.coherent_std(cutoff))
        slope_std = 0.0 if iterated.slope is None else iterated.slope.std
        witnesses = Witnesses(iterated.corrections, slope_std)
        filed = float(np.nanmedian(survey.alignment_std))
        return survey_verdict(fit, witnesses, filed, converged=weighed.estimate.report.converged), fit

    def judge_gauge(self, estimate: SectionEstimate, survey: TrackAlignment) -> Reason | None:
        """Return what is wrong with a surveyed gauge; None where nothing is, or nothing has been decided yet."""
        converged, section = estimate.report.converged, self.settings.section
        reason = judge_gauge(estimate.iterated, survey, converged=converged, parameters=section)
        return None if reason is None else prefixed(GAUGE_NOT_USED, reason)

    def update(
        self,
        outcome: UpdateOutcome,
        estimate: SectionEstimate,
        alignment: TrackAlignment | None,
        survey: Reason | None = None,
    ) -> AlignmentUpdate:
        return AlignmentUpdate(outcome, estimate, alignment, self.screened.outcomes, survey)


def _without_surveyed_alignment(
    epoch: _Epoch, in_force: TrackAlignment | None, *, survey_checked: bool
) -> AlignmentUpdate:
    surveyed = in_force is not None and in_force.source == AlignmentSource.RECORDED
    cutoff = epoch.parameters.cutoff_wavelength
    comparable = in_force is not None and (surveyed or in_force.cutoff_wavelength == cutoff)
    usable = comparable and not (surveyed and survey_checked)  # of a gauge alone nothing is said unless it is refused
    of_bogies = in_force if usable and in_force is not None and _by_bogies(in_force) else None
    # that of stiff bogies gives way to passes that show an alignment without it, as those of soft bogies do
    estimate = epoch.estimate(in_force if usable and of_bogies is None else None)
    if of_bogies is not None and not _found(estimate):
        return epoch.update(UpdateOutcome.KEPT, epoch.estimate(of_bogies), of_bogies)
    gauge = epoch.judge_gauge(estimate, in_force) if in_force is not None and surveyed and usable else None
    if gauge is not None:
        estimate = epoch.estimate(None)
    if estimate.alignment is None or not _found(estimate):
        if in_force is None or surveyed or not np.isfinite(in_force.alignment).any():  # at most the gauge is known
            return epoch.update(UpdateOutcome.UNESTIMATED, estimate, None, gauge)
        return epoch.update(UpdateOutcome.KEPT, estimate, in_force)
    return epoch.update(UpdateOutcome.NEW_VERSION, estimate, carry_over_findings(estimate.alignment, in_force), gauge)


def _found(estimate: SectionEstimate) -> bool:
    return estimate.alignment is not None and estimate.report.converged


def _by_bogies(in_force: TrackAlignment) -> bool:
    """Return whether an alignment is that of stiff bogies: one of passes has findings on their wheelsets."""
    of_fleet = in_force.source == AlignmentSource.FLEET and in_force.findings is None
    return of_fleet and bool(np.isfinite(in_force.alignment).any())


def _with_survey(epoch: _Epoch, survey: TrackAlignment, *, survey_checked: bool) -> AlignmentUpdate:
    weighed = epoch.weigh(survey)
    verdict = epoch.judge(weighed, survey)
    if verdict is None:
        return _extended(epoch, weighed, survey, None, SurveyVerdict(refused=False, reason=None))
    if verdict.refused and not survey_checked:
        return _refused(epoch, weighed, survey, verdict)
    if verdict.contradicted:
        outcomes = tuple(
            replace(outcome, status=PassStatus.REFUSED, reason=verdict.reason) for outcome in epoch.screened.outcomes
        )
        report = replace(weighed.estimate.report, status=Status.UNESTIMATED, reason=verdict.reason)
        nowhere = replace(weighed.estimate, report=report, grouped={}, corrections={})
        return AlignmentUpdate(UpdateOutcome.SURVEY_KEPT, nowhere, survey, outcomes, verdict.reason)
    reason = None if survey_checked else verdict.reason
    gauge = epoch.judge_gauge(weighed.estimate, survey)
    if gauge is not None and _confirmed(verdict):
        of_alignment = None if reason is None else prefixed("its alignment: ", reason)
        return _without_gauge(epoch, survey, combined([gauge, of_alignment]))
    return _extended(epoch, weighed, survey, reason, verdict, decided=survey_checked or _confirmed(verdict))


def _extended(
    epoch: _Epoch,
    weighed: Weighed,
    survey: TrackAlignment,
    reason: Reason | None,
    verdict: SurveyVerdict,
    *,
    decided: bool = False,
) -> AlignmentUpdate:
    """Return the survey kept; as a version of its own where the passes know it better, or what its gauge does."""
    # until it is decided on, it is kept as it is, but for a scale that is in doubt: then that of both is
    kept = epoch.update(UpdateOutcome.SURVEY_KEPT, _placed_on_survey(weighed.estimate), survey, survey=reason)
    posterior, doubted, settings = weighed.posterior, verdict.doubted_scale, epoch.settings
    if (decided or doubted > 0.0) and posterior is not None and weighed.estimate.report.converged:
        after = carry_over_findings(posterior.alignment, posterior.before)  # on one grid
        after = replace(after, scale_std=float(np.hypot(after.scale_std, doubted)))
        in_motion = replace(after, alignment=posterior.in_motion)
        std, std_now = (float(np.nanmedian(track.alignment_std)) for track in (posterior.before, after))
        first = not posterior.before.passes.any()
        if (
            (first and std > settings.same_least and std_now < TRACK.sharper_std_share * std)
            or requires_reestimation(posterior.before, in_motion, settings)
            or posterior.before.scale_std < settings.same_std * doubted
        ):
            return replace(kept, outcome=UpdateOutcome.SURVEY_EXTENDED, alignment=after)
    return _with_gauge_shifts(kept, survey, epoch.vehicles, settings)


def _placed_on_survey(estimate: SectionEstimate) -> SectionEstimate:
    if estimate.iterated is None or not estimate.corrections:
        return estimate
    return replace(estimate, corrections=shrunk(estimate.iterated))


def _without_gauge(epoch: _Epoch, survey: TrackAlignment, reason: Reason | None) -> AlignmentUpdate:
    """Return the survey without its gauge, which is wrong: as one of the alignment alone."""
    # what the passes disagree by says how much the true gauge varies; nothing that was found on the wrong one stays
    of_gauge = np.full(len(survey.s), float(np.std(survey.gauge_deviation)))
    alone = replace(
        survey,
        gauge_deviation=np.zeros(len(survey.s)),
        gauge_deviation_std=of_gauge,
        gauge_known=False,
        scale_std=float(np.hypot(survey.scale_std, epoch.parameters.scale_error)),
        findings=None,
    )
    estimate = epoch.estimate(alone)
    if estimate.alignment is not None:
        left_open = np.median(estimate.alignment.gauge_deviation_std)
        alone = replace(alone, gauge_deviation_std=np.full_like(of_gauge, left_open))
    return epoch.update(UpdateOutcome.SURVEY_EXTENDED, _placed_on_survey(estimate), alone, survey=reason)


def _confirmed(verdict: SurveyVerdict) -> bool:
    return code_of(verdict.reason) is ReasonCode.SURVEY_CONFIRMED


def _refused(epoch: _Epoch, weighed: Weighed, survey: TrackAlignment, verdict: SurveyVerdict) -> AlignmentUpdate:
    """Return the fleet's own alignment in place of a survey that is wrong; where it finds none, none is known."""
    # a survey whose zero point alone is wrong is then kept: all journeys are placed on it alike
    without = epoch.estimate(None)
    reason = _mistake(epoch, survey, without) or verdict.reason
    assert reason is not None
    refusal = prefixed(NOT_USED, reason)
    if without.alignment is not None and without.report.converged and worth_more(without.alignment, survey):
        return epoch.update(UpdateOutcome.NEW_VERSION, without, without.alignment, survey=refusal)
    if verdict.harmless and verdict.reason is not None:
        kept = prefixed("kept, with all positions on it, for the fleet finds none: ", verdict.reason)
        return _extended(epoch, weighed, survey, kept, verdict)
    nothing = np.full(len(survey.s), np.nan)
    unknown = replace(
        survey, alignment=nothing, alignment_std=nothing, source=AlignmentSource.FLEET, status=Status.UNESTIMATED
    )
    return epoch.update(UpdateOutcome.SURVEY_REFUSED, without, unknown, survey=refusal)


def _mistake(epoch: _Epoch, survey: TrackAlignment, without: SectionEstimate) -> Reason | None:
    """Return which mistake a wrong survey holds, by what the fleet finds without it; None where that shows none."""
    if without.iterated is None:
        return None
    solution, grid = without.iterated.solution, without.iterated.panel.grid
    zero = np.zeros(grid.points)
    fleet = TrackAlignment(  # good enough to be compared with even where it is too uncertain to be used
        section=epoch.section,
        version=0,
        s=grid.s,
        alignment=solution.alignment,
        alignment_std=solution.alignment_std,
        gauge_deviation=zero,
        gauge_deviation_std=zero,
        passes=zero.astype(np.int64),
        status=Status.ESTIMATED,
        source=AlignmentSource.FLEET,
        cutoff_wavelength=epoch.parameters.panel.cutoff_wavelength,
    )
    check = check_survey(survey, fleet, place_std=place_of(without.corrections)[1])
    return None if check.usable else check.reason


def _with_gauge_shifts(
    kept: AlignmentUpdate, survey: TrackAlignment, vehicles: Mapping[str, str], settings: AlignmentSettings
) -> AlignmentUpdate:
    of_epoch = kept.estimate.alignment
    varies = survey.gauge_known and float(np.std(survey.gauge_deviation)) >= WHEELS.least_gauge_std
    if not varies or not kept.estimate.report.converged:
        return kept
    if of_epoch is None or of_epoch.findings is None or not of_epoch.findings.gauge_shifts:
        return kept
    extended = carry_over_findings(replace(survey, findings=of_epoch.findings), survey)
    new = (
        requires_reestimation(survey, extended, settings)
        or changed_vehicles(survey, extended, settings, vehicles)
        or gauge_shift_changed(survey, extended, settings)
        or of_epoch.findings.gauge_shifts.keys() - (survey.findings.gauge_shifts.keys() if survey.findings else set())
    )
    if not new:
        return kept
    return replace(kept, outcome=UpdateOutcome.SURVEY_EXTENDED, alignment=extended)
