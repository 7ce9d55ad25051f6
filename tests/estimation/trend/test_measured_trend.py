"""What measured profiles say of level and scale: as a joint normal does, never wider, and not against the estimates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.scores import Figures
from bench.trend import FITTERS, judged
from bench.wear_lives import WIDE
from estimation.trend.calibration import shared_error
from estimation.trend.parameters import CALIBRATION
from estimation.trend.points import PointColumns, columns_of
from estimation.trend.trend import TrendParameters, refresh, trend_up_to
from estimation.values.arrays import FloatArray
from estimation.values.trend import TrendPoint, TrendRecord
from estimation.values.units import DAY_NS

SCALE_STD = TrendParameters().scale_std
KM = np.linspace(0.0, 2e5, 9)
VALUE = 0.15 + 1e-6 * KM
NOISE = np.full(9, 0.004)
SHARED = np.linspace(0.01, 0.03, 9)


def points(shared: FloatArray = SHARED) -> list[TrendPoint]:
    given_ = (KM, VALUE, np.hypot(NOISE, shared), NOISE)
    return [
        TrendPoint(km, round(km / 300.0) * DAY_NS, *rest)
        for km, *rest in zip(*map(np.ndarray.tolist, given_), strict=True)
    ]


def columns(shared: FloatArray = SHARED) -> PointColumns:
    return columns_of(points(shared), 1e-6)


def measured(at: int, off: float = 0.0, std: float = 0.006, beside_km: float = 0.0) -> TrendPoint:
    """Return a profile measured beside a point, whose estimate is too high by ``off``."""
    return TrendPoint(float(KM[at]) + beside_km, 0, float(VALUE[at]) - off, std)


def by_sources(profiles: list[tuple[int, float, float]]) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of (level, scale) by the least sources that make what was seen, all independent."""
    at = np.array([number for number, _, _ in profiles])
    shared = np.concatenate([[SHARED[-2]], SHARED[at]])
    scale = np.minimum(shared, SCALE_STD * np.concatenate([[VALUE[-1]], VALUE[at]]))
    constant = np.sqrt(shared**2 - scale**2)
    far = np.subtract.outer(np.log(constant), np.log(constant))
    root = np.linalg.cholesky(np.exp(-0.5 * (far / 0.7) ** 2) + 1e-13 * np.eye(len(far)))
    of_points = np.unique(at)
    # sources: of the constants, the scale, the noise of each point, and that of each measurement
    constants = constant[:, None] * root
    seen = np.column_stack(
        [constants[1:], scale[1:], NOISE[0] * np.equal.outer(at, of_points), np.diag([std for _, _, std in profiles])]
    )
    asked = np.zeros((2, seen.shape[1]))
    asked[0, : len(constant)], asked[1, len(constant)] = constants[0], 1.0
    inverse = np.linalg.pinv(seen)
    left = np.eye(seen.shape[1]) - inverse @ seen
    return asked @ inverse @ np.array([off for _, off, _ in profiles]), asked @ left @ asked.T


@pytest.mark.parametrize(
    "profiles",
    [
        [(8, 0.02, 0.006)],
        [(0, 0.01, 0.009)],
        [(2, 0.01, 0.006), (5, 0.02, 0.0051), (8, -0.01, 0.01)],
        [(4, 0.02, 0.007), (4, 0.03, 0.007)],
    ],
)
def test_the_posterior_is_that_of_all_sources_of_error(profiles: list[tuple[int, float, float]]) -> None:
    error = shared_error(columns(), float(VALUE[-1]), SCALE_STD, [measured(*profile) for profile in profiles])
    mean, covariance = by_sources(profiles)
    np.testing.assert_allclose(error.mean, mean, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(error.covariance, covariance, rtol=1e-6, atol=1e-10)
    assert error.measured is not None
    assert error.measured.profiles == len(profiles)
    assert error.measured.shift == pytest.approx(-(mean[0] + error.of_scale * mean[1]))


@pytest.mark.parametrize(("std", "alike"), [(1e-3, True), (0.00499, True), (0.00502, False)])
def test_a_measured_conicity_is_known_to_5_thousandths_at_best(*, std: float, alike: bool) -> None:
    given_, best = (
        shared_error(columns(), float(VALUE[-1]), SCALE_STD, [measured(8, 0.01, of)]) for of in (std, 0.005)
    )
    assert np.array_equal(given_.mean, best.mean) is alike


def test_without_profiles_it_is_as_stated() -> None:
    error = shared_error(columns(), float(VALUE[-1]), SCALE_STD)
    assert error.measured is None
    np.testing.assert_array_equal(error.mean, 0.0)
    assert error.covariance[0, 0] + error.of_scale**2 == pytest.approx(SHARED[-2] ** 2)


@given(st.lists(st.tuples(st.integers(0, 8), st.floats(-0.03, 0.03), st.floats(1e-3, 0.05)), min_size=1, max_size=5))
@settings(max_examples=40, deadline=None)
def test_more_profiles_never_widen(profiles: list[tuple[int, float, float]]) -> None:
    given_ = [measured(*profile) for profile in profiles]
    stds = []
    for count in range(len(given_) + 1):
        covariance = shared_error(columns(), float(VALUE[-1]), SCALE_STD, given_[:count]).covariance
        assert np.linalg.eigvalsh(covariance)[0] > -1e-12
        stds.append(np.diag(covariance))
    assert (np.diff(stds, axis=0) <= 1e-12).all()


def test_a_profile_far_off_both_stds_is_not_used_and_is_said() -> None:
    std = float(np.hypot(np.hypot(NOISE[8], SHARED[8]), 0.006))
    for stds, used in ((3.95, 1), (4.05, 0), (-4.05, 0)):
        trend = refresh(points(), 0.4, measured=[measured(8, stds * std)])
        assert trend.calibration is not None
        assert (trend.calibration.profiles, trend.calibration.contradicting) == (used, 1 - used)
    unused, plain = trend, refresh(points(), 0.4)
    assert unused.fitted == plain.fitted
    assert unused.calibration is not None
    assert unused.calibration.shift == 0.0


@pytest.mark.parametrize(("beside_km", "used"), [(990.0, True), (-990.0, True), (1010.0, False), (-1010.0, False)])
def test_a_profile_is_held_against_a_point_within_1000_km(*, beside_km: float, used: bool) -> None:
    trend = refresh(points(), 0.4, measured=[measured(4, 0.01, beside_km=beside_km)])
    assert (trend.calibration is not None) is used


def test_errors_of_other_size_have_less_in_common() -> None:
    alike = shared_error(columns(np.full(9, 0.03)), 0.15, SCALE_STD, [measured(0, 0.01, 1e-4)])
    grown = shared_error(columns(np.geomspace(0.015, 0.03, 9)), 0.15, SCALE_STD, [measured(0, 0.01, 1e-4)])
    assert alike.measured is not None
    assert grown.measured is not None
    assert alike.measured.std < 0.3 * 0.03
    assert 0.6 * 0.03 < grown.measured.std < 0.9 * 0.03
    assert (CALIBRATION.alike_sizes, CALIBRATION.least_size) == (0.7, 1e-6)


def test_a_measured_profile_moves_level_and_forecast_and_leaves_the_points() -> None:
    plain = refresh(points(), 0.4)
    trend = refresh(points(), 0.4, measured=[measured(8, 0.02)])
    np.testing.assert_array_equal(trend.value, plain.value)
    assert trend.calibration is not None
    assert trend.fitted.value is not None
    assert plain.fitted.value is not None
    assert trend.fitted.value == pytest.approx(plain.fitted.value + trend.calibration.shift)
    assert -0.02 < trend.calibration.shift < -0.015
    assert (trend.fitted.std or 1.0) < 0.5 * (plain.fitted.std or 0.0)
    assert (trend.distance_to_limit_km.p50 or 0.0) > (plain.distance_to_limit_km.p50 or 1e9)


def test_an_outlier_beside_a_measured_profile_does_not_move_the_level() -> None:
    given_ = points()
    wrong = [replace(p, value=p.value + 0.05) if number == 5 else p for number, p in enumerate(given_)]
    shifts = []
    for every in (given_, wrong):
        trend = refresh(every, 0.4, measured=[measured(5, 0.0)])
        assert trend.calibration is not None
        assert trend.calibration.profiles == 1
        shifts.append(trend.calibration.shift)
    assert shifts[0] == pytest.approx(0.0, abs=1e-3)
    assert abs(shifts[1]) < 0.02


def test_as_of_a_mileage_only_what_was_measured_before_counts() -> None:
    trend = refresh(points(), 0.4, measured=[measured(8, 0.02), measured(3, 0.01)])
    record = TrendRecord("W", 0, trend, "d", "v", 0)
    before = trend_up_to(record, float(KM[5]), TrendParameters()).trend
    assert before.calibration is not None
    assert before.calibration.measured == (measured(3, 0.01),)
    assert trend_up_to(record, float(KM[2]), TrendParameters()).trend.calibration is None


def test_levels_beside_measured_profiles_are_sharp_and_covered() -> None:
    figures = []
    for count in (0, 1, 3):
        row = judged(replace(WIDE, classes=2, lines=3, measured=count), {"product": FITTERS["product"]}, [2001])
        figures.append(Figures.of(row["product"].level))
    wide, one, three = figures
    assert one.half < 0.35 * wide.half
    assert three.half < 0.8 * one.half
    for level in figures:
        assert 0.6 < level.z < 1.4
