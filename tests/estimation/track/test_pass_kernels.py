"""Compiled sums over passes beside their plain forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.filters import high_pass, local_cubic_kernel
from estimation.motion.rolling_radius_difference import sample_smoothed
from estimation.track.gridded_pass import GriddedPass
from estimation.track.panel.basis import Panel, PanelParameters, basis_functions, gauge_at, pass_rows
from estimation.track.passes import Pass, ProfileLife
from estimation.track.screening.agreement import cross_products, own_products
from estimation.values.arrays import BoolArray, FloatArray, as_slice

PARAMETERS = PanelParameters(length=600.0, basis_count=21, gauge_basis_count=7)
SEEDS = st.integers(0, 2**32 - 1)


def _pass(rng: np.random.Generator, inside: BoolArray, side: int) -> GriddedPass:
    """Return a pass over the middle of the section whose R goes beyond the knots here and there."""
    m = len(inside)
    points = np.arange(40, 40 + m)
    R, y, term = (np.cumsum(rng.standard_normal((3, m)), axis=1) - rng.standard_normal((3, m))) * 1e-3
    source = Pass(ProfileLife("W"), "V", 0, points * PARAMETERS.step, y, R, side, term)
    return GriddedPass(source, 1.0, points, y, R, term, R, term, np.ones(m, np.bool_), inside)


def _plain_design(item: GriddedPass, panel: Panel) -> FloatArray:
    """Return every basis function filtered over the whole pass."""
    p = panel.parameters
    R = np.clip(item.difference, -p.reach, p.reach)
    rows = [basis_functions(R, p.knots)]
    if panel.gauge is not None:
        e = gauge_at(item.points, panel) / p.gauge_unit
        coarse = basis_functions(R, p.gauge_knots)
        rows += [coarse * e, coarse * e**2]
    rows.append(item.stiffness_term[None])
    return item.side * high_pass(np.concatenate(rows), panel.grid.kernel)[:, item.inside]


@pytest.mark.parametrize("gauge", [False, True])
@pytest.mark.parametrize("side", [1, -1])
@given(seed=SEEDS, length=st.integers(5, 300), gap=st.booleans())
@settings(max_examples=20)
def test_rows_are_those_of_functions_filtered_one_by_one(
    gauge: bool,  # noqa: FBT001 - a test's switch
    side: int,
    seed: int,
    length: int,
    gap: bool,  # noqa: FBT001 - the same
) -> None:
    rng = np.random.default_rng(seed)
    inside = np.ones(length, dtype=np.bool_)
    inside[0] = False
    if gap:
        inside[length // 2] = False
    panel = Panel.of(PARAMETERS)
    if gauge:
        panel = panel.with_gauge(2e-3 * rng.standard_normal(panel.grid.points))
    item = _pass(rng, inside, side)
    rows = pass_rows(item, panel)
    wanted = _plain_design(item, panel)
    assert rows.design.shape == (panel.unknowns, np.count_nonzero(inside))
    np.testing.assert_allclose(rows.design, wanted, rtol=0, atol=3e-6 * max(1.0, float(np.abs(wanted).max())))
    np.testing.assert_array_equal(rows.points, item.points[inside])


@given(seed=SEEDS, n=st.integers(3, 60), reach=st.integers(0, 20), p=st.integers(1, 2), q=st.integers(1, 2))
@settings(max_examples=60)
def test_products_at_lags_are_those_of_shifted_signals(seed: int, n: int, reach: int, p: int, q: int) -> None:
    rng = np.random.default_rng(seed)
    reach = min(reach, n - 1)
    X, Z = rng.standard_normal((p, n)), rng.standard_normal((q, n))
    found = cross_products(X, Z, reach)
    for lag in range(-reach, reach + 1):
        first = X[:, max(0, -lag) : n - max(0, lag)]
        second = Z[:, max(0, lag) : n - max(0, -lag)]
        np.testing.assert_allclose(found[lag + reach], first @ second.T, atol=1e-12)
    own = own_products(X, reach)
    for lag in range(reach + 1):
        np.testing.assert_allclose(own[:, lag], (X[:, : n - lag] * X[:, lag:]).sum(axis=1), atol=1e-12)


@given(seed=SEEDS, n=st.integers(2, 80), count=st.integers(2, 30), finer=st.integers(1, 4), first=st.integers(-9, 9))
@settings(max_examples=60)
def test_sampling_is_interpolation_then_convolution(seed: int, n: int, count: int, finer: int, first: int) -> None:
    rng = np.random.default_rng(seed)
    step = 0.0625
    weights = local_cubic_kernel(1.5, step)
    signals, at = rng.standard_normal((3, n)), np.cumsum(rng.uniform(0.01, 0.3, n))
    found = sample_smoothed(signals, at, first, count, finer, step, weights)
    fine = np.arange(first - len(weights) // 2, first + finer * (count - 1) + len(weights) // 2 + 1) * step
    wanted = [np.convolve(np.interp(fine, at, values), weights, mode="valid")[::finer] for values in signals]
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_indices_without_a_gap_become_a_slice() -> None:
    assert as_slice(np.arange(4, 9)) == slice(4, 9)
    for index in (np.array([1, 3]), np.zeros(0, dtype=np.int64)):
        assert as_slice(index) is index
