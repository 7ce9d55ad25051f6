"""Noise of R flattens the curves and noise of y does not; the mean displacement of the place separates them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from test_panel import PANEL, fleet_passes

from estimation.track.gridded_pass import GriddedPass, grid_pass
from estimation.track.panel.basis import PanelParameters, init, update
from estimation.track.panel.instrumental_slope import SlopeCorrection, common_slope, slope_correction, with_instrument
from estimation.track.panel.solution import PanelSolution, result
from estimation.track.passes import Pass


def _noisy(name: str, std: float) -> list[Pass]:
    rng = np.random.default_rng(3)
    return [
        replace(item, stiffness_term=None, **{name: getattr(item, name) + std * rng.standard_normal(len(item.at))})
        for item in fleet_passes()
    ]


def _solved(passes: Sequence[Pass]) -> tuple[list[GriddedPass], PanelSolution, SlopeCorrection]:
    gridded = [grid_pass(item, PANEL.grid) for item in passes]
    state = update(init(PANEL), gridded)
    solution = result(state, parameters=PanelParameters())
    return gridded, solution, slope_correction(state, solution)


@pytest.mark.parametrize(("name", "std"), [("difference", 0.1e-3), ("displacement", 0.4e-3)])
def test_the_instrument_finds_what_noise_does_to_the_curves(name: str, std: float) -> None:
    _, quiet, _ = _solved(_noisy(name, 0.0))
    passes, noisy, slope = _solved(_noisy(name, std))
    needed = common_slope(noisy, quiet)
    found = with_instrument(slope, passes, noisy, PANEL)
    assert found.factor == pytest.approx(needed, abs=2.5 * found.std)
    assert abs(found.factor - needed) < 0.4 * abs(slope.factor - needed)
    assert found.explained == slope.explained
    assert 0.14 * (1.0 / slope.explained - 1.0) < found.std
    assert found.std < 0.6 * slope.std


def test_a_weak_instrument_is_not_used() -> None:
    passes, solution, slope = _solved(_noisy("difference", 0.8e-3))
    assert with_instrument(slope, passes, solution, PANEL) is slope
    passes, solution, slope = _solved(_noisy("difference", 0.5e-3))
    assert with_instrument(slope, passes, solution, PANEL) is not slope


def test_where_the_curves_explain_nothing_the_correction_stays_unknown() -> None:
    passes, solution, _ = _solved(fleet_passes())
    nothing = SlopeCorrection(1.0, float("inf"), 0.0)
    assert with_instrument(nothing, passes, solution, PANEL) is nothing
