"""What the passes say of a surveyed gauge: when it is right, of another place, of another scale, or not judged."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gauge_passes import LENGTH, Section, passes, section
from test_survey_limits import D, N, track
from test_update_limits import CERTAIN, FLEET, OFF, RIGHT, SHIFT, WRONG, Solved, epoch

from estimation.track import survey_check
from estimation.track.gauge.wheel_functions import contact_samples, gauge_factor_with_std
from estimation.track.iteration import IterationResult
from estimation.track.panel.basis import PanelParameters
from estimation.track.passes import ProfileLife
from estimation.track.section import SectionEstimate
from estimation.track.settings import AlignmentSettings, SectionParameters
from estimation.track.survey_check import GaugeLimits, judge_gauge
from estimation.track.survey_verdict import SurveyVerdict
from estimation.track.update import (
    AlignmentUpdate,
    UpdateOutcome,
    _with_survey,
    _without_surveyed_alignment,
    update_alignment,
)
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.track import AlignmentSource, TrackAlignment, TrackSectionRecord

SECTION = TrackSectionRecord("S", 1, "Section", "56E1", 0.05, 1.435, LENGTH)
SMALL = AlignmentSettings(section=SectionParameters(panel=PanelParameters(basis_count=21)))
CONES = {ProfileLife("A", 0, 0): 0.16, ProfileLife("B", 0, 0): 0.08, ProfileLife("C", 0, 0): 0.12}
GAUGE = 2e-3  # m, std


@cache
def place() -> Section:
    return section(GAUGE)


def survey(gauge: FloatArray) -> TrackAlignment:
    zero = np.zeros(len(place().s))
    return TrackAlignment(
        "S", 1, place().s, place().alignment, zero + 0.05e-3, gauge, zero + 0.1e-3, zero.astype(np.int64),
        Status.ESTIMATED,
    )  # fmt: skip


@cache
def updated(factor: float, *, turned: bool = False) -> AlignmentUpdate:
    """Return what the passes make of a survey whose gauge is scaled, or of another place."""
    gauge = factor * (place().gauge[::-1] if turned else place().gauge)
    return update_alignment(SECTION, passes(place(), CONES, 3, seed=5), survey(gauge), SMALL, survey_checked=False)


@cache
def right() -> IterationResult:
    iterated = updated(1.0).estimate.iterated
    assert iterated is not None
    return iterated


def judged(limits: GaugeLimits | None = None, gauge: FloatArray | None = None, **changes: object) -> ReasonCode | None:
    """Return the code for the right gauge, with something of the rounds changed."""
    iterated = replace(right(), **changes)  # type: ignore[arg-type]
    on_file = survey(place().gauge if gauge is None else gauge)
    with pytest.MonkeyPatch.context() as patch:
        if limits is not None:
            patch.setattr(survey_check, "GaugeLimits", lambda: limits)
        return code_of(judge_gauge(iterated, on_file, converged=True, parameters=SectionParameters()))


def test_a_right_gauge_is_used() -> None:
    found = updated(1.0)
    assert (found.outcome, code_of(found.survey)) == (UpdateOutcome.SURVEY_EXTENDED, ReasonCode.SURVEY_CONFIRMED)
    assert found.alignment is not None
    assert found.alignment.gauge_known
    assert found.alignment.findings is not None
    assert set(found.alignment.findings.gauge_shifts) == {"A", "B", "C"}


@pytest.mark.parametrize(
    ("factor", "code", "words"),
    [
        (-1.0, ReasonCode.SURVEY_GAUGE_UNRELATED, "of another place"),
        (1.5, ReasonCode.SURVEY_GAUGE_UNIT, "times what the wheelsets show"),
    ],
)
def test_of_a_wrong_gauge_nothing_stays_but_what_passes_disagree_by(
    factor: float, code: ReasonCode, words: str
) -> None:
    found = updated(abs(factor), turned=factor < 0.0)
    assert (found.outcome, code_of(found.survey)) == (UpdateOutcome.SURVEY_EXTENDED, code)
    assert str(found.survey).startswith("its gauge is not used: ")
    assert words in str(found.survey)
    assert str(found.survey).endswith("its alignment: agrees with what the fleet has measured")
    kept = found.alignment
    assert kept is not None
    assert (kept.source, kept.gauge_known, kept.findings) == (AlignmentSource.RECORDED, False, None)
    np.testing.assert_array_equal(kept.alignment, place().alignment)
    assert not kept.gauge_deviation.any()
    assert 0.5 * GAUGE < np.median(kept.gauge_deviation_std) < 2.0 * GAUGE
    assert kept.scale_std == pytest.approx(SMALL.section.scale_error)


def test_shifts_on_a_gauge_that_is_refused_later_do_not_stay() -> None:
    extended = updated(1.0).alignment
    assert extended is not None
    wrong = replace(extended, version=2, gauge_deviation=extended.gauge_deviation[::-1])
    found = update_alignment(SECTION, passes(place(), CONES, 3, seed=7), wrong, SMALL, survey_checked=True)
    assert code_of(found.survey) is ReasonCode.SURVEY_GAUGE_UNRELATED
    assert found.alignment is not None
    assert (found.alignment.gauge_known, found.alignment.findings) == (False, None)
    again = update_alignment(SECTION, passes(place(), CONES, 3, seed=8), found.alignment, SMALL, survey_checked=True)
    assert (again.outcome, again.alignment) == (UpdateOutcome.SURVEY_KEPT, found.alignment)


@pytest.mark.parametrize(("noise", "code"), [(0.101e-3, ReasonCode.SURVEY_GAUGE_UNRELATED), (0.099e-3, None)])
def test_a_gauge_shows_where_passes_disagree_by_a_tenth_of_a_millimetre(noise: float, code: ReasonCode | None) -> None:
    assert judged(first_noise=noise, noise=noise) is code
    moved = GaugeLimits(visible=0.125e-3 if code else 0.075e-3)
    assert judged(moved, first_noise=noise, noise=noise) is not code


@pytest.mark.parametrize(("share", "code"), [(0.26, None), (0.24, ReasonCode.SURVEY_GAUGE_UNRELATED)])
@pytest.mark.parametrize("size", [0.5e-3, 2.0e-3])
def test_a_quarter_of_what_a_gauge_of_its_size_makes_must_be_explained(
    size: float, share: float, code: ReasonCode | None
) -> None:
    gauge = size / GAUGE * place().gauge
    before = 0.1e-3  # m, of which a gauge of 1 mm makes all
    after = before * np.sqrt(1.0 - share * min(size / 1e-3, 1.0) ** 2)
    assert judged(gauge=gauge, first_noise=before, noise=after) is code
    moved = GaugeLimits(least_explained=0.25 * (1.25 if code is None else 0.75))
    assert judged(moved, gauge, first_noise=before, noise=after) is not code


@pytest.mark.parametrize(("noise", "code"), [(0.31e-3, ReasonCode.SURVEY_GAUGE_UNRELATED), (0.33e-3, None)])
def test_a_gauge_whose_effect_is_lost_in_what_else_passes_disagree_by_is_not_judged(
    noise: float, code: ReasonCode | None
) -> None:
    gauge = 1e-3 / GAUGE * place().gauge
    assert judged(gauge=gauge, first_noise=noise, noise=noise) is code
    moved = GaugeLimits(least_expected=0.1 * (1.25 if code else 0.75))
    assert judged(moved, gauge, first_noise=noise, noise=noise) is not code


@pytest.mark.parametrize("factor", [1.31, 1 / 1.31])
def test_a_scale_is_refused_from_1_3_and_three_stds_on(factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    right()  # kept for other tests as well: not to be made with a scale that is set below
    for beyond, std, code in (
        (1.0, 0.0, ReasonCode.SURVEY_GAUGE_UNIT),
        (1 / 1.02, 0.0, None),
        (1.0, 0.01, None),
        (np.exp(0.3), 0.09, ReasonCode.SURVEY_GAUGE_UNIT),
        (np.exp(0.3), 0.11, None),
        (1.5, np.nan, None),
    ):
        found = (factor * beyond if factor > 1.0 else factor / beyond, std)
        monkeypatch.setattr("estimation.track.survey_check.gauge_factor_with_std", lambda _, found=found: found)
        assert judged() is code


def test_the_scale_of_a_gauge_has_a_std_from_two_wheelsets_on() -> None:
    samples = contact_samples(right().passes, right().solution, right().panel)
    factor, std = gauge_factor_with_std(samples)
    assert abs(np.log(factor)) < 3.0 * std
    assert 0.005 < std < 0.1
    assert np.isnan(gauge_factor_with_std(dict(list(samples.items())[:1]))[1])


def test_what_cannot_be_seen_is_not_refused() -> None:
    wrong = {"first_noise": 0.2e-3, "noise": 0.2e-3}
    assert judged(**wrong) is ReasonCode.SURVEY_GAUGE_UNRELATED
    unmoved = replace(right(), **wrong)  # type: ignore[arg-type]
    on_file = survey(place().gauge)
    assert judge_gauge(None, on_file, converged=True, parameters=SectionParameters()) is None
    assert judge_gauge(unmoved, on_file, converged=False, parameters=SectionParameters()) is None
    assert (
        judge_gauge(unmoved, replace(on_file, gauge_known=False), converged=True, parameters=SectionParameters())
        is None
    )
    assert (
        judge_gauge(unmoved, survey(np.full(len(place().s), 1e-3)), converged=True, parameters=SectionParameters())
        is None
    )
    assert (
        judge_gauge(unmoved, survey(0.29 / 2.0 * place().gauge), converged=True, parameters=SectionParameters()) is None
    )
    without = replace(unmoved.panel, gauge=None)
    assert judge_gauge(replace(unmoved, panel=without), on_file, converged=True, parameters=SectionParameters()) is None


BAD = Reason(ReasonCode.SURVEY_GAUGE_UNRELATED, "its gauge is not used: it is wrong")
SURVEY = track(D, source=AlignmentSource.RECORDED)
GAUGE_ALONE = replace(SURVEY, alignment=np.full(N, np.nan), alignment_std=np.full(N, np.nan))


class WrongGauge(Solved):
    """An epoch whose passes refuse every gauge that is on file."""

    def judge_gauge(self, estimate: SectionEstimate, survey: TrackAlignment) -> Reason | None:
        assert estimate is self.with_prior
        return BAD if survey.gauge_known else None


def refusing(
    alone: TrackAlignment | None, with_prior: TrackAlignment | None, verdict: SurveyVerdict | None = None
) -> WrongGauge:
    plain = epoch(alone, with_prior, verdict)
    return WrongGauge("S", plain.screened, plain.settings, None, plain.alone, plain.with_prior, verdict)


@pytest.mark.parametrize("checked", [False, True])
def test_a_gauge_is_refused_only_where_the_alignment_is_confirmed(*, checked: bool) -> None:
    found = _with_survey(refusing(None, FLEET, RIGHT), SURVEY, survey_checked=checked)
    assert (found.outcome, code_of(found.survey)) == (UpdateOutcome.SURVEY_EXTENDED, BAD.code)
    open_ = Reason(ReasonCode.SURVEY_NOT_ASSESSABLE, "vehicles do not follow their equations")
    for verdict in (None, SurveyVerdict(refused=False, reason=None), SurveyVerdict(refused=False, reason=open_)):
        found = _with_survey(refusing(None, FLEET, verdict), SURVEY, survey_checked=checked)
        assert (found.outcome, found.alignment) == (UpdateOutcome.SURVEY_KEPT, SURVEY)
        assert code_of(found.survey) is not BAD.code


def test_an_alignment_that_is_wrong_is_refused_before_its_gauge() -> None:
    found = _with_survey(refusing(OFF, CERTAIN, WRONG), SURVEY, survey_checked=False)
    assert (found.alignment, code_of(found.survey)) == (OFF, ReasonCode.SURVEY_UNRELATED)


@pytest.mark.parametrize(("alone", "outcome"), [(FLEET, UpdateOutcome.NEW_VERSION), (None, UpdateOutcome.UNESTIMATED)])
def test_a_refused_gauge_without_alignment_is_not_carried_on(
    alone: TrackAlignment | None, outcome: UpdateOutcome
) -> None:
    with_gauge = replace(CERTAIN, findings=SHIFT)
    found = _without_surveyed_alignment(refusing(alone, with_gauge), GAUGE_ALONE, survey_checked=False)
    assert (found.outcome, found.alignment, found.survey) == (outcome, alone, BAD)
    later = _without_surveyed_alignment(epoch(alone, with_gauge), GAUGE_ALONE, survey_checked=True)
    assert (later.outcome, later.alignment) == (outcome, alone)
