"""A gauge that varies along the section is distinguished from the alignment, by the passes alone or by a recording."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from gauge_passes import LENGTH, Wheels, passes, section

from estimation.filters import high_pass
from estimation.track.gauge.wheel_functions import total_gauge_shifts
from estimation.track.iteration import IterationParameters, IterationResult, iterate
from estimation.track.panel.basis import Panel, PanelParameters
from estimation.track.panel.solution import PriorAlignment
from estimation.track.passes import PositionParameters, ProfileLife, journeys
from estimation.track.results import findings
from estimation.values.arrays import FloatArray
from estimation.values.track import TrackFindings

PANEL = Panel.of(PanelParameters(length=LENGTH, basis_count=21))
GRID = PANEL.grid.s
INNER = slice(200, -200)
GAUGE_STD = 2e-3
CONES = {
    ProfileLife("A", 0, 9): 0.16,
    ProfileLife("A", 0, 10): 0.05,
    ProfileLife("B", 0, 0): 0.08,
    ProfileLife("C", 1, 2): 0.12,
}  # serial, profile, interval of mileage
LATEST = {"A": 0.05, "B": 0.08, "C": 0.12}


@cache
def iterated(gauge_std: float) -> IterationResult:
    positions = PositionParameters()
    grouped = journeys(passes(section(gauge_std), CONES, 4), positions)
    return iterate(grouped, None, PANEL, positions, IterationParameters())


def section_results(gauge_std: float) -> tuple[TrackFindings, FloatArray | None]:
    return findings(iterated(gauge_std), gauge_estimated=True)


def true_gauge(gauge_std: float = GAUGE_STD) -> FloatArray:
    place = section(gauge_std)
    return np.interp(GRID, place.s, place.gauge)


def alignment_error(found: IterationResult, gauge_std: float) -> float:
    place = section(gauge_std)
    true = high_pass(np.interp(GRID, place.s, place.alignment), PANEL.grid.kernel)
    return float((found.solution.alignment - true)[INNER].std())


def shifted(serial: str, seed: int = 5) -> tuple[FloatArray, FloatArray]:
    """Return where the gauge puts a wheelset at places of the section, m: by the findings, and by its radii."""
    shown, gauge = section_results(GAUGE_STD)
    assert gauge is not None
    rng = np.random.default_rng(seed)
    at = rng.integers(INNER.start, PANEL.grid.points + INNER.stop, 400)
    x, e, wheels = 1.5e-3 * rng.standard_normal(400), true_gauge()[at], Wheels(LATEST[serial])
    difference = wheels.difference(x, e)
    everywhere = np.linspace(-9e-3, 9e-3, 2001)
    nominal = np.interp(difference, wheels.difference(everywhere, np.zeros(2001)), everywhere)
    return shown.gauge_shifts[serial].at(difference, gauge[at]), x - nominal


def test_alignment_and_gauge_come_out_of_the_passes_with_the_right_sign() -> None:
    found, true = section_results(GAUGE_STD)[1], true_gauge()[INNER]
    assert found is not None
    assert np.corrcoef(found[INNER], true)[0, 1] > 0.97
    assert alignment_error(iterated(GAUGE_STD), GAUGE_STD) < 0.12e-3


@pytest.mark.parametrize("serial", ["A", "B", "C"])
def test_shifts_and_gauge_found_together_place_a_wheelset(serial: str) -> None:
    """Better than both for themselves: a gauge estimated too small goes with shifts estimated too large."""
    found, true = shifted(serial)
    assert (found - true).var() < 0.5 * true.var()


def test_of_several_lives_of_a_wheelset_the_latest_counts() -> None:
    """Intervals of mileage follow each other as numbers: 10 comes after 9."""
    lives = total_gauge_shifts(iterated(GAUGE_STD).solution, iterated(GAUGE_STD).panel)
    assert set(lives) == set(CONES)
    shifts = section_results(GAUGE_STD)[0].gauge_shifts
    assert set(shifts) == set(LATEST)
    both_signs = (lives[ProfileLife("A", 0, 10)].shift, lives[ProfileLife("A", 0, 10)].shift[:, ::-1])
    assert any(np.array_equal(shifts["A"].shift, one) for one in both_signs)


def test_a_gauge_that_does_not_vary_is_not_made_up() -> None:
    found = iterated(0.0)
    assert found.panel.gauge is None
    shown, gauge = section_results(0.0)
    assert (gauge, dict(shown.gauge_shifts)) == (None, {})
    assert alignment_error(found, 0.0) < 0.02e-3


def test_a_recorded_gauge_fixes_the_positions_of_the_passes() -> None:
    """The alignment is unknown, and every odometer is 6 m off."""
    recorded = np.interp(GRID - 6.0, GRID, true_gauge())
    nothing = np.zeros(PANEL.grid.points)
    known = PriorAlignment(
        nothing, np.full(PANEL.grid.points, np.inf), nothing, recorded, nothing + 0.2e-3, gauge_known=True
    )
    positions = PositionParameters()
    grouped = journeys(passes(section(GAUGE_STD), CONES, 3), positions)
    found = iterate(grouped, known, PANEL, positions, IterationParameters())
    for correction in found.corrections.values():
        assert correction.at(np.array([1000.0]))[0] - 1000.0 == pytest.approx(6.0, abs=0.5)
    shown, gauge = findings(found, gauge_estimated=False)
    assert gauge is None
    assert set(shown.gauge_shifts) == set(LATEST)
