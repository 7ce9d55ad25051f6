"""The paper's algorithm: its recursion equals the plain one, and it fails where the paper says it fails."""

from __future__ import annotations

import numpy as np
from oracles import recursive_least_squares
from smooth_wheelset import SmoothTable, ideal, run

from estimation.estimators import paper_algorithm
from estimation.estimators.paper_algorithm import jumps_elsewhere
from estimation.vehicle.vehicle_class import VehicleParameters


def test_the_compiled_recursion_is_the_plain_one() -> None:
    rng = np.random.default_rng(4)
    features = np.column_stack([rng.standard_normal((900, 2)) * [2e-3, 5e-2], np.ones(900)])
    output = features @ [3.0, -2.0, 0.5] + 0.01 * rng.standard_normal(900)
    index = rng.integers(0, 3, 900)
    parameters = paper_algorithm.PaperAlgorithm(threshold=50, forgetting=0.999)
    theta, count = paper_algorithm.recursion_in_bins(features, output, index, 4, parameters)
    assert count.tolist() == [*np.bincount(index, minlength=4).tolist()]
    assert np.isnan(theta[3]).all()
    for b in range(3):
        X, z = features[index == b], output[index == b]
        state = recursive_least_squares.init(X[:50], z[:50], np.zeros(50))
        for x, value in zip(X[50:], z[50:], strict=True):
            state = recursive_least_squares.update(state, x, float(value), 0.0, 0.999)
        np.testing.assert_allclose(theta[b], state.theta, rtol=1e-8)


def test_radius_difference_and_angle_difference_converge_and_the_angle_sum_does_not() -> None:
    found = paper_algorithm.estimate(ideal(run(200)), VehicleParameters(), paper_algorithm.PaperAlgorithm())
    table = SmoothTable()
    good = found.samples > 2000
    x = found.centre[good]
    R, D = table.left(x) - table.right(x), table.angle_left(x) - table.angle_right(x)
    A = table.angle_left(x) + table.angle_right(x)
    assert np.abs(found.rolling_radius_difference[good] - R).max() < 0.02e-3
    assert np.abs(found.contact_angle_difference[good] - D).max() < 2e-3
    assert np.median(np.abs(found.contact_angle_sum[good] - A)) > 5 * A.max()


def test_where_in_a_bin_a_jump_is_remains_unknown() -> None:
    """Each way by one std, with half of the variance; a curve without jumps stays as it is."""
    x = np.linspace(-3e-3, 3e-3, 1201)
    line, step = 0.2 * x, 0.4e-3
    ramp = step * np.clip((np.abs(x) - 1.2e-3) / 5e-6, 0.0, 1.0) * np.sign(x)
    np.testing.assert_array_equal(jumps_elsewhere(x, line, 0.1e-3), [line, line])
    further, nearer = (jumps_elsewhere(x, line + ramp, 0.1e-3) - line - ramp) * np.sqrt(2.0)
    between = {sign: (sign * x > 1.21e-3) & (sign * x < 1.29e-3) for sign in (-1, 1)}
    inside = {sign: (sign * x > 1.11e-3) & (sign * x < 1.19e-3) for sign in (-1, 1)}
    for sign in (-1, 1):
        np.testing.assert_allclose(further[between[sign]], -sign * step, rtol=0.01)
        np.testing.assert_allclose(nearer[inside[sign]], sign * step, rtol=0.01)
        np.testing.assert_allclose(further[inside[sign]], 0.0, atol=1e-12)


def test_no_jumps_are_moved_where_the_curve_has_no_zero() -> None:
    x = np.linspace(1e-3, 3e-3, 21)
    np.testing.assert_array_equal(jumps_elsewhere(x, x, 0.1e-3), [x, x])
