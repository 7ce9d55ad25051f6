"""A wheelset trend: truth, invariance, too little data, and limits reached, near and never."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from same_values import same_values
from scipy import stats

from estimation.trend.now import probability_above, probability_ahead, probability_within
from estimation.trend.trend import TrendParameters, refresh
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.trend import TrendPoint, WearTrend
from estimation.values.units import YEAR_NS

START_NS = 1_700_000_000_000_000_000
KM_PER_YEAR = 120_000.0


def worn(n: int = 12, seed: int = 4, rate: float = 1.2e-6, std: float = 0.006) -> list[TrendPoint]:
    rng = np.random.default_rng(seed)
    mileage = np.sort(rng.uniform(200_000.0, 320_000.0, n))
    value = 0.12 + rate * (mileage - 200_000.0) + std * rng.standard_normal(n)
    when = START_NS + (mileage - 200_000.0) / KM_PER_YEAR * YEAR_NS
    return [TrendPoint(float(km), int(at), float(v), std) for km, at, v in zip(mileage, when, value, strict=True)]


def test_a_trend_holds_its_truth() -> None:
    points = worn(20)
    trend = refresh(points, 0.4)
    assert trend.status is Status.ESTIMATED
    last = points[-1].mileage_km
    for estimate, truth in (
        (trend.slope_per_1000_km, 1.2e-3),
        (trend.slope_per_year, 1.2e-6 * KM_PER_YEAR),
        (trend.fitted, 0.12 + 1.2e-6 * (last - 200_000.0)),
    ):
        assert estimate.low is not None
        assert estimate.high is not None
        assert estimate.low <= truth <= estimate.high
    true_distance = (0.4 - 0.12) / 1.2e-6 + 200_000.0 - last
    ahead = trend.distance_to_limit_km
    assert ahead.p10 is not None
    assert ahead.p50 is not None
    assert ahead.p10 < true_distance < (ahead.p90 or np.inf)
    assert ahead.p10 < ahead.p50
    assert ahead.p50 == pytest.approx(true_distance, rel=0.25)
    date = trend.date_of_limit_ns
    assert date.p50 is not None
    years = (date.p50 - points[-1].measured_ns) / YEAR_NS
    assert years == pytest.approx(ahead.p50 / KM_PER_YEAR, rel=0.05)
    assert trend.probability_over_limit == pytest.approx(0.0, abs=1e-3)


@settings(max_examples=25)
@given(st.permutations(range(12)))
def test_the_order_of_points_does_not_matter_to_the_last_bit(order: list[int]) -> None:
    points = worn()
    assert same_values(refresh([points[i] for i in order], 0.4), refresh(points, 0.4))


@settings(max_examples=15)
@given(
    scale=st.floats(0.01, 100.0),
    shift=st.floats(-50.0, 50.0),
    distance=st.floats(0.1, 10.0),
    origin=st.floats(-1e5, 1e6),
)
def test_units_and_origins_do_not_matter(scale: float, shift: float, distance: float, origin: float) -> None:
    points = worn()
    moved = [
        replace(p, mileage_km=p.mileage_km * distance + origin, value=p.value * scale + shift, std=p.std * scale)
        for p in points
    ]
    params = TrendParameters(smallest_std=0.0)
    here = refresh(points, 0.4, params)
    there = refresh(moved, 0.4 * scale + shift, replace(params, horizon_km=params.horizon_km * distance))
    slope, current = here.slope_per_1000_km, here.fitted
    for a, b, s in (
        (slope.value, there.slope_per_1000_km.value, scale / distance),
        (slope.high, there.slope_per_1000_km.high, scale / distance),
        (current.std, there.fitted.std, scale),
        (here.distance_to_limit_km.p10, there.distance_to_limit_km.p10, distance),
        (here.distance_to_limit_km.p50, there.distance_to_limit_km.p50, distance),
        (here.distance_to_limit_km.p90, there.distance_to_limit_km.p90, distance),
    ):
        assert a is not None
        assert b == pytest.approx(a * s, rel=2e-3)


@pytest.mark.parametrize(
    ("points", "params", "reason"),
    [
        ([], TrendParameters(), "0 points"),
        (worn(1), TrendParameters(), "1 point "),
        (worn(4), TrendParameters(minimum_points=5), "4 points"),
        ([TrendPoint(5.0, 1, 0.2, 0.01), TrendPoint(5.2, 2, 0.2, 0.01)], TrendParameters(), "span"),
        ([TrendPoint(5.0, 1, 0.2, 0.01), TrendPoint(900.0, 2, float("nan"), 0.01)], TrendParameters(), "1 point "),
        ([TrendPoint(5.0, 1, 0.2, 0.01), TrendPoint(900.0, 2, 0.2, 0.0)], TrendParameters(), "1 point "),
    ],
)
def test_too_little_is_unestimated_and_says_why(points: list[TrendPoint], params: TrendParameters, reason: str) -> None:
    trend = refresh(points, 0.4, params)
    assert trend.status is Status.UNESTIMATED
    assert reason in str(trend.reason)
    assert trend.slope_per_1000_km.value is None
    assert trend.distance_to_limit_km == Forecast(None, None, None)
    assert (trend.fitted.value is None) == (not points)


def test_two_points_make_a_trend_with_its_uncertainty() -> None:
    trend = refresh([TrendPoint(0.0, START_NS, 0.1, 0.005), TrendPoint(1e5, START_NS + 10**16, 0.2, 0.005)], 0.4)
    slope = trend.slope_per_1000_km
    assert trend.status is Status.ESTIMATED
    assert slope.value == pytest.approx(1e-3, rel=0.02)
    assert slope.std is not None
    assert slope.std > np.hypot(0.005, 0.005) / 100.0  # never better than the two points are


def test_points_of_one_date_still_have_a_trend_against_mileage() -> None:
    trend = refresh([replace(p, measured_ns=START_NS) for p in worn()], 0.4)
    assert trend.status is Status.ESTIMATED
    assert trend.slope_per_year.status is Status.UNESTIMATED
    assert trend.date_of_limit_ns == Forecast(None, None, None)


def test_what_is_over_the_limit_has_no_distance_left() -> None:
    trend = refresh(worn(20), 0.15)
    assert trend.distance_to_limit_km == Forecast(0.0, 0.0, 0.0)
    assert trend.date_of_limit_ns.p50 == trend.measured_ns[-1]
    assert trend.probability_over_limit == pytest.approx(1.0, abs=1e-3)


def test_no_wear_reaches_no_limit() -> None:
    trend = refresh(worn(40, rate=0.0), 0.9)
    assert trend.distance_to_limit_km.p50 is None
    assert trend.distance_to_limit_km.p90 is None


def test_a_hundred_thousand_kilometres_of_many_points() -> None:
    trend = refresh(worn(900), 0.4)
    assert trend.fitted.std is not None
    assert trend.fitted.std < 0.003
    assert trend.fitted.count > 700


def known(value: float, std: float) -> Estimate:
    return Estimate(value, std, value - 2 * std, value + 2 * std, 5.0, Status.ESTIMATED)


@given(st.floats(-1, 1), st.floats(1e-6, 1), st.floats(-1, 1))
def test_probability_above_is_the_normal_tail(value: float, std: float, limit: float) -> None:
    assert probability_above(known(value, std), limit) == pytest.approx(
        stats.norm.sf(limit, loc=value, scale=std), abs=1e-12
    )
    assert probability_above(Estimate.unknown(Reason(ReasonCode.NOT_FINITE, "no")), limit) is None


def test_probability_within_a_distance_follows_the_published_quantiles() -> None:
    trend = refresh(worn(20), 0.4)
    assert isinstance(trend, WearTrend)
    ahead = trend.distance_to_limit_km
    assert ahead.p10 is not None
    assert ahead.p50 is not None
    assert probability_within(trend, 0.0, ahead.p10) == pytest.approx(0.1, abs=1e-5)
    assert probability_within(trend, 0.25 * ahead.p50, 0.75 * ahead.p50) == pytest.approx(0.5, abs=1e-5)
    assert 0.1 < (probability_ahead(trend, 0.5 * (ahead.p10 + ahead.p50)) or 0.0) < 0.5
    assert probability_within(refresh(worn(20), 0.15), 0.0, 1.0) == pytest.approx(1.0, abs=1e-3)
    assert probability_within(refresh([], 0.15), 0.0, 1.0) is None


@settings(max_examples=60)
@given(seed=st.integers(0, 10**6), n=st.integers(2, 30), spread=st.floats(-6, 3), worst=st.floats(-8, 1))
def test_whatever_the_points_a_trend_is_finite_and_its_quantiles_are_in_order(
    seed: int, n: int, spread: float, worst: float
) -> None:
    rng = np.random.default_rng(seed)
    mileage = np.round(np.sort(rng.uniform(0.0, 10.0 ** rng.uniform(0.5, 6.0), n)), int(rng.integers(-2, 4)))
    values = 0.2 + 10.0**spread * rng.standard_normal(n)
    stds = 10.0 ** rng.uniform(worst, 1.0, n)
    trend = refresh(
        [
            TrendPoint(float(km), int(START_NS + km * 1e10), float(v), float(s))
            for km, v, s in zip(mileage, values, stds, strict=True)
        ],
        0.4,
    )
    for estimate in (trend.slope_per_1000_km, trend.slope_per_year, trend.fitted):
        numbers = (estimate.value, estimate.std, estimate.low, estimate.high)
        assert estimate.status is Status.UNESTIMATED or all(x is not None and np.isfinite(x) for x in numbers)
    ahead = trend.distance_to_limit_km
    in_order = [np.inf if q is None else q for q in (ahead.p10, ahead.p50, ahead.p90)]
    assert in_order == sorted(in_order)
