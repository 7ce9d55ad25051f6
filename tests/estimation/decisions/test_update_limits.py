"""What an epoch makes of the alignment in force, by what its passes give with and without it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from test_survey_limits import D, N, track
from test_version_limits import shift_of

from estimation.track.parameters import TRACK
from estimation.track.results import unestimated_report
from estimation.track.screening.screen import Screened
from estimation.track.section import SectionEstimate
from estimation.track.settings import AlignmentSettings
from estimation.track.survey_check import worth_more
from estimation.track.survey_posterior import Band, SurveyBands, SurveyPosterior
from estimation.track.survey_verdict import CONFIRMED, SurveyVerdict
from estimation.track.update import (
    AlignmentUpdate,
    UpdateOutcome,
    Weighed,
    _Epoch,
    _with_gauge_shifts,
    _with_survey,
    _without_surveyed_alignment,
    update_alignment,
)
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.track import AlignmentSource, Correction, TrackAlignment, TrackFindings, TrackSectionRecord

SETTINGS = AlignmentSettings()
SURVEY = track(D, source=AlignmentSource.RECORDED)
FLEET = track(D, source=AlignmentSource.FLEET)
CERTAIN = replace(FLEET, alignment_std=np.full(N, 1e-5))  # a tenth of the survey's
NO_SHIFT = TrackFindings({}, 0.0, {})
SHIFT = TrackFindings({}, 0.0, {"W": shift_of(0.3)})


CONVERGED = replace(unestimated_report(Reason(ReasonCode.NO_PASS, "no pass")), converged=True)
RIGHT = SurveyVerdict(refused=False, reason=Reason(ReasonCode.SURVEY_CONFIRMED, CONFIRMED))
WRONG = SurveyVerdict(refused=True, reason=Reason(ReasonCode.SURVEY_UNRELATED, "it differs"))
OPEN = SurveyVerdict(refused=False, reason=None)


def solved(alignment: TrackAlignment | None, offsets: tuple[float, ...] = ()) -> SectionEstimate:
    corrections = {("V", k): Correction(metres) for k, metres in enumerate(offsets)}
    return SectionEstimate(alignment, CONVERGED, {}, corrections)


@dataclass(frozen=True, slots=True)
class Solved(_Epoch):
    """An epoch whose passes give one alignment by themselves and another with what was known."""

    alone: SectionEstimate
    with_prior: SectionEstimate
    verdict: SurveyVerdict | None
    posterior: SurveyPosterior | None = None

    def estimate(self, prior: TrackAlignment | None) -> SectionEstimate:
        return self.alone if prior is None else self.with_prior

    def weigh(self, survey: TrackAlignment) -> Weighed:
        assert survey.source == AlignmentSource.RECORDED
        return Weighed(self.with_prior, self.posterior)

    def judge(self, weighed: Weighed, survey: TrackAlignment) -> SurveyVerdict | None:
        assert (weighed.estimate, survey.source) == (self.with_prior, AlignmentSource.RECORDED)
        return self.verdict


def epoch(
    alone: TrackAlignment | None, with_prior: TrackAlignment | None, verdict: SurveyVerdict | None = None
) -> Solved:
    nobody = Screened((), ())
    return Solved("S", nobody, SETTINGS, None, solved(alone), solved(with_prior), verdict)


def by_survey(
    alone: TrackAlignment | None, with_survey: TrackAlignment | None, verdict: SurveyVerdict | None = None, *,
    checked: bool = False, survey: TrackAlignment = SURVEY,
) -> AlignmentUpdate:  # fmt: skip
    return _with_survey(epoch(alone, with_survey, verdict), survey, survey_checked=checked)


def weighed(std: float, verdict: SurveyVerdict | None = None, **changes: object) -> Solved:
    """Return an epoch whose passes and survey give an alignment of this std (m) together."""
    together = replace(SURVEY, alignment_std=np.full(N, std), **changes)  # type: ignore[arg-type]
    same = Band(np.zeros(N), np.zeros(N), np.ones(N), np.ones(N), 0.0)
    bands = SurveyBands(
        (same,) * len(TRACK.band_edges), D, np.ones(N, np.bool_), np.ones(N, np.bool_), np.ones(N), 1e-3
    )
    return replace(epoch(None, None, verdict), posterior=SurveyPosterior(together, SURVEY, bands))


def test_a_survey_that_the_passes_know_better_becomes_a_version_of_it() -> None:
    for std, outcome in ((0.51e-4, UpdateOutcome.SURVEY_KEPT), (0.49e-4, UpdateOutcome.SURVEY_EXTENDED)):
        found = _with_survey(weighed(std, RIGHT), SURVEY, survey_checked=False)
        assert (found.outcome, code_of(found.survey)) == (outcome, ReasonCode.SURVEY_CONFIRMED)
        again = _with_survey(weighed(std, RIGHT), SURVEY, survey_checked=True)
        assert (again.outcome, again.survey) == (outcome, None)
        assert found.alignment is not None
        assert found.alignment.source == AlignmentSource.RECORDED
    moving = weighed(1e-5, RIGHT)
    moving = replace(moving, with_prior=replace(moving.with_prior, report=replace(CONVERGED, converged=False)))
    assert _with_survey(moving, SURVEY, survey_checked=True).outcome is UpdateOutcome.SURVEY_KEPT


def test_a_file_is_made_sharper_by_its_first_passes_where_that_matters() -> None:
    unseen = np.zeros(N, dtype=np.int64)
    for filed, std, outcome in (
        (1e-4, 0.81e-4, UpdateOutcome.SURVEY_KEPT),
        (1e-4, 0.79e-4, UpdateOutcome.SURVEY_EXTENDED),
        (0.49e-4, 0.3e-4, UpdateOutcome.SURVEY_KEPT),  # too sharp already for that to matter
    ):
        file = replace(SURVEY, alignment_std=np.full(N, filed), passes=unseen)
        made = weighed(std, RIGHT)
        assert made.posterior is not None
        made = replace(made, posterior=replace(made.posterior, before=file))
        assert _with_survey(made, file, survey_checked=False).outcome is outcome


def test_a_survey_that_is_not_decided_on_is_kept_as_it_is() -> None:
    for undecided in (OPEN, None):
        found = _with_survey(weighed(1e-5, undecided), SURVEY, survey_checked=False)
        assert (found.outcome, found.alignment, found.survey) == (UpdateOutcome.SURVEY_KEPT, SURVEY, None)


def test_a_scale_that_is_in_doubt_widens_what_rests_on_the_survey() -> None:
    doubted = SurveyVerdict(refused=False, reason=None, doubted_scale=0.1)
    found = _with_survey(weighed(1e-5, doubted, scale_std=0.01), SURVEY, survey_checked=False)
    assert found.outcome is UpdateOutcome.SURVEY_EXTENDED
    assert found.alignment is not None
    assert found.alignment.scale_std == pytest.approx(np.hypot(0.1, 0.01))
    for scale_std, outcome in ((0.049, UpdateOutcome.SURVEY_EXTENDED), (0.051, UpdateOutcome.SURVEY_KEPT)):
        as_certain = weighed(1e-4, doubted)  # nothing but the doubt is new
        assert as_certain.posterior is not None
        file = replace(SURVEY, scale_std=scale_std)
        as_certain = replace(as_certain, posterior=replace(as_certain.posterior, before=file))
        assert _with_survey(as_certain, file, survey_checked=False).outcome is outcome


def test_a_survey_whose_zero_point_alone_is_wrong_is_kept_where_the_fleet_has_none() -> None:
    displaced = replace(WRONG, harmless=True)
    kept = by_survey(None, None, displaced)
    assert (kept.outcome, kept.alignment) == (UpdateOutcome.SURVEY_KEPT, SURVEY)
    assert str(kept.survey).startswith("kept, with all positions on it")
    assert by_survey(OFF, None, displaced).outcome is UpdateOutcome.NEW_VERSION


@pytest.mark.parametrize("checked", [False, True])
def test_passes_that_contradict_their_model_are_not_used_even_on_a_confirmed_survey(*, checked: bool) -> None:
    reason = Reason(ReasonCode.MODEL_CONTRADICTED, "they do not follow")
    found = by_survey(FLEET, CERTAIN, SurveyVerdict(refused=False, reason=reason, contradicted=True), checked=checked)
    assert (found.outcome, found.alignment, found.survey) == (UpdateOutcome.SURVEY_KEPT, SURVEY, reason)
    assert (found.estimate.report.status, found.estimate.report.reason) == (Status.UNESTIMATED, reason)
    assert not found.estimate.grouped  # no window gets a position from such passes


OFF = track(1.5 * D, std=0.29e-3, source=AlignmentSource.FLEET)  # a survey of D is wrong by 1 mm


def test_a_survey_that_is_wrong_is_replaced_by_what_the_fleet_finds() -> None:
    found = by_survey(OFF, CERTAIN, WRONG)
    assert (found.outcome, found.alignment) == (UpdateOutcome.NEW_VERSION, OFF)
    assert (code_of(found.survey), str(found.survey)) == (ReasonCode.SURVEY_UNRELATED, "not used: it differs")
    assert by_survey(OFF, None, WRONG, checked=True).outcome is UpdateOutcome.SURVEY_KEPT


def test_what_replaces_a_survey_is_certain_and_better_than_half_of_what_is_wrong_with_it() -> None:
    assert worth_more(OFF, SURVEY)
    assert not worth_more(replace(OFF, alignment_std=np.full(N, 0.31e-3)), SURVEY)
    wrong = float(np.sqrt(np.mean((0.02 * D) ** 2)))
    near = track(1.02 * D, std=0.49 * wrong, source=AlignmentSource.FLEET)
    assert worth_more(near, SURVEY)
    assert not worth_more(replace(near, alignment_std=np.full(N, 0.51 * wrong)), SURVEY)
    open_ = replace(OFF, alignment_std=np.full(N, 0.31e-3))
    assert by_survey(open_, None, WRONG).outcome is UpdateOutcome.SURVEY_REFUSED


def test_where_a_survey_is_wrong_and_the_fleet_finds_nothing_nothing_is_known() -> None:
    found = by_survey(None, CERTAIN, WRONG)
    assert (found.outcome, code_of(found.survey)) == (UpdateOutcome.SURVEY_REFUSED, ReasonCode.SURVEY_UNRELATED)
    assert found.alignment is not None
    assert np.isnan(found.alignment.alignment).all()
    assert found.alignment.source is AlignmentSource.FLEET
    later = _without_surveyed_alignment(epoch(None, None), found.alignment, survey_checked=False)
    assert (later.outcome, later.alignment) == (UpdateOutcome.UNESTIMATED, None)  # the windows wait for more


def test_without_a_survey_an_alignment_is_the_next_version_or_the_last_one_stays() -> None:
    last = replace(FLEET, findings=SHIFT)
    for alignment, in_force, outcome, expected in (
        (None, None, UpdateOutcome.UNESTIMATED, None),
        (None, last, UpdateOutcome.KEPT, last),
        (None, SURVEY, UpdateOutcome.UNESTIMATED, None),
        (CERTAIN, None, UpdateOutcome.NEW_VERSION, CERTAIN),
        (CERTAIN, last, UpdateOutcome.NEW_VERSION, CERTAIN),
        (CERTAIN, SURVEY, UpdateOutcome.NEW_VERSION, CERTAIN),
    ):
        found = _without_surveyed_alignment(epoch(alignment, alignment), in_force, survey_checked=False)
        assert (found.outcome, found.alignment, found.survey) == (outcome, expected, None)
    moving = epoch(CERTAIN, CERTAIN)
    report = replace(CONVERGED, converged=False)
    moving = replace(moving, with_prior=replace(moving.with_prior, report=report))
    assert _without_surveyed_alignment(moving, last, survey_checked=False).outcome is UpdateOutcome.KEPT
    gauge = 1e-3 * np.sin(np.arange(N))
    varied = replace(CERTAIN, gauge_deviation=gauge, findings=TrackFindings({}, 0.0, {"X": shift_of(0.1)}))
    carried = _without_surveyed_alignment(
        epoch(None, varied), replace(last, gauge_deviation=gauge), survey_checked=False
    ).alignment
    assert carried is not None
    assert carried.findings is not None
    assert set(carried.findings.gauge_shifts) == {"W", "X"}


def test_a_version_of_another_cutoff_is_no_prior_and_a_survey_always_is() -> None:
    alone, with_prior = CERTAIN, replace(CERTAIN, alignment_std=np.full(N, 2e-5))
    last = replace(FLEET, findings=NO_SHIFT)
    for in_force, expected in (
        (None, alone),
        (last, with_prior),
        (replace(last, cutoff_wavelength=60.0), alone),
        (replace(SURVEY, cutoff_wavelength=60.0), with_prior),
    ):
        assert (
            _without_surveyed_alignment(epoch(alone, with_prior), in_force, survey_checked=False).alignment is expected
        )


GAUGE = np.where(np.arange(N) % 2, 1.0, -1.0)  # std 1


def extended(found: TrackAlignment | None, **survey: object) -> AlignmentUpdate:
    old = replace(SURVEY, gauge_deviation=1e-3 * GAUGE, **survey)  # type: ignore[arg-type]
    kept = AlignmentUpdate(UpdateOutcome.SURVEY_KEPT, solved(found), old, ())
    return _with_gauge_shifts(kept, old, {"W": "V"}, SETTINGS)


def test_a_survey_is_extended_by_what_its_gauge_does_to_a_wheelset() -> None:
    new = extended(replace(FLEET, findings=SHIFT))
    assert new.outcome is UpdateOutcome.SURVEY_EXTENDED
    assert new.alignment is not None
    assert (new.alignment.source, new.alignment.findings) == (AlignmentSource.RECORDED, SHIFT)
    np.testing.assert_array_equal(new.alignment.alignment, D)
    varied = replace(SURVEY, gauge_deviation=1e-3 * GAUGE)
    found_with = replace(FLEET, findings=SHIFT)
    assert by_survey(None, found_with, checked=True, survey=varied).outcome is UpdateOutcome.SURVEY_EXTENDED
    for found in (None, FLEET, replace(FLEET, findings=NO_SHIFT)):
        assert extended(found).outcome is UpdateOutcome.SURVEY_KEPT
    assert extended(replace(FLEET, findings=SHIFT), gauge_known=False).outcome is UpdateOutcome.SURVEY_KEPT


@pytest.mark.parametrize(
    ("gauge", "outcome"), [(0.29e-3, UpdateOutcome.SURVEY_KEPT), (0.31e-3, UpdateOutcome.SURVEY_EXTENDED)]
)
def test_a_gauge_varies_from_three_tenths_of_a_millimetre(gauge: float, outcome: UpdateOutcome) -> None:
    old = replace(SURVEY, gauge_deviation=gauge * GAUGE)
    kept = AlignmentUpdate(UpdateOutcome.SURVEY_KEPT, solved(replace(FLEET, findings=SHIFT)), old, ())
    assert _with_gauge_shifts(kept, old, {"W": "V"}, SETTINGS).outcome is outcome


def test_a_survey_is_extended_again_only_by_another_shift() -> None:
    for size, outcome in ((0.3, UpdateOutcome.SURVEY_KEPT), (0.5, UpdateOutcome.SURVEY_EXTENDED)):
        found = replace(FLEET, findings=TrackFindings({}, 0.0, {"W": shift_of(size)}))
        assert extended(found, findings=SHIFT).outcome is outcome


def test_without_passes_what_is_in_force_stays() -> None:
    section = TrackSectionRecord("S", 1, "S", "60E1", 0.025, 1.435, float(N))
    gauge_alone = replace(SURVEY, alignment=np.full(N, np.nan), alignment_std=np.full(N, np.nan))
    for in_force, outcome, expected in (
        (None, UpdateOutcome.UNESTIMATED, None),
        (FLEET, UpdateOutcome.KEPT, FLEET),
        (SURVEY, UpdateOutcome.SURVEY_KEPT, SURVEY),
        (gauge_alone, UpdateOutcome.UNESTIMATED, None),
    ):
        found = update_alignment(section, [], in_force, SETTINGS, survey_checked=False)
        assert (found.outcome, found.alignment, found.pass_outcomes) == (outcome, expected, ())


@pytest.mark.parametrize(
    ("alone", "findings", "outcome", "expected"),
    [
        (None, None, UpdateOutcome.KEPT, "in force"),  # coaches again: their passes show nothing without it
        (CERTAIN, None, UpdateOutcome.NEW_VERSION, "alone"),  # soft bogies have passed
        (None, NO_SHIFT, UpdateOutcome.NEW_VERSION, "with prior"),
    ],
)
def test_the_alignment_of_stiff_bogies_gives_way_to_passes_that_show_one_without_it(
    alone: TrackAlignment | None, findings: TrackFindings | None, outcome: UpdateOutcome, expected: str
) -> None:
    in_force = replace(FLEET, findings=findings, cutoff_wavelength=SETTINGS.section.cutoff_wavelength)
    with_prior = replace(CERTAIN, alignment_std=np.full(N, 2e-5))
    made = _without_surveyed_alignment(epoch(alone, with_prior), in_force, survey_checked=False)
    assert made.outcome is outcome
    assert made.alignment is {"in force": in_force, "alone": alone, "with prior": with_prior}[expected]
