"""Standard deviations from groups and the ends of 95 % intervals, against textbook statistics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from estimation.values.quantities import Status, jackknife_std, normal_equivalent, with_interval
from estimation.values.units import NORMAL_95


@pytest.mark.parametrize("groups", [2, 3, 16])
def test_the_jackknife_of_a_mean_is_its_standard_error(groups: int) -> None:
    data = np.random.default_rng(1).standard_normal((groups, 3))
    without = (data.sum(axis=0) - data) / (groups - 1)
    replicates = np.concatenate([[data.mean(axis=0) + 5.0], without])  # the first row takes no part
    np.testing.assert_allclose(jackknife_std(replicates), data.std(axis=0, ddof=1) / np.sqrt(groups), rtol=1e-12)


def test_one_group_has_no_spread() -> None:
    assert np.isnan(jackknife_std(np.zeros((2, 4)))).all()
    assert jackknife_std(np.zeros((2, 4))).shape == (4,)
    assert normal_equivalent(np.array([3.0]), 1) == 3.0


@pytest.mark.parametrize("groups", [2, 5, 16])
def test_the_equivalent_normal_distribution_has_the_interval_of_students_t(groups: int) -> None:
    half = stats.t.interval(0.95, groups - 1)[1] * 0.7
    std = float(normal_equivalent(np.array([0.7]), groups)[0])
    assert stats.norm.interval(0.95, scale=std)[1] == pytest.approx(half)


def test_the_interval_of_a_normal_distribution() -> None:
    assert pytest.approx(stats.norm.ppf(0.975)) == NORMAL_95
    found = with_interval(2.0, 0.3, 0.4, count=7.0)
    assert (found.value, found.std, found.count, found.status) == (2.0, pytest.approx(0.5), 7.0, Status.ESTIMATED)
    low, high = stats.norm.interval(0.95, 2.0, 0.5)
    assert (found.low, found.high) == (pytest.approx(low), pytest.approx(high))
    assert with_interval(2.0, 0.3).std == pytest.approx(0.3)
    assert with_interval(2.0, 0.3).count == 1.0


@pytest.mark.parametrize("groups", [2, 12])
def test_students_t_widens_the_sampled_part_alone(groups: int) -> None:
    found = with_interval(2.0, 0.3, 0.4, groups)
    half = np.hypot(stats.t.ppf(0.975, groups - 1) * 0.3, stats.norm.ppf(0.975) * 0.4)
    assert (found.low, found.high) == (pytest.approx(2.0 - half), pytest.approx(2.0 + half))
    assert found.std == pytest.approx(0.5)
