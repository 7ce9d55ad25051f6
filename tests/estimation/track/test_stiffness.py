"""Yaw stiffness over creep coefficient of every vehicle, learnt from passes over unknown track."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from smooth_wheelset import mems_windows, run
from whole_runs import whole_runs
from window_passes import window_passes

from estimation.track.gridded_pass import grid_pass, with_ratio
from estimation.track.iteration import IterationParameters, IterationResult, iterate
from estimation.track.panel.basis import Panel, PanelParameters
from estimation.track.panel.instrumental_slope import Ratio, with_ratio_std
from estimation.track.parameters import TRACK
from estimation.track.passes import Pass, PositionParameters, journeys
from estimation.track.results import findings
from estimation.vehicle.vehicle_class import VehicleParameters

CONES = (0.05, 0.10, 0.16)
NAMES = ("stiffness_term", "difference")
SOFT, RIGHT = 17.0, 23.0  # m/s of the vehicle that is assumed 20 % too soft, and of one that is known
PANEL = Panel.of(PanelParameters(length=2800.0, basis_count=21))


@cache
def assumed_stiffness(share: float) -> tuple[Pass, ...]:
    """Return passes of two vehicles with three wheelsets each, one read with ``share`` of its true yaw stiffness."""
    found: list[Pass] = []
    truth = VehicleParameters()
    for number, (speed, cone) in enumerate((speed, cone) for speed in (SOFT, RIGHT) for cone in CONES):
        vehicle = replace(truth, yaw_stiffness=share * truth.yaw_stiffness) if speed == SOFT else truth
        (window,) = whole_runs(mems_windows(run(120, seed=1, cone=cone, speed=speed), seed=10 + number))
        named = replace(window, wheelset=f"{cone} of {speed:g}", vehicle=f"{speed:g}")
        found += window_passes(named, vehicle)
    return tuple(found)


@cache
def iterated(share: float) -> IterationResult:
    positions = PositionParameters()
    return iterate(journeys(assumed_stiffness(share), positions), None, PANEL, positions, IterationParameters())


def test_a_vehicle_assumed_stiffness_too_soft_is_found_out_on_unknown_track() -> None:
    found = iterated(0.8).ratios
    assert found[f"{SOFT:g}"].value == pytest.approx(1 / 0.8, rel=0.02)
    assert found[f"{RIGHT:g}"].value == pytest.approx(1.0, abs=0.02)


def test_the_std_of_a_ratio_covers_its_error_and_reaches_the_geometry() -> None:
    """Without a std the intervals of the geometry would hold the ratio for certain."""
    one = iterated(0.8)
    truth = {f"{SOFT:g}": 1 / 0.8, f"{RIGHT:g}": 1.0}
    for vehicle, ratio in one.ratios.items():
        assert PanelParameters().ratio_systematic_std < ratio.std < 0.05
        assert abs(ratio.value - truth[vehicle]) < 2.5 * ratio.std
    track_findings = findings(one, gauge_estimated=False)[0]
    assert track_findings.stiffness_ratio_std == max(ratio.std for ratio in one.ratios.values())
    assert track_findings.stiffness_ratio == {vehicle: ratio.value for vehicle, ratio in one.ratios.items()}


def test_what_the_curves_leave_unexplained_widens_a_ratio_as_far_as_the_stiffness_term_is_the_difference() -> None:
    """Errors of R make a ratio too small in every block of data alike; a third unexplained counts for the most."""
    passes_of = [grid_pass(item, PANEL.grid) for item in assumed_stiffness(1.0)]
    one = iterated(1.0)
    widths = {}
    for explained in (1.0, 0.9, 0.67, 0.3):
        ratios = {vehicle: Ratio() for vehicle in one.ratios}
        widths[explained] = with_ratio_std(ratios, passes_of, one.solution, PANEL, explained)
    for vehicle in one.ratios:
        own = [item for item in passes_of if item.source.vehicle == vehicle]
        E, R = (np.concatenate([getattr(item, name)[item.inside] for item in own]) for name in NAMES)
        share = float(E @ E / (R @ R))
        plain, wide = (widths[explained][vehicle].std for explained in (1.0, 0.9))
        assert wide == pytest.approx(weighed(plain, (1.0 / 0.9 - 1.0) * share), rel=1e-6)
        assert widths[0.67][vehicle].std == pytest.approx(weighed(plain, (1.0 / 0.67 - 1.0) * share), rel=1e-6)
        assert widths[0.3] == widths[0.67], "no more than that"


def weighed(plain: float, more: float) -> float:
    """Return the std of a ratio with one more error of its step, from the std without it."""
    of_data = np.sqrt(plain**2 - PanelParameters().ratio_systematic_std ** 2)  # sqrt(w) e with w = p^2/(p^2 + e^2)
    before = TRACK.ratio_prior_std**2 * of_data**2 / (TRACK.ratio_prior_std**2 - of_data**2)
    square = before + more**2
    worth = TRACK.ratio_prior_std**2 / (TRACK.ratio_prior_std**2 + square)
    return float(np.hypot(np.sqrt(worth * square), PanelParameters().ratio_systematic_std))


def test_the_ratio_makes_the_radius_difference_that_of_the_vehicle_as_it_is() -> None:
    """R of the assumed stiffness plus its stiffness term in the right proportion is R of the true stiffness."""
    soft, right = (list(assumed_stiffness(share)[: len(CONES)]) for share in (0.8, 1.0))
    for ours, true in zip(soft, right, strict=True):
        before, after, whole = (
            grid_pass(item, PANEL.grid, ratio).difference for item, ratio in ((ours, 1.0), (ours, 1 / 0.8), (true, 1.0))
        )
        wrong = (before - whole).std()
        assert wrong > 0.08 * whole.std()
        assert (after - whole).std() < 0.1 * wrong  # the long waves come by a gravity term fitted to the wrong R


def test_another_ratio_needs_no_filter_again_and_without_stiffness_term_nothing_changes() -> None:
    item = assumed_stiffness(0.8)[0]
    at_once = grid_pass(item, PANEL.grid, 1.25)
    later = with_ratio(grid_pass(item, PANEL.grid), 1.25, PANEL.grid)
    np.testing.assert_array_equal(later.difference, at_once.difference)
    np.testing.assert_array_equal(later.inside, at_once.inside)
    plain = grid_pass(replace(item, stiffness_term=None), PANEL.grid)
    np.testing.assert_array_equal(with_ratio(plain, 1.25, PANEL.grid).difference, plain.difference)
