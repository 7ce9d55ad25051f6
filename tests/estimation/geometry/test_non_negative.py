"""Least squares with bounds: against Lawson and Hanson's, which frees one unknown in a step."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from estimation.geometry.sharpening import non_negative
from estimation.values.arrays import FloatArray


def drawn(seed: int, rows: int, columns: int) -> tuple[FloatArray, FloatArray]:
    """Return a system whose columns are alike, as blurred slopes are, and a right side."""
    rng = np.random.default_rng(seed)
    system = np.cumsum(rng.standard_normal((rows, columns)), axis=1)
    return system * 10.0 ** rng.uniform(-3.0, 3.0, columns), rng.standard_normal(rows)


def oracle(system: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return what Lawson and Hanson find; the first unknown has any sign."""
    found, _ = nnls(np.column_stack([system, -system[:, 0]]), wanted)
    return np.append(found[0] - found[-1], found[1:-1])


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), columns=st.integers(1, 40))
def test_the_solution_is_that_of_lawson_and_hanson(seed: int, columns: int) -> None:
    system, wanted = drawn(seed, 60, columns)
    found = non_negative(system.T @ system, system.T @ wanted, 500)
    assert found is not None
    assert (found.value[1:] >= 0.0).all()
    size = np.linalg.norm(system, axis=0)
    np.testing.assert_allclose(size * found.value, size * oracle(system, wanted), atol=1e-6)


def test_unknowns_follow_the_right_side_with_the_same_ones_free() -> None:
    system, wanted = drawn(1, 60, 20)
    found = non_negative(system.T @ system, system.T @ wanted, 500)
    assert found is not None
    assert 0 < len(found.free) < 20
    whole = found.linear(system.T)
    np.testing.assert_allclose(whole @ wanted, found.value, rtol=1e-8, atol=1e-12)
    held = np.setdiff1d(np.arange(20), found.free)
    np.testing.assert_array_equal(whole[held], 0.0)


def test_exchanges_that_do_not_suffice_give_nothing() -> None:
    system, wanted = drawn(1, 60, 20)
    gram, right = system.T @ system, system.T @ wanted
    assert non_negative(gram, right, 1) is None
    assert non_negative(gram, right, 500) is not None


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_a_matrix_that_does_not_determine_the_unknowns_gives_nothing(value: float) -> None:
    system, wanted = drawn(1, 60, 4)
    system[:, 2] = value
    assert non_negative(system.T @ system, system.T @ wanted, 500) is None
    system[:, 2] = system[:, 1]
    gram = system.T @ system
    gram[2, 1] = gram[1, 2] = gram[1, 1] * (1.0 + 1e-9)
    assert non_negative(gram, system.T @ wanted, 500) is None
