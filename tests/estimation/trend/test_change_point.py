"""A step is parted from outliers, wear and weather, whatever the history, and from the first three points behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation.trend.change_point import CONICITY, Series, newest_change
from estimation.values.arrays import FloatArray
from estimation.values.units import DAY_NS

MODEL = CONICITY


def series(value: FloatArray, *, noise: float = 0.003, seed: int = 0, km: float = 1000.0, std: float = 0.0) -> Series:
    """Return points that are measured with noise, as stated or with another std."""
    k = len(value)
    x = km * np.arange(k, dtype=np.float64)
    measured = value + noise * np.random.default_rng(seed).standard_normal(k)
    return Series(x, x / 120_000.0 * 365.25 * DAY_NS, measured, np.full(k, std or noise))


def wear(k: int, per_km: float = 1e-6) -> FloatArray:
    return np.asarray(0.15 + per_km * 1000.0 * np.arange(k))


def stepped(history: int, behind: int, size: float) -> FloatArray:
    value = wear(history + behind)
    value[history:] += size
    return value


@pytest.mark.parametrize("history", [3, 6, 30, 240])
@pytest.mark.parametrize("size", [0.2, -0.12])
def test_three_points_behind_a_step_show_it_whatever_the_history(history: int, size: float) -> None:
    for seed in range(5):
        points = series(stepped(history, 3, size), seed=seed, noise=0.002)
        found = newest_change(points)
        assert found is not None, (history, seed)
        assert (found.last, found.first, found.before) == (history - 1, history, history)
        assert found.size == pytest.approx(size, abs=max(0.012, 3.0 * found.std))
        assert found.probability >= MODEL.sure
        assert newest_change(points.part(0, history + 2)) is None  # two points may be outliers


def test_outliers_alone_or_two_on_end_are_no_step_however_large() -> None:
    for seed in range(5):
        for where, count in ((20, 1), (20, 2), (37, 2), (38, 2), (1, 2)):
            value = wear(40)
            value[where : where + count] += 0.2
            assert newest_change(series(value, seed=seed)) is None, (seed, where)


@pytest.mark.parametrize(("share", "noticed"), [(1.8, True), (0.35, True), (0.15, False), (0.0, False)])
def test_of_three_points_one_may_be_an_outlier_if_it_has_not_come_back(share: float, noticed: bool) -> None:  # noqa: FBT001
    value = stepped(20, 4, 0.2)
    value[21] += 0.2 * (share - 1.0)
    three = series(value, noise=0.002).part(0, 23)
    assert (newest_change(three) is not None) is noticed
    assert newest_change(three, replace(MODEL, least_good=3)) is None
    assert MODEL.least_good == 2
    found = newest_change(series(value, noise=0.002))
    assert found is not None
    assert found.first == 20


@pytest.mark.parametrize("where", [0, 1, 2])
def test_one_of_a_history_of_three_may_be_an_outlier(where: int) -> None:
    value = stepped(3, 3, 0.2)
    value[where] -= 0.1
    assert newest_change(series(value, noise=0.002)) is not None


def test_three_points_that_have_no_level_in_common_are_no_step() -> None:
    value = wear(23)
    value[20:] += [0.08, 0.2, 0.14]
    assert all(newest_change(series(value, noise=0.002, seed=seed)) is None for seed in range(6))


def test_what_came_back_after_three_points_is_withdrawn() -> None:
    value = wear(40)
    value[20:23] -= 0.1
    assert newest_change(series(value).part(0, 23)) is not None
    assert newest_change(series(value)) is None


def test_an_interval_that_is_of_both_sides_is_of_neither() -> None:
    value = stepped(20, 6, 0.2)
    value[20] -= 0.1
    found = newest_change(series(value))
    assert found is not None
    assert (found.last, found.first) == (19, 21)


def test_an_interval_of_both_sides_delays_no_step_of_a_short_history() -> None:
    value = wear(8)
    value[3:] += 0.1
    value[3] -= 0.05
    points = [series(value, noise=0.006, km=8000.0, seed=seed) for seed in range(40)]
    found = [
        sum(newest_change(one, model) is not None for one in points) for model in (MODEL, replace(MODEL, widest=1))
    ]
    assert found[0] > found[1] + 4


def test_a_fall_after_three_long_intervals_is_no_wear() -> None:
    value = 0.2 + 0.01 * np.arange(7.0)
    value[3:] -= 0.1
    found = [
        [newest_change(series(value, noise=0.007, km=10_000.0, seed=seed), model) is not None for seed in range(40)]
        for model in (MODEL, replace(MODEL, slope=0.0))
    ]
    assert sum(found[0]) > sum(found[1]) + 4
    assert (MODEL.slope, MODEL.slope_std) == (1e-6, 1.2e-6)


def test_noise_is_not_taken_for_wear_that_hides_a_step() -> None:
    values = np.array([0.133, 0.154, 0.103, 0.113, 0.098, 0.12, 0.164, 0.213, 0.245, 0.229, 0.251])
    assert newest_change(series(values, noise=0.0, km=745.0, std=0.025)) is not None


@pytest.mark.parametrize(("size", "noticed"), [(0.02, False), (0.025, False), (0.06, True)])
def test_a_step_has_to_be_larger_than_what_weather_does(size: float, noticed: bool) -> None:  # noqa: FBT001
    found = [newest_change(series(stepped(40, 12, size), seed=seed, noise=0.002)) for seed in range(6)]
    assert [one is not None for one in found] == [noticed] * 6
    assert MODEL.least_size == 0.03


def test_a_bend_and_fast_wear_are_no_steps() -> None:
    bent = wear(60)
    bent[30:] += 4e-3 * np.arange(30)  # wear that is five times as fast from one interval on
    for seed in range(4):
        assert newest_change(series(bent, seed=seed)) is None
        assert newest_change(series(0.05 + 2e-3 * np.arange(60.0), seed=seed)) is None


def test_of_two_steps_the_newest_is_found() -> None:
    value = stepped(30, 30, 0.2)
    value[45:] -= 0.15
    found = newest_change(series(value))
    assert found is not None
    assert (found.first, found.before) == (45, 45)
    assert found.size == pytest.approx(-0.15, abs=0.02)


def test_points_that_are_as_noisy_as_a_step_show_none() -> None:
    assert all(newest_change(series(wear(23), noise=0.04, seed=seed)) is None for seed in range(20))


def test_a_step_is_found_where_its_probability_and_its_size_are_sure_and_not_just_below() -> None:
    points = series(stepped(12, 4, 0.1), noise=0.006, seed=1)
    found = newest_change(points)
    assert found is not None
    assert MODEL.sure == 0.8
    assert newest_change(points, replace(MODEL, sure=min(1.0, found.probability + 1e-9))) is None
    beyond = found.size - 0.8416212 * found.std  # the size that is exceeded with eight tenths
    assert newest_change(points, replace(MODEL, least_size=beyond * 0.99)) is not None
    assert newest_change(points, replace(MODEL, least_size=beyond * 1.01)) is None


def test_a_size_is_as_uncertain_as_it_is_wrong() -> None:
    z = []
    for seed in range(60):
        found = newest_change(series(stepped(25, 5, 0.15), seed=seed, noise=0.006))
        assert found is not None
        z.append((found.size - 0.15) / found.std)
    assert 0.4 < float(np.sqrt(np.mean(np.square(z)))) < 1.3
