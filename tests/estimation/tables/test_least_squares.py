"""The batch form equals the recursion on any split, and the sums are a monoid."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import padasip
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import moments as moments_of
from oracles import recursive_least_squares
from oracles.forgetting import merge, one_cell

from estimation.tables import bin_table


def _data(seed: int, n: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    features = rng.standard_normal((n, 4)) * [1.0, 30.0, 0.01, 4.0]
    features[:, 3] += 100.0
    known = rng.standard_normal(n) * 5
    theta = np.array([3.0, -0.2, 40.0, 0.7])
    measured = features @ theta + known + 0.1 * rng.standard_normal(n)
    return features, measured, known


def _theta(moments: moments_of.Moments) -> np.ndarray:
    return bin_table.solve(moments.packed, moments.weight, moments.regressors, moments.targets).theta[0, :, 0]


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10_000),
    forgetting=st.sampled_from([1.0, 0.999, 0.97]),
    cuts=st.lists(st.integers(0, 400), max_size=5),
    left_first=st.booleans(),
)
def test_any_split_equals_the_recursion(seed: int, forgetting: float, cuts: list[int], *, left_first: bool) -> None:
    features, measured, known = _data(seed)
    state = recursive_least_squares.init(features[:20], measured[:20], known[:20], forgetting)
    for x, y, omega in zip(features[20:], measured[20:], known[20:], strict=True):
        state = recursive_least_squares.update(state, x, y, omega, forgetting)
    bounds = [0, *sorted(cuts), len(measured)]
    parts = [one_cell(features[a:b], (measured - known)[a:b], forgetting) for a, b in pairwise(bounds)]
    if left_first:
        whole = parts[0]
        for part in parts[1:]:
            whole = merge(whole, part, forgetting)
    else:
        whole = parts[-1]
        for part in reversed(parts[:-1]):
            whole = merge(part, whole, forgetting)
    np.testing.assert_allclose(_theta(whole), state.theta, rtol=1e-9)
    assert whole.weight[0] == len(measured)


def test_it_equals_padasip() -> None:
    """Another's recursive filter, from a start with nearly no weight (less, and its own rounding shows)."""
    features, measured, known = _data(3)
    scaled = features / [1.0, 30.0, 0.01, 100.0]
    other = padasip.filters.FilterRLS(n=4, mu=0.999, eps=1e-7, w="zeros")
    other.run(measured - known, scaled)
    ours = _theta(one_cell(scaled, measured - known, 0.999))
    np.testing.assert_allclose(ours, other.w, rtol=1e-7)


def test_it_equals_lstsq_with_its_residual_variance() -> None:
    features, measured, known = _data(5)
    moments = one_cell(features, measured - known, 1.0)
    solution = bin_table.solve(moments.packed, moments.weight, 4, 1)
    theta, squares, _, _ = np.linalg.lstsq(features, measured - known, rcond=None)
    np.testing.assert_allclose(solution.theta[0, :, 0], theta, rtol=1e-9)
    np.testing.assert_allclose(solution.residual_variance[0], squares[0] / (400 - 4), rtol=1e-6)
    np.testing.assert_allclose(solution.inverse[0], np.linalg.inv(features.T @ features), rtol=1e-6)


def test_a_direction_that_is_not_in_the_data_is_nan() -> None:
    features, measured, _ = _data(1)
    features[:, 2] = 2 * features[:, 0]
    moments = one_cell(features, measured, 1.0)
    solution = bin_table.solve(moments.packed, moments.weight, 4, 1)
    assert np.isnan(solution.theta).all()


def test_cells_keep_to_themselves_and_negative_cells_are_dropped() -> None:
    features, measured, _ = _data(2)
    cell = np.tile([0, 1, -1, 2], 100)
    all_cells = moments_of.collect(features, measured[:, None], cell, 3)
    for c in range(3):
        alone = one_cell(features[cell == c], measured[cell == c], 1.0)
        np.testing.assert_array_equal(all_cells.packed[c], alone.packed[0])
    assert all_cells.weight.tolist() == [100, 100, 100]


@pytest.mark.parametrize(
    ("cell", "match"),
    [([0, 1], "lengths"), ([0] * 399 + [5], "cell 5")],
)
def test_mistakes_are_refused(cell: list[int], match: str) -> None:
    features, measured, _ = _data(1)
    with pytest.raises(ValueError, match=match):
        moments_of.collect(features, measured[:, None], np.array(cell), 2)
