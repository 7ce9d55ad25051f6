"""The paper's algorithm: its recursion equals the plain one, and it fails where the paper says it fails."""

from __future__ import annotations

import numpy as np
from oracles import recursive_least_squares
from smooth_wheelset import SmoothTable, ideal, run

from estimation.estimators import paper_equations


def test_the_compiled_recursion_is_the_plain_one() -> None:
    rng = np.random.default_rng(4)
    features = np.column_stack([rng.standard_normal((900, 2)) * [2e-3, 5e-2], np.ones(900)])
    output = features @ [3.0, -2.0, 0.5] + 0.01 * rng.standard_normal(900)
    index = rng.integers(0, 3, 900)
    parameters = paper_equations.PaperParameters(threshold=50, forgetting=0.999)
    theta, count = paper_equations.recursion_in_bins(features, output, index, 4, parameters)
    assert count.tolist() == [*np.bincount(index, minlength=4).tolist()]
    assert np.isnan(theta[3]).all()
    for b in range(3):
        X, z = features[index == b], output[index == b]
        state = recursive_least_squares.init(X[:50], z[:50], np.zeros(50))
        for x, value in zip(X[50:], z[50:], strict=True):
            state = recursive_least_squares.update(state, x, float(value), 0.0, 0.999)
        np.testing.assert_allclose(theta[b], state.theta, rtol=1e-8)


def test_radius_difference_and_angle_difference_converge_and_the_angle_sum_does_not() -> None:
    found = paper_equations.estimate(ideal(run(200)), paper_equations.PaperParameters())
    table = SmoothTable()
    good = found.samples > 2000
    x = found.centre[good]
    R, D = table.left(x) - table.right(x), table.angle_left(x) - table.angle_right(x)
    A = table.angle_left(x) + table.angle_right(x)
    assert np.abs(found.rolling_radius_difference[good] - R).max() < 0.02e-3
    assert np.abs(found.contact_angle_difference[good] - D).max() < 2e-3
    assert np.median(np.abs(found.contact_angle_sum[good] - A)) > 5 * A.max()
