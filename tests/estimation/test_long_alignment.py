"""With the curves known the passes determine wavelengths of the alignment that the panel has filtered out."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gauge_passes import LENGTH, Section, passes, section

from estimation.filters import high_pass, local_cubic_kernel
from estimation.track.gridded_pass import GriddedPass, grid_pass
from estimation.track.panel.basis import Panel, PanelParameters, init, update
from estimation.track.panel.solution import PanelSolution, result
from estimation.track.passes import Pass, ProfileLife
from estimation.track.results import LongWaveAlignment, long_wave_alignment
from estimation.values.arrays import FloatArray

PANEL = Panel.of(PanelParameters(length=LENGTH, basis_count=21))
GRID = PANEL.grid.s
CONES = {"A": 0.05, "B": 0.10, "C": 0.16}
NOISE = 0.05e-3


@cache
def place() -> Section:
    return section(0.0, longest=90.0)


def measured(*, noise: float = NOISE) -> list[GriddedPass]:
    return gridded(passes(place(), CONES, 3, noise=noise))


def gridded(found: list[Pass]) -> list[GriddedPass]:
    return [grid_pass(item, PANEL.grid) for item in found]


@cache
def solved() -> PanelSolution:
    return result(update(init(PANEL), measured()), parameters=PanelParameters())


def true(cutoff_wavelength: float) -> FloatArray:
    return high_pass(
        np.interp(GRID, place().s, place().alignment), local_cubic_kernel(cutoff_wavelength, PANEL.grid.step)
    )


def error(found: LongWaveAlignment, cutoff_wavelength: float) -> float:
    seen = found.weight == found.weight.max()
    return float((found.alignment - true(cutoff_wavelength))[seen].std())


def test_waves_that_the_panel_has_lost_come_back() -> None:
    found = long_wave_alignment(measured(), solved(), PANEL, 120.0)
    seen = found.weight == 9
    lost = float((np.nan_to_num(solved().alignment) - true(120.0))[seen].std())
    assert seen.mean() > 0.75  # twice the reach of a filter of 120 m is lost at each end
    assert error(found, 120.0) < 0.05 * true(120.0)[seen].std()
    assert error(found, 120.0) < 0.2 * lost


def test_the_std_of_a_pass_is_the_scatter_of_the_passes() -> None:
    found = long_wave_alignment(measured(), solved(), PANEL, 120.0)
    assert found.pass_std == pytest.approx(NOISE, rel=0.2)
    loud = long_wave_alignment(measured(noise=4 * NOISE), solved(), PANEL, 120.0)
    assert loud.pass_std == pytest.approx(4 * NOISE, rel=0.2)


def test_at_the_cut_off_of_the_panel_it_is_the_alignment_of_the_panel() -> None:
    found = long_wave_alignment(measured(), solved(), PANEL, PANEL.grid.cutoff_wavelength)
    seen = (found.weight == 9) & np.isfinite(solved().alignment)
    np.testing.assert_allclose(found.alignment[seen], solved().alignment[seen], atol=1e-6)


def test_passes_of_wheelsets_without_curve_and_short_ones_say_nothing() -> None:
    some = passes(place(), CONES, 3, noise=NOISE)
    stranger = replace(some[0], life=ProfileLife("X"))
    short = replace(
        some[0], at=some[0].at[:80], displacement=some[0].displacement[:80], difference=some[0].difference[:80]
    )
    found = long_wave_alignment(gridded([stranger, short]), solved(), PANEL, 120.0)
    assert not found.weight.any()
    assert not found.alignment.any()
    both = long_wave_alignment(gridded([*some, stranger, short]), solved(), PANEL, 120.0)
    np.testing.assert_array_equal(both.alignment, long_wave_alignment(gridded(some), solved(), PANEL, 120.0).alignment)
