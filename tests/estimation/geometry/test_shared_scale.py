"""Coefficients that all bins share, against all bins and samples in one dense design matrix."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from oracles.moments import collect
from paper_class import PAPER_CLASS

from estimation.geometry.model_fit import solve_with_shared_scales
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.arrays import FloatArray, IntArray
from estimation.vehicle.vehicle_class import SensorChannel

SHARED, REGRESSORS, TARGETS, BINS = 2, 5, 3, 4


@dataclass(frozen=True)
class Samples:
    """Samples of a few bins whose first coefficients are the same."""

    features: FloatArray  # (n, 5)
    targets: FloatArray  # (n, 3)
    bin: IntArray  # (n,)


def samples(seed: int, count: int = 300) -> Samples:
    rng = np.random.default_rng(seed)
    features = rng.standard_normal((count, REGRESSORS)) * [1e3, 2e2, 1.0, 4.0, 0.5]
    index = rng.integers(0, BINS, count)
    own = rng.standard_normal((BINS, REGRESSORS - SHARED))
    targets = rng.standard_normal((count, TARGETS)) * 5.0
    targets[:, 0] += features[:, :SHARED] @ [0.03, -0.01] + (features[:, SHARED:] * own[index]).sum(axis=1)
    return Samples(features, targets, index)


def design(one: Samples, bins: list[int], *, with_shared: bool) -> FloatArray:
    """Return one row per sample: shared columns, then those of each bin, zero in the rows of other bins."""
    blocks = [one.features[:, :SHARED]] if with_shared else []
    blocks += [np.where((one.bin == b)[:, None], one.features[:, SHARED:], 0.0) for b in bins]
    return np.column_stack(blocks)


def dense(one: Samples, prior_std: float, bins: list[int]) -> FloatArray:
    """Return shared and own coefficients (2 + 3 b, t) by least squares on all samples and a row for each prior."""
    used = np.isin(one.bin, bins)
    kept = Samples(one.features[used], one.targets[used], one.bin[used])
    alone = design(kept, bins, with_shared=False)
    z = kept.targets[:, 0]
    left = z - alone @ np.linalg.lstsq(alone, z, rcond=None)[0]
    noise = np.sqrt(left @ left / (len(z) - alone.shape[1]))
    whole = design(kept, bins, with_shared=True)
    prior = np.zeros((SHARED, whole.shape[1]))
    prior[:, :SHARED] = np.eye(SHARED) * noise / prior_std
    rows, targets = np.concatenate([whole, prior]), np.concatenate([kept.targets, np.zeros((SHARED, TARGETS))])
    size = np.linalg.norm(rows, axis=0)
    found: FloatArray = np.linalg.lstsq(rows / size, targets, rcond=None)[0] / size[:, None]
    return found


def packed(several: list[Samples]) -> tuple[FloatArray, FloatArray]:
    moments = [collect(one.features, one.targets, one.bin, BINS) for one in several]
    return np.stack([one.packed for one in moments]), np.stack([one.weight for one in moments])


@pytest.mark.parametrize("prior_std", [1e-4, 0.02, 1e6])
def test_it_is_the_least_squares_of_all_samples_at_once(prior_std: float) -> None:
    both = [samples(1), samples(2)]
    found = solve_with_shared_scales(*packed(both), REGRESSORS, TARGETS, (prior_std,) * SHARED)[0]
    theta = found.theta.reshape(2, BINS, REGRESSORS, TARGETS)
    for one, ours in zip(both, theta, strict=True):
        expected = dense(one, prior_std, list(range(BINS)))
        for b in range(BINS):
            own = expected[SHARED + 3 * b : SHARED + 3 * (b + 1)]
            np.testing.assert_allclose(ours[b, :SHARED], expected[:SHARED], rtol=1e-7, atol=1e-12)
            np.testing.assert_allclose(ours[b, SHARED:], own, rtol=1e-7, atol=1e-10)


def test_residuals_are_those_of_the_samples() -> None:
    one = samples(3)
    weight = packed([one])[1][0]
    found = solve_with_shared_scales(*packed([one]), REGRESSORS, TARGETS, (0.02,) * SHARED)[0]
    for b in range(BINS):
        inside = one.bin == b
        left = one.targets[inside, 0] - one.features[inside] @ found.theta[b, :, 0]
        assert found.residual_variance[b] == pytest.approx(left @ left / (weight[b] - REGRESSORS), rel=1e-9)


def test_a_bin_without_enough_samples_has_no_coefficients_and_adds_nothing() -> None:
    one = samples(4)
    few = np.flatnonzero(one.bin == 2)[:2]
    keep = np.sort(np.concatenate([np.flatnonzero(one.bin != 2), few]))
    thin = Samples(one.features[keep], one.targets[keep], one.bin[keep])
    found = solve_with_shared_scales(*packed([thin]), REGRESSORS, TARGETS, (0.02,) * SHARED)[0]
    assert np.isnan(found.theta[2]).all()
    expected = dense(thin, 0.02, [0, 1, 3])
    np.testing.assert_allclose(found.theta[0, :SHARED], expected[:SHARED], rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(found.theta[3, SHARED:], expected[-3:], rtol=1e-7, atol=1e-10)


def test_what_the_data_leave_of_the_shared_ones_moves_the_others_as_a_solution_with_these_held_does() -> None:
    one, stds, counted = samples(5), (0.02, 0.01), 50.0
    found = solve_with_shared_scales(*packed([one]), REGRESSORS, TARGETS, stds, (counted,) * SHARED)
    alone = design(one, list(range(BINS)), with_shared=False)
    of_shared = np.linalg.lstsq(alone, one.features[:, :SHARED], rcond=None)[0]
    rest = one.features[:, :SHARED] - alone @ of_shared
    z = one.targets[:, 0] - alone @ np.linalg.lstsq(alone, one.targets[:, 0], rcond=None)[0]
    noise = counted * z @ z / (len(z) - alone.shape[1])
    unknown = noise * np.linalg.inv(rest.T @ rest + noise * np.diag(np.array(stds) ** -2.0))
    for b in range(BINS):
        own, ours = of_shared[3 * b : 3 * (b + 1)], found[1][b]
        np.testing.assert_allclose(ours @ ours.T, own @ unknown @ own.T, rtol=1e-6, atol=1e-12)


def test_samples_that_say_little_leave_the_shared_ones_near_zero() -> None:
    one = samples(6)
    moments, stds = packed([one]), (0.02,) * SHARED
    near, far = (
        solve_with_shared_scales(*moments, REGRESSORS, TARGETS, stds, (counted,) * SHARED)[0].theta[0, 0, 0]
        for counted in (1e9, 1.0)
    )
    assert abs(near) < 1e-3 * abs(far)


def test_without_samples_nothing_is_known_but_what_was_known_beforehand() -> None:
    moments, weight = packed([samples(7)])
    found = solve_with_shared_scales(0.0 * moments, 0.0 * weight, REGRESSORS, TARGETS, (0.02,) * SHARED)
    assert np.isnan(found[0].theta).all()
    assert np.isnan(found[1]).all()


def test_scales_have_the_stds_on_file_and_at_least_a_fifth_of_a_percent() -> None:
    def of_sensors(yaw: float, frame: float) -> tuple[float, float, float]:
        sensors = replace(
            PAPER_CLASS.sensors, yaw=SensorChannel(scale_std=yaw), mass_lateral=SensorChannel(scale_std=frame)
        )
        return ParameterUncertainty.of(replace(PAPER_CLASS, sensors=sensors)).of_bogie

    assert of_sensors(0.0, 0.0)[:2] == pytest.approx((0.002, 0.002))
    assert of_sensors(0.03, 0.04)[:2] == pytest.approx((np.hypot(0.05, 0.002), np.hypot(0.04 * 2**0.5, 0.002)))
