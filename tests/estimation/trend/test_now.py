"""What is believed now: a trend counted on from its last point, in numbers that a reader can check by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from wheelset_life import geometry_of, known

from estimation.trend.now import SCALE, limit_now
from estimation.trend.trend import YEAR_NS, refresh
from estimation.values.alerts import LimitNow, MileageNow, Urgency
from estimation.values.quantities import Forecast, Status
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.trend import TrendPoint, WearTrend

DAY_NS = 86_400 * 10**9
LAST_KM, LAST_NS = 50_000.0, 100 * DAY_NS
LIMIT = 0.4
BELOW = geometry_of(conicity=0.2)
# over the limit with 0.1 after 10,000 km, with 0.5 after 20,000, with 0.9 after 40,000; 100, 150 and 300 days
WEARS = WearTrend(
    quantity="equivalent_conicity",
    mileage_km=np.array([0.0, 25_000.0, LAST_KM]),
    measured_ns=np.array([0, 50 * DAY_NS, LAST_NS]),
    value=np.full(3, 0.3),
    std=np.full(3, 0.01),
    noise=np.full(3, 0.01),
    slope_per_1000_km=known(0.01, 0.001),
    slope_per_year=known(0.01, 0.001),
    fitted=known(0.2, 0.01),
    limit=LIMIT,
    distance_to_limit_km=Forecast(10_000.0, 20_000.0, 40_000.0),
    date_of_limit_ns=Forecast(*(LAST_NS + days * float(DAY_NS) for days in (100, 150, 300))),
    probability_over_limit=0.0,
    status=Status.ESTIMATED,
    ahead_km=np.array([0.0, 10_000.0, 20_000.0, 40_000.0, 60_000.0]),
    over_ahead=np.array([0.0, 0.1, 0.5, 0.9, 0.9]),
)
FALLS = replace(
    WEARS,
    value=np.full(3, 0.5),
    slope_per_1000_km=known(-0.002, 0.0005),
    distance_to_limit_km=Forecast(0.0, 0.0, None),
    date_of_limit_ns=Forecast(float(LAST_NS), float(LAST_NS), None),
    probability_over_limit=0.8,
    ahead_km=np.array([0.0, 10_000.0, 60_000.0, 90_000.0]),
    over_ahead=np.array([0.8, 0.3, 0.02, 0.6]),
)


def after(trend: WearTrend, run_km: float, days: float = 0.0, conicity: float = 0.2) -> LimitNow:
    """Return what is believed so many kilometres and days behind the last point."""
    mileage = MileageNow(LAST_KM + run_km, LAST_NS + round(days * DAY_NS))
    return limit_now(geometry_of(conicity=conicity), trend, LIMIT, mileage)


def days_of(now: LimitNow) -> list[float | None]:
    date = now.date_of_limit_ns
    return [None if at is None else (at - LAST_NS) / DAY_NS for at in (date.p10, date.p50, date.p90)]


def test_at_its_last_point_it_is_the_trend_itself() -> None:
    now = after(WEARS, 0.0)
    assert now.probability_over_limit == 0.0
    assert now.distance_to_limit_km == WEARS.distance_to_limit_km
    assert days_of(now) == [100.0, 150.0, 300.0]
    assert now.forecast_reason is None


@pytest.mark.parametrize(
    ("run_km", "days", "over", "distance", "dates"),
    [
        # half the way to p10 is run: half of its time is left, from now on
        (5_000.0, 60.0, 0.05, [5_000.0, 15_000.0, 35_000.0], [60 + 50, 60 + 112.5, 60 + 262.5]),
        (10_000.0, 60.0, 0.1, [0.0, 10_000.0, 30_000.0], [60, 60 + 75, 60 + 225]),
        # it stood in between: nothing is due only because days have passed
        (15_000.0, 900.0, 0.3, [0.0, 5_000.0, 25_000.0], [900, 900 + 37.5, 900 + 187.5]),
        (20_000.0, 200.0, 0.5, [0.0, 0.0, 20_000.0], [200, 200, 200 + 150]),
        (45_000.0, 400.0, 0.9, [0.0, 0.0, 0.0], [400, 400, 400]),
        (99_000.0, 400.0, 0.9, [0.0, 0.0, 0.0], [400, 400, 400]),
    ],
)
def test_what_it_has_run_since_is_taken_off(
    run_km: float, days: float, over: float, distance: list[float], dates: list[float]
) -> None:
    now = after(WEARS, run_km, days)
    assert now.since_trend_km == run_km
    assert now.probability_over_limit == pytest.approx(over)
    ahead = now.distance_to_limit_km
    assert [ahead.p10, ahead.p50, ahead.p90] == pytest.approx(distance)
    assert days_of(now) == pytest.approx(dates)


def test_a_mileage_below_that_of_the_last_point_counts_from_that_point() -> None:
    now = after(WEARS, -4_000.0, -10.0)
    assert (now.since_trend_km, now.distance_to_limit_km) == (0.0, WEARS.distance_to_limit_km)
    assert days_of(now) == [100.0, 150.0, 300.0]


def test_a_conicity_that_falls_leaves_the_limit_behind_and_may_come_back_to_it() -> None:
    first = after(FALLS, 0.0, conicity=0.5)
    assert SCALE.over(first.probability_over_limit) is not None
    later = after(FALLS, 60_000.0, conicity=0.5)  # its last geometry was over the limit
    assert later.probability_over_limit == pytest.approx(0.02)
    # 0.1 is reached again after 0.08 of the 0.58 between the nodes at 60,000 and 90,000 km, 0.5 after 0.48
    distance = later.distance_to_limit_km
    assert (distance.p10, distance.p50) == (pytest.approx(3e4 * 0.08 / 0.58), pytest.approx(3e4 * 0.48 / 0.58))
    assert distance.p90 is None
    assert code_of(later.forecast_reason) is ReasonCode.BEYOND_HORIZON


@pytest.mark.parametrize(("conicity_std", "over"), [(0.0779, 0.9), (0.0780, 0.9), (0.0781, 0.05)])
def test_what_the_data_say_by_themselves_counts_from_where_the_alert_is_raised(
    conicity_std: float, over: float
) -> None:
    # two last points at 0.5 are over 0.4 with 0.9 where their standard deviation is 0.078
    over_it = replace(WEARS, value=np.full(3, 0.5), std=np.full(3, conicity_std))
    assert after(over_it, 5_000.0).probability_over_limit == pytest.approx(over, abs=1e-3)


def test_a_probability_that_sinks_because_the_forecast_widens_leaves_the_data_in_force() -> None:
    widens = replace(WEARS, value=np.full(3, 0.5), over_ahead=np.array([0.92, 0.88, 0.8, 0.7, 0.6]))
    assert [after(widens, run_km).probability_over_limit for run_km in (0.0, 1.0, 40_000.0)] == pytest.approx([1.0] * 3)
    surely_falls = replace(widens, slope_per_1000_km=known(-0.002, 0.001))
    assert after(surely_falls, 1.0).probability_over_limit == pytest.approx(0.92, abs=1e-3)
    perhaps_falls = replace(widens, slope_per_1000_km=known(-0.002, 0.00103))
    assert after(perhaps_falls, 1.0).probability_over_limit == pytest.approx(1.0)


def test_the_data_count_from_the_probability_at_which_the_rule_raises_its_alert() -> None:
    # two last points at 0.5 with a standard deviation of 0.1 are over 0.4 with 0.84
    over_it = replace(WEARS, value=np.full(3, 0.5), std=np.full(3, 0.1))
    assert after(over_it, 0.0).probability_over_limit == 0.0
    assert after(replace(over_it, raise_probability=0.8), 0.0).probability_over_limit == pytest.approx(0.841, abs=1e-3)


@given(st.floats(0.0, 3e5), st.integers(0, 7))
def test_probability_and_distance_agree_on_every_trend(run_km: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    km = np.sort(rng.uniform(0.0, LAST_KM, 12))
    value = 0.25 + 2e-6 * km + 0.01 * rng.standard_normal(12)
    points = [TrendPoint(float(at), round(at / 1e5 * YEAR_NS), float(v), 0.01) for at, v in zip(km, value, strict=True)]
    trend = refresh(points, LIMIT)
    mileage = MileageNow(points[-1].mileage_km + run_km, points[-1].measured_ns + round(run_km / 1e5 * YEAR_NS))
    now = limit_now(BELOW, trend, LIMIT, mileage)
    assert now.probability_over_limit is not None
    assert now.probability_over_limit == pytest.approx(np.interp(run_km, trend.ahead_km, trend.over_ahead))
    for far, probability in zip(
        (now.distance_to_limit_km.p10, now.distance_to_limit_km.p50, now.distance_to_limit_km.p90),
        (0.1, 0.5, 0.9),
        strict=True,
    ):
        assert (far == 0.0) == (now.probability_over_limit >= probability)
    ordered = [9e9 if far is None else far for far in (now.distance_to_limit_km.p10, now.distance_to_limit_km.p50)]
    assert ordered == sorted(ordered)
    assert SCALE.over(now.probability_over_limit) in {None, Urgency.OVER_LIMIT, Urgency.PROBABLY_OVER}
    date = now.date_of_limit_ns
    assert all(at is None or at >= float(mileage.at_ns) for at in (date.p10, date.p50, date.p90))
