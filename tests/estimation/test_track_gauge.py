"""A gauge that varies along the section is told apart from the alignment, by the passes alone or by a recording."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from gauge_passes import LENGTH, Wheels, passes, section

from estimation.arrays import FloatArray
from estimation.track.evidence import Evidence
from estimation.track.findings import Told, findings
from estimation.track.local_filter import smoother, without_slow_part
from estimation.track.panel import PanelParameters
from estimation.track.positions import PositionParameters, journeys
from estimation.track.settling import Settled, SettlingParameters, settle

PANEL = PanelParameters(length=LENGTH, hats=21)
GRID = np.arange(PANEL.points) * PANEL.step
INNER = slice(200, -200)
GAUGE_STD = 2e-3
CONES = {"A#0#9": 0.16, "A#0#10": 0.05, "B#0#0": 0.08, "C#1#2": 0.12}  # serial, profile, interval of mileage
LATEST = {"A": 0.05, "B": 0.08, "C": 0.12}


@cache
def settled(gauge_std: float) -> Settled:
    positions = PositionParameters()
    grouped = journeys(passes(section(gauge_std), CONES, 4), positions)
    return settle(grouped, None, PANEL, positions, SettlingParameters())


def told(gauge_std: float) -> Told:
    return findings(settled(gauge_std), gauge_estimated=True)


def true_gauge(gauge_std: float = GAUGE_STD) -> FloatArray:
    place = section(gauge_std)
    return np.interp(GRID, place.s, place.gauge)


def alignment_error(found: Settled, gauge_std: float) -> float:
    place = section(gauge_std)
    true = without_slow_part(np.interp(GRID, place.s, place.alignment), smoother(PANEL.cut_off, PANEL.step))
    return float((found.solution.alignment - true)[INNER].std())


def test_alignment_and_gauge_come_out_of_the_passes_with_their_sizes_and_signs() -> None:
    found, true = told(GAUGE_STD).gauge, true_gauge()[INNER]
    assert found is not None
    assert np.corrcoef(found[INNER], true)[0, 1] > 0.97
    assert (found[INNER] @ true) / (true @ true) == pytest.approx(1.0, abs=0.4)  # what is told of its std
    assert alignment_error(settled(GAUGE_STD), GAUGE_STD) < 0.1e-3


def test_the_std_of_the_gauge_covers_its_error() -> None:
    one = told(GAUGE_STD)
    assert one.gauge is not None
    assert one.gauge_std is not None
    error = (one.gauge - true_gauge())[INNER]
    assert np.mean(np.abs(error - error.mean()) < 2 * one.gauge_std[INNER]) > 0.95
    assert (one.gauge_std > 0).all()


def test_the_wheels_found_tell_what_the_gauge_found_adds_to_the_radius_difference() -> None:
    """Better than both for themselves: a gauge told too small goes with wheels told too steep."""
    one = told(GAUGE_STD)
    assert one.gauge is not None
    e, believed = true_gauge()[INNER], (one.gauge - one.gauge[INNER].mean() + true_gauge()[INNER].mean())[INNER]
    x = 1.5e-3 * np.random.default_rng(5).standard_normal(len(e))
    for serial, cone in LATEST.items():
        true = Wheels(cone).difference(x, e) - Wheels(cone).difference(x, np.zeros(len(e)))
        left = one.findings.wheels[serial].gauge_effect(x, believed) - true
        assert left.var() < 0.4 * true.var(), serial


def test_of_several_lives_of_a_wheelset_the_latest_counts() -> None:
    """Intervals of mileage follow each other as numbers: 10 comes after 9."""
    wheels = told(GAUGE_STD).findings.wheels
    assert set(wheels) == set(LATEST)
    for serial, cone in LATEST.items():
        left = wheels[serial].left
        slope = (np.interp(1e-3, wheels[serial].knots, left) - np.interp(-1e-3, wheels[serial].knots, left)) / 2e-3
        assert slope == pytest.approx(cone, abs=0.02), serial


def test_a_gauge_that_does_not_vary_is_not_made_up() -> None:
    found = settled(0.0)
    assert found.panel.gauge is None
    one = told(0.0)
    assert (one.gauge, one.gauge_std, dict(one.findings.wheels)) == (None, None, {})
    assert alignment_error(found, 0.0) < 0.02e-3


def test_a_recorded_gauge_says_where_the_passes_lie() -> None:
    """Nobody knows the alignment, and every odometer is 6 m off."""
    recorded = np.interp(GRID - 6.0, GRID, true_gauge())
    nothing = np.zeros(PANEL.points)
    known = Evidence(nothing, np.full(PANEL.points, np.inf), nothing, recorded, nothing + 0.2e-3, gauge_known=True)
    positions = PositionParameters()
    grouped = journeys(passes(section(GAUGE_STD), CONES, 3), positions)
    found = settle(grouped, known, PANEL, positions, SettlingParameters())
    for correction in found.corrections.values():
        assert correction.at(np.array([1000.0]))[0] - 1000.0 == pytest.approx(6.0, abs=0.5)
    one = findings(found, gauge_estimated=False)
    assert (one.gauge, one.gauge_std) == (None, None)
    assert set(one.findings.wheels) == set(LATEST)
