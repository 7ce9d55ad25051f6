"""When a direction is in the data, and what the residual variance is divided by."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import moments

from estimation.tables import bin_table
from estimation.values.arrays import FloatArray


def packed(gram: FloatArray, cross: FloatArray, square: float) -> FloatArray:
    return np.concatenate([gram[np.triu_indices(len(gram))], cross.ravel(), [square]])[None, :]


@pytest.mark.parametrize(("smallest", "solved"), [(1.2e-10, True), (0.8e-10, False)])
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_a_direction_is_in_the_data_above_an_eigenvalue_of_ten_to_the_minus_ten(
    smallest: float, scale: float, *, solved: bool
) -> None:
    """Of the matrix with every regressor scaled to unit length: units make no difference."""
    unit = np.array([[1.0, 1.0 - smallest], [1.0 - smallest, 1.0]])
    units = np.array([scale, 1.0])
    found = bin_table.solve(packed(unit * np.outer(units, units), np.zeros((2, 1)), 1.0), np.array([9.0]), 2, 1)
    assert np.isfinite(found.theta).all() == solved
    assert np.isfinite(found.inverse).all() == solved


@pytest.mark.parametrize(("weight", "freedom"), [(12.0, 10.0), (3.5, 1.5), (3.0, 1.0), (2.0, 1.0), (1.0, 1.0)])
def test_the_residual_variance_is_over_the_degrees_of_freedom(weight: float, freedom: float) -> None:
    gram, cross = np.diag([4.0, 9.0]), np.array([[8.0], [27.0]])  # theta = 2, 3; explained = 97
    found = bin_table.solve(packed(gram, cross, 103.0), np.array([weight]), 2, 1)
    np.testing.assert_allclose(found.theta[0, :, 0], [2.0, 3.0])
    np.testing.assert_allclose(found.inverse[0], np.diag([1 / 4, 1 / 9]))
    assert found.residual_variance[0] == pytest.approx(6.0 / freedom)
    none = bin_table.solve(packed(gram, cross, 97.0 - 1e-9), np.array([weight]), 2, 1)
    assert none.residual_variance[0] == 0.0


def test_regressors_that_go_together_are_solved_for() -> None:
    X, z = np.random.default_rng(2).standard_normal((30, 3)), np.random.default_rng(3).standard_normal(30)
    X[:, 1] += 3.0 * X[:, 0]
    found = bin_table.solve(packed(X.T @ X, (X.T @ z)[:, None], float(z @ z)), np.array([30.0]), 3, 1)
    theta, rest = np.linalg.lstsq(X, z, rcond=None)[:2]
    np.testing.assert_allclose(found.theta[0, :, 0], theta)
    np.testing.assert_allclose(found.inverse[0], np.linalg.inv(X.T @ X))
    assert found.residual_variance[0] == pytest.approx(rest[0] / 27.0)


def test_a_regressor_that_is_zero_throughout_leaves_its_cell_unsolved_and_no_other() -> None:
    gram = np.diag([4.0, 0.0])
    both = np.concatenate([packed(gram, np.zeros((2, 1)), 1.0), packed(np.eye(2), np.ones((2, 1)), 2.0)])
    found = bin_table.solve(both, np.array([5.0, 5.0]), 2, 1)
    assert np.isnan(found.theta[0]).all()
    np.testing.assert_allclose(found.theta[1], 1.0)


@pytest.mark.parametrize("compiled", [True, False])
def test_the_moments_of_a_cell_are_its_products(monkeypatch: pytest.MonkeyPatch, *, compiled: bool) -> None:
    if not compiled:
        monkeypatch.setattr(moments, "_collect", moments._collect.py_func)
    rng = np.random.default_rng(1)
    X, Z = rng.standard_normal((40, 3)), rng.standard_normal((40, 2))
    cell = np.arange(40) % 4 - 1  # a quarter belongs nowhere
    found = moments.collect(X, Z, cell, 4)
    assert found.packed.shape == (4, bin_table.packed_size(3, 2)) == (4, 6 + 6 + 1)
    gram, cross, square = bin_table.unpack(found.packed, 3, 2)
    for c in range(3):
        mine = cell == c
        np.testing.assert_allclose(gram[c], X[mine].T @ X[mine])
        np.testing.assert_allclose(cross[c], X[mine].T @ Z[mine])
        assert square[c] == pytest.approx(float(Z[mine, 0] @ Z[mine, 0]))
    assert found.weight.tolist() == [10.0, 10.0, 10.0, 0.0]
    assert not found.packed[3].any()


def test_mistakes_are_refused() -> None:
    ones = np.ones((4, 1))
    for features, targets, cell in ((ones, ones[:3], 4), (ones, ones, 3), (ones[:3], ones, 4)):
        with pytest.raises(ValueError, match="lengths"):
            moments.collect(features, targets, np.zeros(cell, dtype=np.int64), 1)
    with pytest.raises(ValueError, match="cell 2 of 2"):
        moments.collect(ones, ones, np.array([0, 1, 2, 0]), 2)
    assert not moments.collect(ones[:0], ones[:0], np.zeros(0, dtype=np.int64), 2).weight.any()
