"""What the passes say of a survey: how well it explains them, and when that makes it right, wrong or open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_section_limits import ELSEWHERE, LENGTH, P, a_pass, estimated, prior

from estimation.track.panel.basis import Panel
from estimation.track.panel.solution import PriorAlignment, prior_on_grid
from estimation.track.screening.screen import Screened
from estimation.track.settings import AlignmentSettings
from estimation.track.survey_verdict import (
    MIRRORED,
    SurveyFit,
    SurveyVerdict,
    Witnesses,
    fit_survey,
    is_mirrored,
    survey_verdict,
)
from estimation.track.update import _Epoch
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.track import Correction, TrackAlignment

GRID = Panel.of(P.panel).grid
FIT = SurveyFit(factor=1.0, factor_std=0.01, explained=0.99, followed=0.99, error=0.1e-3, size=1e-3)


def on_grid(survey: TrackAlignment) -> PriorAlignment:
    return prior_on_grid(survey, GRID, P.panel.cutoff_wavelength)


def fitted(survey: TrackAlignment) -> SurveyFit:
    """Return how well a survey fits passes that were placed on the right one."""
    found = estimated(*(a_pass(k, start_ns=k) for k in range(4)), prior=prior())
    assert found.iterated is not None
    fit = fit_survey(found.iterated, on_grid(survey))
    assert fit is not None
    return fit


def test_a_right_survey_has_the_factor_one_and_explains_the_passes() -> None:
    fit = fitted(prior())
    assert fit.factor == pytest.approx(1.0, abs=0.02)
    assert fit.factor_std < 0.02
    assert fit.explained > 0.98
    assert fit.followed > 0.8
    assert fit.error < 0.05 * fit.size


@pytest.mark.parametrize("scale", [0.5, 1.2, -1.0])
def test_the_factor_is_the_inverse_of_the_scale(scale: float) -> None:
    wrong = replace(prior(), alignment=scale * prior().alignment)
    assert fitted(wrong).factor == pytest.approx(1.0 / scale, rel=0.03)


def test_a_survey_of_another_section_explains_nothing() -> None:
    fit = fitted(replace(prior(), alignment=ELSEWHERE[200 : 200 + LENGTH + 1]))
    assert abs(fit.factor) < 0.2
    assert fit.explained < 0.2
    assert fit.error > 0.5 * fit.size


def test_an_error_of_the_survey_is_measured_and_taken_back_from_its_factor() -> None:
    error = 0.25 * ELSEWHERE[200 : 200 + LENGTH + 1]
    fit = fitted(replace(prior(), alignment=prior().alignment + error))
    size = float(np.std(on_grid(replace(prior(), alignment=error)).alignment))
    assert fit.error == pytest.approx(size, rel=0.2)
    assert fit.factor < 0.97
    assert abs(1.0 / fit.scale - 1.0) < abs(fit.factor - 1.0)


def test_only_where_the_survey_is_known_counts() -> None:
    part = replace(prior(), alignment=np.where(np.arange(LENGTH + 1) < 400, prior().alignment, np.nan))
    assert fitted(part).factor == pytest.approx(1.0, abs=0.05)
    found = estimated(*(a_pass(k) for k in range(3)), prior=prior())
    assert found.iterated is not None
    nowhere = replace(prior(), alignment=np.full(LENGTH + 1, np.nan))
    assert fit_survey(found.iterated, on_grid(nowhere)) is None


def test_the_scale_takes_back_what_the_errors_of_the_survey_make() -> None:
    assert replace(FIT, error=0.0, factor=0.8).scale == pytest.approx(1.25)
    assert replace(FIT, error=0.3e-3).scale == pytest.approx(0.91)
    assert replace(FIT, error=0.9e-3).scale == pytest.approx(0.19)
    assert replace(FIT, error=2e-3).scale == pytest.approx(0.03)
    assert replace(FIT, factor=0.0).scale == np.inf


def judged(
    fit: SurveyFit | None,
    *offsets: float,
    converged: bool = True,
    filed: float = 0.1e-3,
    slope_std: float = 0.0,
    vehicles: int = 2,
) -> SurveyVerdict:
    corrections = {(f"V{k % vehicles}", k): Correction(offset) for k, offset in enumerate(offsets)}
    return survey_verdict(fit, Witnesses(corrections, slope_std), filed, converged=converged)


def verdict(fit: SurveyFit | None, *offsets: float, **changes: object) -> tuple[bool, ReasonCode | None]:
    found = judged(fit, *offsets, **changes)  # type: ignore[arg-type]
    return found.refused, code_of(found.reason)


RIGHT, MOVING = (False, ReasonCode.SURVEY_CONFIRMED), (False, None)
OPEN = (False, ReasonCode.SURVEY_NOT_ASSESSABLE)


def refused(code: ReasonCode) -> tuple[bool, ReasonCode]:
    return (True, code)


def scaled(by: float, std: float = 0.0) -> SurveyFit:
    return replace(FIT, factor=1.0 / by, factor_std=std, error=0.0)


def test_a_right_survey_is_confirmed_once_positions_have_converged() -> None:
    assert verdict(FIT, 1.0, -1.0) == RIGHT
    assert verdict(FIT, 1.0, -1.0, converged=False) == MOVING


def test_a_survey_may_be_six_percent_and_three_stds_too_large() -> None:
    for std, most in ((0.0, 1.07), (0.02, 1.13)):  # 1 % of the passes is left by the curves
        for factor in (most, 1.0 / most):
            near, far = (replace(scaled(factor ** (1.0 + d)), factor_std=std / factor) for d in (-0.05, 0.05))
            assert verdict(near) in (RIGHT, OPEN)
            assert verdict(far) == refused(ReasonCode.SURVEY_UNIT)
    assert verdict(scaled(1.055)) == verdict(scaled(1.0 / 1.055)) == RIGHT
    assert verdict(scaled(1.2), converged=False) == MOVING
    assert verdict(replace(scaled(-1.0), factor_std=0.34), filed=1e-3) == OPEN
    assert verdict(replace(scaled(-1.0), factor_std=0.33), filed=1e-3) == refused(ReasonCode.SURVEY_MIRRORED)


def test_a_scale_that_the_passes_may_be_wrong_by_is_doubted() -> None:
    stiff = replace(scaled(1.2), followed=0.8)  # of stiff bogies: errors of R flatten their curves
    assert verdict(stiff) == OPEN
    assert judged(stiff).doubted_scale == pytest.approx(np.log(1.2))
    assert "stiff" in str(judged(stiff, 0.0, 0.0).reason)
    assert verdict(replace(stiff, factor=1.0 / 1.3)) == refused(ReasonCode.SURVEY_UNIT)
    assert verdict(scaled(1.2), slope_std=0.05) == OPEN
    assert verdict(scaled(1.2), slope_std=0.04) == refused(ReasonCode.SURVEY_UNIT)
    assert judged(scaled(1.2)).doubted_scale == judged(FIT).doubted_scale == 0.0


def test_who_else_may_be_wrong_is_named() -> None:
    doubted = replace(scaled(1.2), followed=0.91)
    for offsets, vehicles, words in (
        ((0.0, 0.0, 0.0, 0.0), 2, "what all vehicles have in common"),
        ((0.0, 0.0, 0.0), 2, "the few passes (3 journeys)"),
        ((0.0, 0.0, 0.0, 0.0), 1, "the only vehicle"),
    ):
        assert words in str(judged(doubted, *offsets, vehicles=vehicles, slope_std=0.05).reason)
    slow = replace(doubted, followed=0.89)
    assert "explain 89%" in str(judged(slow, 0.0, 0.0, 0.0, 0.0, slope_std=0.05).reason)


def test_a_survey_may_be_three_metres_and_three_stds_off() -> None:
    for sign in (-1.0, 1.0):
        assert verdict(FIT, sign * 2.9, sign * 2.9) == RIGHT
        assert verdict(FIT, sign * 3.1, sign * 3.1) == refused(ReasonCode.SURVEY_DISPLACED)
    limit = 3.0 + 3.0 * np.sqrt(2.0)  # of two journeys, each 2 m from their mean
    assert verdict(FIT, limit - 2.1, limit + 1.9) == RIGHT
    assert verdict(FIT, limit - 1.9, limit + 2.1) == refused(ReasonCode.SURVEY_DISPLACED)
    assert judged(FIT, 3.1, 3.1).harmless
    assert not judged(scaled(1.3), 3.1, 3.1).harmless
    assert verdict(FIT, 3.1, 3.1, vehicles=1) == OPEN  # its odometer may be as much off
    assert verdict(FIT, 2.9, 2.9, vehicles=1) == RIGHT


def test_a_survey_that_the_passes_follow_by_less_than_half_is_of_another_section() -> None:
    for std in (0.0, 0.1):
        other = replace(FIT, factor=0.37 - 3.0 * std, factor_std=std)  # 5 x 0.1 mm of 1 mm: 0.75 is due
        assert verdict(other) == verdict(other, converged=False) == refused(ReasonCode.SURVEY_UNRELATED)
        assert verdict(replace(other, factor=other.factor + 0.01), converged=False) == MOVING
    assert verdict(replace(FIT, factor=0.0), filed=0.19e-3) == refused(ReasonCode.SURVEY_UNRELATED)
    assert verdict(replace(FIT, factor=0.0), filed=0.2e-3) == OPEN  # its errors may be as large as it is


def test_errors_of_a_survey_however_large_are_no_reason_to_refuse_it() -> None:
    """Of 3 mm on a track of 1 mm: it is a tenth of what it shows."""
    noisy = replace(FIT, factor=0.1, factor_std=0.005, explained=0.08, error=3e-3, size=np.sqrt(10.0) * 1e-3)
    assert verdict(noisy, filed=3e-3) == verdict(noisy, filed=0.6e-3 * np.sqrt(10.0 / 9.0) + 1e-6) == RIGHT
    assert verdict(noisy, filed=0.3e-3) == refused(ReasonCode.SURVEY_UNRELATED)


def test_a_survey_with_nothing_in_common_with_the_passes_is_refused_whatever_its_std() -> None:
    """On another section positions that are sought on it alone make a factor of one or two stds."""
    other = replace(FIT, factor=0.059, factor_std=0.01, explained=0.0, error=1.01e-3, size=1e-3)
    for std in (0.1e-3, 0.3e-3, 3e-3):
        assert verdict(other, filed=std, converged=False) == refused(ReasonCode.SURVEY_UNRELATED)
    assert verdict(replace(other, factor=0.061), filed=3e-3, converged=False) == MOVING
    assert verdict(replace(other, error=0.99e-3), filed=3e-3, converged=False) == MOVING
    poor = replace(other, factor=0.5, factor_std=0.1)  # passes that know little of a survey that may be right
    assert verdict(poor, filed=3e-3, converged=False) == MOVING


def test_a_survey_that_is_said_to_be_displaced_is_kept_only_where_it_explains_the_passes_there() -> None:
    half_a_wave = replace(FIT, factor=0.8, explained=0.49, error=0.51e-3)
    assert not judged(half_a_wave, 9.0, 9.0).harmless
    assert judged(half_a_wave, 9.0, 9.0, filed=0.11e-3).harmless
    assert judged(replace(half_a_wave, explained=0.51), 9.0, 9.0).harmless
    assert judged(replace(half_a_wave, error=0.49e-3), 9.0, 9.0).harmless


def test_a_survey_is_a_mirror_image_where_that_fits_better_and_at_its_place() -> None:
    """Half a wave away the mirror image of a track with waves of one length is like it."""
    half_a_wave, image = replace(FIT, factor=0.57, explained=0.31), replace(FIT, explained=0.82)
    displaced, at_its_place = judged(half_a_wave, 9.0, 9.0), judged(image, 0.3, 0.3)
    assert is_mirrored(displaced, half_a_wave, at_its_place, image)
    assert not is_mirrored(displaced, image, at_its_place, half_a_wave)
    assert not is_mirrored(displaced, half_a_wave, judged(image, 9.0, 9.0), image)
    assert not is_mirrored(judged(half_a_wave), half_a_wave, at_its_place, image)
    for wrong in (scaled(1.5), replace(image, followed=0.4)):
        assert not is_mirrored(displaced, half_a_wave, judged(wrong), image)
    assert not is_mirrored(displaced, half_a_wave, at_its_place, None)
    for std, known in ((0.166, True), (0.167, False)):
        assert is_mirrored(displaced, half_a_wave, at_its_place, replace(image, factor_std=std)) is known


def test_the_mirror_image_is_tried_wherever_another_place_or_section_fits_better() -> None:
    assert judged(FIT, 9.0, 9.0).elsewhere
    assert judged(FIT, 9.0, 9.0, vehicles=1).elsewhere
    assert judged(replace(FIT, factor_std=0.2), 9.0, 9.0).elsewhere
    assert judged(replace(FIT, factor=0.0)).elsewhere
    assert judged(replace(FIT, followed=0.4)).elsewhere
    assert not judged(scaled(1.3)).elsewhere
    assert not judged(scaled(-1.0)).elsewhere
    assert judged(scaled(-1.0)).reason is MIRRORED
    assert not judged(FIT).elsewhere


def test_what_the_passes_do_not_know_is_left_open() -> None:
    assert verdict(None) == OPEN
    assert verdict(replace(FIT, factor_std=np.nan)) == OPEN
    assert verdict(replace(FIT, factor_std=0.101)) == OPEN
    assert verdict(replace(FIT, factor_std=0.099)) == RIGHT
    assert verdict(replace(FIT, followed=0.49)) == (False, ReasonCode.MODEL_CONTRADICTED)
    assert verdict(replace(FIT, followed=0.51)) == RIGHT


def test_the_mirror_image_of_a_track_of_one_wavelength_is_called_so() -> None:
    """Its journeys come to rest half a wave away, where it is not unlike the section."""
    s = np.arange(-200.0, LENGTH + 200.0)
    place = 1e-3 * np.sin(2.0 * np.pi * s / 18.0 + 2.5 * ELSEWHERE / np.max(np.abs(ELSEWHERE)))
    passes = [replace(a_pass(k, place, start_ns=k), vehicle=f"V{k % 2}") for k in range(4)]
    survey = replace(prior(), alignment=place[200 : 200 + LENGTH + 1])
    epoch = _Epoch("S", Screened(tuple(passes), ()), AlignmentSettings(section=P), None)
    for sign, code in ((1.0, ReasonCode.SURVEY_CONFIRMED), (-1.0, ReasonCode.SURVEY_MIRRORED)):
        turned = replace(survey, alignment=sign * survey.alignment)
        on_survey = epoch.weigh(turned)
        found = epoch.judge(on_survey, turned)
        assert found is not None
        assert (found.refused, code_of(found.reason)) == (sign < 0.0, code)
        as_it_is = epoch._judged(on_survey, turned)
        assert as_it_is is not None
        assert code_of(as_it_is[0].reason) is not ReasonCode.SURVEY_MIRRORED
