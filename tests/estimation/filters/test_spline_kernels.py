"""The compiled smoothing spline against that of scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracles.sparse_smoothing_spline import sparse_smoothing_spline

from estimation.filters import (
    PIECES,
    add_roughness,
    factorise,
    multiply,
    place,
    remove_wander,
    solve,
    subtract_smoothing_spline,
)
from estimation.values.arrays import BoolArray, FloatArray


def run_of(speed: FloatArray) -> FloatArray:
    """Return the distance run at 250 Hz, m."""
    return np.concatenate([[0.0], np.cumsum(0.002 * (speed[1:] + speed[:-1]))])


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(8, 1500),
    rows=st.integers(1, 13),
    removed=st.integers(0, 6),
    cutoff_wavelength=st.floats(10.0, 200.0),
    gaps=st.lists(st.tuples(st.integers(0, 1499), st.integers(1, 200)), max_size=4),
)
def test_the_bands_give_what_the_sparse_matrices_give(
    seed: int, n: int, rows: int, removed: int, cutoff_wavelength: float, gaps: list[tuple[int, int]]
) -> None:
    rng = np.random.default_rng(seed)
    distance = run_of(rng.uniform(8.0, 40.0) * (1.0 + 0.1 * np.sin(np.arange(n) / rng.uniform(50.0, 500.0))))
    known = np.ones(n, dtype=bool)
    for at, length in gaps:
        known[at : at + length] = False
    known[: PIECES + removed] = known[-PIECES:] = True  # what no sample shows is not compared
    signals, functions = rng.standard_normal((rows, n)), rng.standard_normal((removed, n))
    arguments = (signals, distance, known, cutoff_wavelength, functions)
    assume(removed + PIECES <= n // 2 and distance[-1] >= 0.5 * cutoff_wavelength)
    expected = sparse_smoothing_spline(*arguments)
    np.testing.assert_allclose(subtract_smoothing_spline(*arguments), expected, rtol=0.0, atol=1e-6)


def gaps_of(n: int, *gaps: tuple[int, int]) -> BoolArray:
    known = np.ones(n, dtype=bool)
    for first, behind in gaps:
        known[first:behind] = False
    return known


@pytest.mark.parametrize("gaps", [(), ((500, 540),), ((1, 30), (700, 760), (1500, 1501))])
def test_offsets_and_gaps_are_taken_out_as_by_the_sparse_matrices(gaps: tuple[tuple[int, int], ...]) -> None:
    """At constant speed the line and the parabola are splines themselves, but for what the equations are off by."""
    n, rng = 2500, np.random.default_rng(5)
    known, distance = gaps_of(n, *gaps), run_of(np.full(n, 22.0))
    signals = np.cumsum(np.cumsum(rng.standard_normal((3, n)), axis=1), axis=1)
    t = np.linspace(-1.0, 1.0, n)
    after = [(a, b) for a, b in gaps if b - a > 3]
    functions = [t, 1.5 * t * t - 0.5]
    functions += [(np.arange(n) >= b).astype(float) for _, b in after]
    functions += [np.maximum(np.arange(n) - 0.5 * (a - 1 + b), 0.0) / n for a, b in after]
    expected = sparse_smoothing_spline(signals, distance, known, 40.0, np.array(functions))
    found = remove_wander(signals, distance, known, 40.0, bridged=3)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-8 * np.abs(signals).max())


def test_places_beyond_the_last_knot_are_in_the_last_interval() -> None:
    interval, pieces = np.empty(4, np.int64), np.empty((PIECES, 4))
    place(np.array([0.0, 1.0, 1.5, 2.0]), 2.0 * (1 - 1e-12), 1.0, interval, pieces, 1)
    np.testing.assert_array_equal(interval, [0, 1, 1, 1])
    np.testing.assert_allclose(pieces.sum(axis=0), 1.0, atol=1e-15)
    np.testing.assert_allclose(pieces[:, 0], [1 / 6, 4 / 6, 1 / 6, 0.0], atol=1e-15)
    np.testing.assert_allclose(pieces[:, 3], [0.0, 1 / 6, 4 / 6, 1 / 6], atol=1e-11)


@settings(max_examples=20)
@given(seed=st.integers(0, 1000), size=st.integers(1, 40), sides=st.integers(0, 5))
def test_a_band_is_solved_as_the_whole_matrix(seed: int, size: int, sides: int) -> None:
    rng = np.random.default_rng(seed)
    band = np.zeros((size + PIECES - 1, PIECES))
    band[:, 0] = rng.uniform(1.0, 2.0, len(band))
    add_roughness(band, 3.0)
    whole = np.zeros((len(band), len(band)))
    for d in range(PIECES):
        diagonal = np.arange(len(band) - d)
        whole[diagonal, diagonal + d] = whole[diagonal + d, diagonal] = band[: len(band) - d, d]
    difference = np.diff(np.eye(len(band)), PIECES - 1, axis=0)
    np.testing.assert_allclose(whole - np.diag(np.diag(whole)), _off_diagonal(3.0 * difference.T @ difference))
    right = rng.standard_normal((sides, len(band)))
    found = right.copy()
    assert factorise(band)
    solve(band, found)
    np.testing.assert_allclose(found @ whole, right, atol=1e-10)


def _off_diagonal(matrix: FloatArray) -> FloatArray:
    return np.asarray(matrix - np.diag(np.diag(matrix)))


@pytest.mark.parametrize("n", [0, 1, 7, 8, 9, 100])
def test_long_products_take_every_sample_once(n: int) -> None:
    rng = np.random.default_rng(n)
    one, other, found = rng.standard_normal((2, n)), rng.standard_normal((3, n)), np.empty((2, 3))
    multiply(one, other, found)
    np.testing.assert_allclose(found, one @ other.T, atol=1e-12)


def test_a_distance_that_is_no_number_is_an_error() -> None:
    n = 400
    distance = run_of(np.full(n, 20.0))
    distance[100] = np.nan
    with pytest.raises(np.linalg.LinAlgError, match="do not determine"):
        subtract_smoothing_spline(np.ones((1, n)), distance, np.ones(n, dtype=bool), 40.0, np.empty((0, n)))
