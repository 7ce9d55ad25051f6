"""The alignment of a place and the geometry of those who pass it, from the passes alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smooth_wheelset import SmoothTable, mems_windows, run, track
from whole_runs import whole_runs
from window_passes import window_passes

from estimation.contact.conicity import equivalent_conicity
from estimation.filters import high_pass, local_cubic_kernel, valid_support
from estimation.track.gridded_pass import grid_pass
from estimation.track.panel.basis import Panel, PanelParameters, PanelState, basis_functions, init, update
from estimation.track.panel.solution import PanelSolution, result
from estimation.track.passes import Pass, ProfileLife, gridded
from estimation.values.reasons import ReasonCode, code_of
from estimation.vehicle.vehicle_class import VehicleParameters

PARAMETERS = PanelParameters(length=3000.0, basis_count=31)
PANEL = Panel.of(PARAMETERS)
FLEET = ((0.05, 17.0), (0.10, 17.0), (0.16, 17.0), (0.05, 23.0), (0.10, 23.0), (0.16, 23.0))  # cone, speed


@cache
def fleet_passes(seed: int = 1, alike: bool = False) -> tuple[Pass, ...]:  # noqa: FBT001, FBT002 - a test's switch
    found: list[Pass] = []
    for number, (cone, speed) in enumerate(FLEET):
        cone, speed = (0.10, 20.0) if alike else (cone, speed)  # noqa: PLW2901 - alike on purpose
        m = run(120, seed=seed, cone=cone, speed=speed)
        (window,) = whole_runs(mems_windows(m, seed=10 * seed + number))
        name = f"cone {cone}" + (f" {number}" if alike else "")
        found += [
            replace(item, life=ProfileLife(name), vehicle=f"{speed:g} m/s")
            for item in window_passes(window, VehicleParameters())
        ]
    return tuple(found)


def _solved(found: tuple[Pass, ...]) -> PanelSolution:
    return result(update(init(PANEL), [grid_pass(item, PANEL.grid) for item in found]), parameters=PanelParameters())


def test_the_local_fit_takes_out_cubics_and_halves_the_cut_off() -> None:
    weights = local_cubic_kernel(30.0, 0.5)
    assert weights.sum() == pytest.approx(1.0)
    s = np.arange(2000) * 0.5
    m = len(weights) // 2
    cubic = 3.0 + 0.2 * s - 1e-3 * s**2 + 4e-7 * s**3
    assert np.abs(high_pass(cubic, weights)[m:-m]).max() < 1e-7
    wave = np.sin(2 * np.pi * s / 30.0)
    assert np.abs(high_pass(wave, weights)[m:-m]).max() == pytest.approx(0.5, abs=0.02)
    fast = np.sin(2 * np.pi * s / 8.0)
    assert np.abs(high_pass(fast, weights)[m:-m]).max() == pytest.approx(1.0, abs=0.01)


def test_a_sample_counts_when_all_within_reach_are_valid() -> None:
    weights = np.ones(5) / 5
    valid = np.ones(20, dtype=bool)
    valid[10] = False
    expected = np.array([all(0 <= j < 20 and valid[j] for j in range(i - 2, i + 3)) for i in range(20)])
    np.testing.assert_array_equal(valid_support(valid, weights), expected)


@given(R=st.lists(st.floats(-4e-3, 4e-3), min_size=1, max_size=30))
def test_hats_add_up_to_one_and_reproduce_straight_lines(R: list[float]) -> None:
    knots = PARAMETERS.knots
    values = basis_functions(np.array(R), knots)
    np.testing.assert_allclose(values.sum(axis=0), 1.0, atol=1e-12)
    np.testing.assert_allclose(knots @ values, R, atol=1e-12)


def test_the_radius_difference_of_a_pass_is_the_true_one() -> None:
    m = run(120, seed=1, cone=0.10, speed=20.0)
    window = mems_windows(m, seed=0, density=0.0)[0]
    (found,) = window_passes(window, VehicleParameters())
    weights = local_cubic_kernel(30.0, 0.5)
    first, _, difference = gridded(found, 0.5)
    grid = (first + np.arange(len(difference))) * 0.5
    true = np.interp(grid, m.distance, m.rolling_radius_left - m.rolling_radius_right)
    inner = slice(len(weights), -len(weights))
    error = high_pass(difference, weights) - high_pass(true, weights)
    assert np.sqrt((error[inner] ** 2).mean()) < 0.012 * true.std()  # waves of 2 m and less are taken out


def test_alignment_and_conicity_come_out_of_unknown_track() -> None:
    solved = _solved(fleet_passes())
    assert solved.reason is None
    weights = local_cubic_kernel(PARAMETERS.cutoff_wavelength, PARAMETERS.step)
    grid = PANEL.grid.s
    truth = track(1)
    true = high_pass(np.interp(grid, truth.s, truth.alignment), weights)
    seen = np.isfinite(solved.alignment) & (grid > 200) & (grid < 1850)
    error = (solved.alignment - true)[seen]
    assert seen.sum() > 0.99 * (1650 / PARAMETERS.step)  # two filters, 153 m, are lost at each end of a pass
    assert error.std() < 0.12 * true[seen].std()
    amplitudes = (1.0e-3, 1.5e-3, 2.0e-3)
    curves = solved.curves[0, :, : PARAMETERS.basis_count]
    for life, curve, weight in zip(solved.lives, curves, solved.weight, strict=True):
        table = SmoothTable(float(life.wheelset.split()[1]))
        x = table.lateral_displacement
        expected = equivalent_conicity(x, table.left(x) - table.right(x), amplitudes)
        used = (weight > 50) & (np.gradient(curve) > 0)
        found = equivalent_conicity(curve[used], solved.knots[used], amplitudes)
        assert np.nanmax(np.abs(found - expected)) < 0.02, life


@settings(max_examples=8)
@given(order=st.permutations(range(6)), cut=st.integers(1, 5))
def test_any_order_and_grouping_of_the_passes_gives_the_same(order: list[int], cut: int) -> None:
    found = fleet_passes()
    small = Panel.of(PanelParameters(length=2000.0, basis_count=11, groups=4))
    on_grid = [grid_pass(item, small.grid) for item in found]
    chosen = [on_grid[i] for i in order]
    state: PanelState = update(update(init(small), chosen[:cut]), chosen[cut:])
    reference = update(init(small), on_grid[:6])
    columns = [state.lives.index(name) for name in reference.lives]
    for name in ("gram", "cross"):
        ours, theirs = getattr(state, name)[:, columns], getattr(reference, name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())
    np.testing.assert_array_equal(state.passes, reference.passes)
    np.testing.assert_allclose(state.displacement, reference.displacement, rtol=1e-9, atol=1e-15)


def test_one_wheelset_alone_or_wheelsets_all_alike_say_nothing() -> None:
    alone = tuple(p for p in fleet_passes() if p.wheelset == "cone 0.05")
    assert _solved(alone).reason
    assert code_of(_solved(fleet_passes(alike=True)).reason) is ReasonCode.PASSES_ALIKE


def test_nothing_and_what_is_too_short_are_unestimated() -> None:
    assert result(init(Panel.of(PanelParameters(length=500.0, basis_count=5))), parameters=PanelParameters()).reason
    short = Pass(ProfileLife("W"), "V", 0, np.arange(90) * 0.08, np.zeros(90), np.zeros(90))
    assert update(init(PANEL), [grid_pass(short, PANEL.grid)]).passes.sum() == 0
