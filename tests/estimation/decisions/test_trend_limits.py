"""When a trend is published, and how far its forecasts go: just inside of every limit, and just outside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from estimation.trend.calibration import SharedError
from estimation.trend.now import probability_above, probability_within
from estimation.trend.trend import TrendParameters, refresh
from estimation.trend.wear_curve import fit_wear_curve
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.trend import TrendPoint, WearTrend

YEAR_NS = round(365.25 * 24 * 3600 * 1e9)
START_NS = 1_700_000_000 * 10**9
OF_SCALE = SharedError(np.zeros(2), np.diag([0.0, 1.0]), 0.0, TrendParameters().scale_std)
NOTE = Reason(ReasonCode.OTHER_AMPLITUDE, "at 2 mm")


def points(*kilometres: float, per_km: float = 1e-6, std: float = 1e-3, km_per_year: float = 1e5) -> list[TrendPoint]:
    """Return points on a line of 0.1 at the start."""
    return [TrendPoint(km, START_NS + round(km / km_per_year * YEAR_NS), 0.1 + per_km * km, std) for km in kilometres]


@pytest.mark.parametrize(
    ("given", "parameters", "code"),
    [
        (points(0.0, 1.0), TrendParameters(), None),
        (points(0.0, 0.999), TrendParameters(), ReasonCode.SPAN_TOO_SHORT),
        (points(5e4, 5e4 + 1.001), TrendParameters(), None),
        (points(5e4, 5e4 + 0.999), TrendParameters(), ReasonCode.SPAN_TOO_SHORT),
        (points(5.0), TrendParameters(), ReasonCode.TOO_FEW_POINTS),
        (points(5.0), TrendParameters(minimum_points=1), ReasonCode.TOO_FEW_POINTS),
        (points(0.0, 1e4, 2e4), TrendParameters(minimum_points=3), None),
        (points(0.0, 1e4), TrendParameters(minimum_points=3), ReasonCode.TOO_FEW_POINTS),
        ([], TrendParameters(), ReasonCode.TOO_FEW_POINTS),
    ],
)
def test_a_trend_needs_two_points_and_a_kilometre(
    given: list[TrendPoint], parameters: TrendParameters, code: ReasonCode | None
) -> None:
    trend = refresh(given, 0.4, parameters)
    assert TrendParameters().minimum_points == 2
    assert code_of(trend.reason) is code
    assert trend.status is (Status.ESTIMATED if code is None else Status.UNESTIMATED)


def test_points_that_are_not_finite_or_claim_no_std_are_left_out() -> None:
    good = points(0.0, 1e4)
    for change in ({"value": np.nan}, {"std": np.nan}, {"mileage_km": np.inf}, {"std": 0.0}, {"std": -1.0}):
        assert len(refresh([*good, replace(good[1], **change)], 0.4).value) == 2
    claimed = refresh([replace(point, std=1e-9) for point in good], 0.4)
    np.testing.assert_array_equal(claimed.std, 1e-6)


def test_too_little_is_its_last_value_with_the_reason_after_the_note() -> None:
    (only,) = points(5.0)
    trend = refresh([only], 0.1, note=NOTE)
    assert (trend.fitted.value, trend.fitted.std) == (only.value, only.std)
    assert trend.probability_over_limit == pytest.approx(stats.norm.sf(0.1, only.value, only.std))
    assert code_of(trend.reason) is ReasonCode.TOO_FEW_POINTS
    assert str(trend.reason).startswith("at 2 mm; 1 point ")
    assert trend.slope_per_1000_km.reason == trend.slope_per_year.reason == trend.reason
    nothing = refresh([], 0.1, note=NOTE)
    assert code_of(nothing.reason) is ReasonCode.OTHER_AMPLITUDE
    assert (nothing.probability_over_limit, nothing.fitted.value) == (None, None)
    assert code_of(refresh([], 0.1).reason) is ReasonCode.TOO_FEW_POINTS
    assert refresh(points(0.0, 1e4), 0.4, note=NOTE).reason == NOTE


KM = tuple(np.linspace(0.0, 1e6, 12))


@pytest.mark.parametrize(("ahead", "known"), [(480e3, True), (520e3, False)])
def test_a_forecast_goes_half_a_million_kilometres_ahead(ahead: float, *, known: bool) -> None:
    trend = refresh(points(*KM, std=1e-4), 0.1 + 1e-6 * (1e6 + ahead))
    assert (trend.distance_to_limit_km.p50 is not None) == known
    assert trend.distance_to_limit_km.p50 == (pytest.approx(ahead, rel=0.02) if known else None)


@pytest.mark.parametrize(("years", "known"), [(9.6, True), (10.4, False)])
def test_a_forecast_goes_ten_years_ahead(years: float, *, known: bool) -> None:
    given = points(*KM, std=1e-4, km_per_year=4e4)
    date = refresh(given, 0.1 + 1e-6 * (1e6 + years * 4e4)).date_of_limit_ns
    assert (date.p50 is not None) == known
    if date.p50 is not None:
        assert (date.p50 - given[-1].measured_ns) / YEAR_NS == pytest.approx(years, rel=0.02)


def test_slopes_are_per_thousand_kilometres_and_per_year() -> None:
    given = points(*KM, std=1e-4)
    trend = refresh(given[::-1], 2.0)
    curve = fit_wear_curve(np.array(KM), np.array([p.value for p in given]), np.full(12, 1e-4))
    slope = curve.less(OF_SCALE).slope_now().estimate(float(curve.share.sum()))
    found = trend.slope_per_1000_km
    for one, other in (
        (found.value, slope.value),
        (found.std, slope.std),
        (found.low, slope.low),
        (found.high, slope.high),
    ):
        assert other is not None
        assert one == pytest.approx(1000.0 * other)
    assert found.count == pytest.approx(float(curve.share.sum()))
    assert trend.slope_per_year.value == pytest.approx(0.1, rel=1e-3)  # 1e5 km a year
    assert trend.fitted.value == pytest.approx(1.1, rel=1e-3)
    assert trend.probability_over_limit == pytest.approx(0.0)


def test_forecasts_are_the_tenth_the_half_and_nine_tenths() -> None:
    given = points(*KM[:6], std=5e-3)
    limit = given[-1].value + 0.06
    trend = refresh(given, limit)
    curve = fit_wear_curve(np.array(KM[:6]), np.array([p.value for p in given]), np.full(6, 5e-3))
    curve = curve.less(OF_SCALE)
    quantiles = trend.distance_to_limit_km
    for distance, probability in ((quantiles.p10, 0.1), (quantiles.p50, 0.5), (quantiles.p90, 0.9)):
        assert distance is not None
        assert curve.level_after(distance).above(limit) == pytest.approx(probability, abs=1e-3)
    date = trend.date_of_limit_ns
    assert date.p10 is not None
    assert quantiles.p10 is not None
    assert (date.p10 - given[-1].measured_ns) / YEAR_NS == pytest.approx(quantiles.p10 / 1e5, rel=1e-3)


def test_points_of_one_date_have_no_slope_per_year() -> None:
    trend = refresh([replace(p, measured_ns=START_NS) for p in points(*KM)], 2.0)
    assert code_of(trend.slope_per_year.reason) is ReasonCode.SINGLE_DATE
    assert trend.date_of_limit_ns == Forecast(None, None, None)
    assert trend.slope_per_1000_km.status is Status.ESTIMATED


def test_dates_out_of_the_order_of_mileage_are_put_in_theirs() -> None:
    given = points(*KM, std=1e-4)
    swapped = [
        replace(p, measured_ns=q.measured_ns, mileage_km=q.mileage_km) for p, q in zip(given, given, strict=True)
    ]
    swapped[3], swapped[4] = (
        replace(swapped[3], measured_ns=given[4].measured_ns),
        replace(swapped[4], measured_ns=given[3].measured_ns),
    )
    trend = refresh(swapped, 2.0)
    assert trend.slope_per_year.value == pytest.approx(0.1, rel=0.2)
    assert trend.slope_per_1000_km.value == pytest.approx(1e-3, rel=1e-3)


def test_the_probability_above_a_limit() -> None:
    sure = Estimate(0.3, 0.0, 0.3, 0.3, 1.0, Status.ESTIMATED)
    assert (probability_above(sure, 0.29), probability_above(sure, 0.31)) == (1.0, 0.0)
    wide = replace(sure, std=0.1)
    assert probability_above(wide, 0.2) == pytest.approx(stats.norm.cdf(1.0))
    assert probability_above(Estimate.unknown(NOTE), 0.2) is None


def ahead(status: Status = Status.ESTIMATED) -> WearTrend:
    """Return a conicity that rises above the limit, and falls again."""
    trend = refresh(points(0.0, 1e4), 0.4)
    km, over = np.array([0.0, 100.0, 300.0, 500.0]), np.array([0.04, 0.1, 0.9, 0.3])
    return replace(trend, ahead_km=km, over_ahead=over, status=status)


@pytest.mark.parametrize(
    ("run", "distance", "probability"),
    [
        (0.0, 0.0, 0.04),
        (0.0, 50.0, 0.07),
        (0.0, 200.0, 0.5),
        (50.0, 150.0, 0.5),
        (0.0, 500.0, 0.9),
        (300.0, 200.0, 0.9),
        (400.0, 100.0, 0.6),
        (400.0, 9e9, 0.6),
        (900.0, 100.0, 0.3),
    ],
)
def test_the_probability_within_a_distance_is_the_greatest_on_the_way(
    run: float, distance: float, probability: float
) -> None:
    assert probability_within(ahead(), run, distance) == pytest.approx(probability)


def test_the_probability_within_a_distance_is_not_known_without_a_trend() -> None:
    assert probability_within(ahead(status=Status.UNESTIMATED), 0.0, 1.0) is None
