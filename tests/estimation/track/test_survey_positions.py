"""Passes on a survey are put where they were, whatever the noise of R, and whatever the errors of the survey."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from smooth_wheelset import track
from test_panel import PANEL, fleet_passes

from estimation.filters import high_pass, local_cubic_kernel
from estimation.track import survey_positions
from estimation.track.gridded_pass import Placed, place
from estimation.track.iteration import IterationParameters, iterate
from estimation.track.panel.solution import PriorAlignment
from estimation.track.passes import Journey, Pass, PositionParameters, journeys
from estimation.track.survey_positions import SurveyPositionParameters, positions_on_survey
from estimation.values.track import Correction

OFFSETS = {"17 m/s": 1.9, "23 m/s": -1.4}  # m
SCALES = {"17 m/s": 4e-4, "23 m/s": -3e-4}
MIDDLE = 0.5 * PANEL.grid.length
GRID = PANEL.grid


def survey(std: float = 0.0, seed: int = 3) -> PriorAlignment:
    truth, zero = track(1), np.zeros(GRID.points)
    d = np.interp(GRID.s, truth.s, truth.alignment) + std * np.random.default_rng(seed).standard_normal(GRID.points)
    d = high_pass(d, local_cubic_kernel(PANEL.parameters.cutoff_wavelength, GRID.step))
    covered = np.where((truth.s[0] <= GRID.s) & (truth.s[-1] >= GRID.s), 0.1e-3, np.inf)
    return PriorAlignment(d, covered, zero, zero, zero, gauge_known=True, surveyed=True)


def moved(noise: float, *, shortest: float = 0.0, seed: int = 5) -> list[Pass]:
    """Return the passes at wrong positions, with noise (m) in R; those of one vehicle cut to a length, m."""
    rng = np.random.default_rng(seed)
    found = []
    for item in fleet_passes():
        at = item.at - OFFSETS[item.vehicle] - SCALES[item.vehicle] * (item.at - MIDDLE)
        difference = item.difference + noise * rng.standard_normal(len(at))
        kept = slice(None) if not shortest or item.vehicle == "17 m/s" else slice(0, int(np.searchsorted(at, shortest)))
        found.append(
            replace(
                item,
                at=at[kept],
                displacement=item.displacement[kept],
                difference=difference[kept],
                stiffness_term=None,
            )
        )
    return found


def placed(passes: list[Pass]) -> Placed:
    grouped = journeys(passes, PositionParameters())
    return place(grouped, {journey: Correction(middle=MIDDLE) for journey in grouped}, {}, GRID)


def left_over(corrections: dict[Journey, Correction]) -> np.ndarray:
    """Return what remains of the errors at 600 m and 1,500 m."""
    true = np.array([600.0, 1500.0])
    rows = []
    for (vehicle, _), correction in corrections.items():
        measured = true - OFFSETS[vehicle] - SCALES[vehicle] * (true - MIDDLE)
        rows.append(correction.at(measured) - true)
    return np.array(rows)


@pytest.mark.parametrize("noise", [0.0, 0.1e-3])
@pytest.mark.parametrize("survey_std", [0.0, 0.3e-3])
def test_journeys_are_where_they_were(noise: float, survey_std: float) -> None:
    found = positions_on_survey(placed(moved(noise)), survey(survey_std), GRID)
    assert found is not None
    assert len(found) == len(OFFSETS)
    assert np.abs(left_over(found)).max() < 0.12


def test_a_journey_whose_short_waves_say_nothing_stays_where_it_was() -> None:
    vague = [replace(item, difference=1e-3 * item.difference) for item in moved(0.0)]
    vague = [
        replace(item, difference=item.difference + 0.1e-3 * np.random.default_rng(k).standard_normal(len(item.at)))
        for k, item in enumerate(vague)
    ]
    on_grid = placed(vague)
    found = positions_on_survey(on_grid, survey(), GRID)
    assert found is not None
    moves = [abs(found[journey].offset - one.correction.offset) for journey, one in on_grid.items()]
    assert max(moves) < 0.6
    bold = searched_with(SurveyPositionParameters(place_std=100.0), on_grid)
    assert bold is None or max(abs(bold[j].offset - on_grid[j].correction.offset) for j in on_grid) > max(moves)


def searched_with(parameters: SurveyPositionParameters, on_grid: Placed) -> dict[Journey, Correction] | None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(survey_positions, "SurveyPositionParameters", lambda: parameters)
        return positions_on_survey(on_grid, survey(), GRID)


def test_a_journey_too_short_to_say_anything_keeps_its_place() -> None:
    on_grid = placed(moved(0.0, shortest=350.0))
    found = positions_on_survey(on_grid, survey(), GRID)
    assert found is not None
    short = next(journey for journey in found if journey[0] == "23 m/s")
    assert found[short] == on_grid[short].correction
    assert np.abs(left_over(found)[0]).max() < 0.1


def test_a_journey_is_not_moved_to_another_wave_of_the_track() -> None:
    near = SurveyPositionParameters(farthest=1.0)
    assert searched_with(near, placed(moved(0.0))) is None
    assert SurveyPositionParameters().farthest == 3.0


def test_what_does_not_come_to_rest_is_not_found() -> None:
    once = SurveyPositionParameters(rounds=1)
    assert searched_with(once, placed(moved(0.0))) is None


def test_the_rounds_on_a_survey_end_at_these_positions() -> None:
    """Not at the panel's, which are moved by the noise of R."""
    grouped = journeys(moved(0.1e-3), PositionParameters())
    found = iterate(grouped, survey(), PANEL, PositionParameters(), IterationParameters())
    assert found.placed_on_survey
    assert np.abs(left_over(found.corrections)).max() < 0.12


@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize("noise", [0.02e-3, 0.1e-3])
def test_neither_the_errors_of_a_survey_nor_those_of_r_move_all_journeys(noise: float, seed: int) -> None:
    """Errors of a survey flatten R over y - d, those of R flatten y - d over R: what is left moves all alike."""
    rough = survey(1e-3, seed)
    rough = replace(rough, std=np.where(np.isfinite(rough.std), 1e-3, np.inf))
    grouped = journeys(moved(noise), PositionParameters())
    off = {}
    for flatten in (IterationParameters().curves_flatten, np.inf, 0.0):
        p = IterationParameters(curves_flatten=flatten)
        found = iterate(grouped, rough, PANEL, PositionParameters(), p)
        assert found.placed_on_survey
        off[flatten] = float(left_over(found.corrections).mean())
    shipped, by_r, by_curves = off.values()
    assert by_curves < -0.05 < 0.2 < by_r
    assert abs(shipped) < 0.15


@pytest.mark.parametrize("length", [0.0, 20.0, 200.0])
def test_passes_too_short_for_the_filters_keep_their_places(length: float) -> None:
    short = [
        replace(item, at=item.at[:k], displacement=item.displacement[:k], difference=item.difference[:k])
        for item in moved(0.0)
        for k in [int(np.searchsorted(item.at - item.at[0], length)) + 2]
    ]
    on_grid = placed(short)
    assert positions_on_survey(on_grid, survey(), GRID) == {j: one.correction for j, one in on_grid.items()}


@pytest.mark.parametrize(("factor", "found"), [(1.0, True), (2.5, True), (10.0, False), (1000.0, False)])
def test_journeys_are_not_placed_on_a_survey_in_another_unit(factor: float, *, found: bool) -> None:
    right = survey()
    wrong = replace(right, alignment=factor * right.alignment)
    assert (positions_on_survey(placed(moved(0.0)), wrong, GRID) is not None) == found


def test_the_shipped_figures() -> None:
    p = SurveyPositionParameters()
    assert (p.cutoff_wavelength, p.tolerance, p.largest_step, p.scale_std) == (15.0, 0.02, 2.0, 3e-3)
    assert (p.rounds, p.least_points, p.ridge) == (12, 400, 1e-6)
    assert (p.most_apart, p.place_std, p.correlated) == (2.0, 1.0, 4.0)
    assert (IterationParameters().survey_rounds, IterationParameters().survey_moved) == (4, 0.05)
    assert (IterationParameters().survey_tolerance, IterationParameters().curves_flatten) == (0.3, 6.0)
