"""By how much curves are too flat: against a plain regression of y on R and of R on y, at one place after another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_section_limits import P, a_pass

from estimation.track.gridded_pass import GriddedPass, grid_pass
from estimation.track.panel.basis import Panel, PanelParameters, PanelState, init, pass_rows, update
from estimation.track.panel.instrumental_slope import SlopeCorrection, common_slope, corrected, slope_correction
from estimation.track.panel.solution import PanelSolution, result
from estimation.track.parameters import TRACK
from estimation.values.arrays import FloatArray

PANEL = Panel.of(P.panel)
TRUE = 0.2  # of y - d over R


def gridded(noise: float, count: int = 6) -> list[GriddedPass]:
    """Return passes whose R has noise of this share of its own std."""
    found = []
    for number in range(count):
        item = a_pass(number)
        rng = np.random.default_rng(number)
        error = noise * float(item.difference.std()) * rng.standard_normal(len(item.difference))
        found.append(grid_pass(replace(item, difference=item.difference + error), PANEL.grid))
    return found


def solved(passes: list[GriddedPass]) -> tuple[PanelState, PanelSolution]:
    state = update(init(PANEL), passes)
    return state, result(state, std=False, parameters=PanelParameters())


def within(passes: list[GriddedPass], solution: PanelSolution) -> tuple[FloatArray, FloatArray]:
    """Return y and h(R) (n,), less their means over the passes of a place."""
    places = np.full((2, len(passes), PANEL.grid.points), np.nan)
    for number, item in enumerate(passes):
        rows = pass_rows(item, PANEL)
        curve = solution.curve_of(item.life)
        assert curve is not None
        places[:, number, rows.points] = rows.displacement, curve @ rows.design
    seen = np.isfinite(places[0]).all(axis=0)
    apart = places[:, :, seen] - places[:, :, seen].mean(axis=1, keepdims=True)
    return apart[0].ravel(), apart[1].ravel()


@pytest.mark.parametrize("noise", [0.1, 0.5])
def test_the_share_explained_is_that_of_the_differences_between_the_passes(noise: float) -> None:
    passes = gridded(noise)
    state, solution = solved(passes)
    y, fitted = within(passes, solution)
    found = slope_correction(state, solution)
    r2 = (y @ fitted) ** 2 / ((y @ y) * (fitted @ fitted))
    assert found.explained == pytest.approx(r2, rel=1e-4)
    assert found.factor == pytest.approx(1.0 + 1.4 * (1.0 / r2 - 1.0), rel=1e-4)
    assert found.std == pytest.approx(0.5 * (1.0 / r2 - 1.0), rel=1e-3)
    assert (TRACK.flattening_share, TRACK.flattening_std) == (1.4, 0.5)


def test_noise_of_the_difference_flattens_the_curves_and_the_interval_of_their_slope_holds_the_truth() -> None:
    for noise in (0.2, 0.4, 0.6):
        state, solution = solved(gridded(noise))
        found = slope_correction(state, solution)
        k = PANEL.parameters.basis_count
        line = np.broadcast_to(TRUE * solution.knots, (len(solution.lives), k))
        truth = replace(solution, curves=np.concatenate([line, np.zeros((len(line), 1))], axis=1)[None])
        wanted = common_slope(solution, truth)
        assert wanted > 1.0 + 0.5 * noise**2
        assert abs(found.factor - wanted) < 2.0 * found.std


def test_a_correction_multiplies_curves_and_moves_the_alignment_by_what_they_gain() -> None:
    state, solution = solved(gridded(0.3))
    doubled = corrected(state, solution, 2.0)
    np.testing.assert_array_equal(doubled.curves[:, :, :-1], 2.0 * solution.curves[:, :, :-1])
    np.testing.assert_array_equal(doubled.curves[:, :, -1], solution.curves[:, :, -1])
    by_curves = np.einsum("wk,wkn->n", doubled.curves[0], state.basis_sums)
    known = np.isfinite(solution.alignment)
    again = (state.displacement - by_curves)[known] / state.passes[known]
    np.testing.assert_allclose(doubled.alignment[known], again, atol=1e-8)
    np.testing.assert_array_equal(corrected(state, solution, 1.0).alignment, solution.alignment)


def test_passes_that_explain_nothing_leave_the_slope_open() -> None:
    state, solution = solved(gridded(0.0))
    nothing = replace(solution, curves=0.0 * solution.curves)
    assert slope_correction(state, nothing) == SlopeCorrection(1.0, float("inf"), 0.0)
    assert common_slope(nothing, solution) == 1.0
    assert common_slope(solution, replace(solution, curves=1.25 * solution.curves)) == pytest.approx(1.25)
