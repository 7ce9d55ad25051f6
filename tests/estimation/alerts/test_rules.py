"""Rules from values to findings, against the normal and beta distributions and at their edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from believed_now import ahead_of, believed
from scipy import stats
from wheelset_life import DAY_NS, geometry_of, known, window_record
from windows_finding import silence_finding, windows_finding

from estimation.alerts.rules.conicity_limit import ConicityLimitRule, SpeedBand, conicity_limit_finding
from estimation.alerts.rules.sensor_data import NoDataRule, SensorFaultRule
from estimation.alerts.rules.trend import LimitForecastRule, limit_forecast_finding
from estimation.alerts.rules.wheels import WheelAsymmetryRule, asymmetry_of, wheel_asymmetry_finding
from estimation.trend.now import LimitState
from estimation.trend.trend import refresh
from estimation.values.alerts import Finding, Severity
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.trend import TrendPoint, WearTrend

WHY = Reason(ReasonCode.NO_RECENT_DATA, "silent")


@pytest.mark.parametrize(
    ("speed", "limit"),
    [(80.0, 0.40), (120.0, 0.40), (121.0, 0.534 - 121.0 / 900.0), (300.0, 0.534 - 1.0 / 3.0), (301.0, 0.20)],
)
def test_the_shipped_conicity_limit_by_speed(speed: float, limit: float) -> None:
    assert ConicityLimitRule().limit_at("metro", speed) == pytest.approx(limit)


def test_a_class_of_its_own_goes_before_the_bands_of_all() -> None:
    bands = (SpeedBand(0.3, 100.0), SpeedBand(0.2), SpeedBand(0.5, 100.0, vehicle_class="freight"))
    rule = ConicityLimitRule(bands=bands)
    assert rule.limit_at("freight", 90.0) == 0.5
    assert rule.limit_at("freight", 110.0) == 0.2
    assert rule.limit_at("metro", 90.0) == 0.3
    assert ConicityLimitRule(bands=bands[:1]).limit_at("metro", 110.0) is None


@pytest.mark.parametrize(("value", "std"), [(0.44, 0.02), (0.41, 0.02), (0.385, 0.02), (0.3, 0.02), (0.5, 0.02)])
def test_conicity_is_judged_by_probability(value: float, std: float) -> None:
    rule = ConicityLimitRule()
    found = conicity_limit_finding(rule, "W", believed(LimitState(known(value, std))), 10, 5)
    over, over_clear = stats.norm.sf(0.4, value, std), stats.norm.sf(0.38, value, std)
    assert found.probability == pytest.approx(over, rel=1e-2)
    assert found.breached == (over >= 0.9)
    assert found.cleared == (1 - over_clear >= 0.9)
    assert found.severity is (Severity.CRITICAL if over >= 0.9 else Severity.WARNING)
    assert found.raise_limit == 0.4
    assert found.clear_limit == pytest.approx(0.38)


@pytest.mark.parametrize(
    ("conicity", "windows", "reason"),
    [(Estimate.unknown(WHY), 10, None), (known(0.6, 0.01), 2, None), (known(0.6, 0.01), 10, WHY)],
)
def test_conicity_that_cannot_be_said_is_unknown(conicity: Estimate, windows: int, reason: Reason | None) -> None:
    state, rule = LimitState(conicity), ConicityLimitRule()
    found = conicity_limit_finding(rule, "W", believed(state), windows, 5, not_assessable_reason=reason)
    assert (found.breached, found.cleared, found.probability) == (None, None, None)
    assert found.evidence["unknown_because"]


def forecast(rule: LimitForecastRule, trend: WearTrend, reason: Reason | None = None) -> Finding:
    now = ahead_of(geometry_of(conicity=0.2), trend)
    return limit_forecast_finding(rule, "W", trend, now, 5, not_assessable_reason=reason)


def test_a_limit_that_comes_near_is_forecast() -> None:
    points = [TrendPoint(1e4 * i, 10**15 * i, 0.1 + 0.012 * i, 0.002) for i in range(24)]  # 0.376 at the last
    trend = refresh(points, 0.4)
    assert trend.distance_to_limit_km.p50 == pytest.approx(20_000.0, rel=0.15)
    rule = LimitForecastRule(within_km=40_000.0, clear_within_km=60_000.0)
    near = forecast(rule, trend)
    assert (near.breached, near.cleared, near.severity) == (True, False, Severity.WARNING)
    far = forecast(LimitForecastRule(within_km=3_000.0, clear_within_km=4_000.0), trend)
    assert (far.breached, far.cleared) == (False, True)
    between = forecast(LimitForecastRule(within_km=3_000.0, clear_within_km=60_000.0), trend)
    assert (between.breached, between.cleared) == (False, False)
    assert forecast(rule, trend, WHY).breached is None
    assert forecast(rule, refresh(points[:2], 0.4)).breached is None
    assert forecast(rule, refresh([], 0.4)).breached is None
    never = replace(trend, distance_to_limit_km=Forecast(None, None, None), over_ahead=0.01 * trend.over_ahead)
    assert forecast(rule, never).cleared is True


def test_unequal_treads_show_in_the_even_part_whatever_the_offset() -> None:
    rule = WheelAsymmetryRule()
    for offset in (0.0, 4e-4):
        even = asymmetry_of(geometry_of(conicity=0.2, offset=offset, even=0.1))
        assert even.shape.value is not None
        # even part 0.1 y^2 (y in mm): mean over 2.25..3.25 mm minus mean over 0.25, 0.75 mm, bins of 0.5 mm
        outer = np.mean(0.1 * np.array([2.25, 2.75, 3.25]) ** 2)
        inner = np.mean(0.1 * np.array([0.25, 0.75]) ** 2)
        assert even.shape.value == pytest.approx((outer - inner) * 1e-3, rel=1e-6)
        found = wheel_asymmetry_finding(rule, "W", even, 10, 5)
        assert (found.breached, found.evidence["raised_by"]) == (True, ["shape"])
        assert found.action == "measure_wheel_profiles"
    same = asymmetry_of(geometry_of(conicity=0.2, offset=4e-4, even=0.0))
    assert same.shape.value == pytest.approx(0.0, abs=1e-12)


def test_an_offset_that_cannot_be_seen_is_unknown_and_one_that_is_large_is_found() -> None:
    rule = WheelAsymmetryRule()
    unseen = asymmetry_of(geometry_of(conicity=0.2))
    assert unseen.offset.status is Status.UNESTIMATED
    found = wheel_asymmetry_finding(rule, "W", unseen, 10, 5)
    assert (found.breached, found.cleared) == (None, True)
    for sign in (-1.0, 1.0):
        large = replace(unseen, offset=known(sign * 3e-3, 2e-4))
        assert wheel_asymmetry_finding(rule, "W", large, 10, 5).evidence["raised_by"] == ["offset"]
    small = replace(unseen, offset=known(1e-4, 2e-4))
    assert wheel_asymmetry_finding(rule, "W", small, 10, 5).breached is False


def test_an_alert_raised_by_the_offset_does_not_clear_while_the_offset_is_unseen() -> None:
    rule, unseen = WheelAsymmetryRule(), asymmetry_of(geometry_of(conicity=0.2))
    assert wheel_asymmetry_finding(rule, "W", unseen, 10, 5, raised_by=["offset"]).cleared is None
    assert wheel_asymmetry_finding(rule, "W", unseen, 10, 5, raised_by=["shape"]).cleared is True
    assert wheel_asymmetry_finding(rule, "W", unseen, 1, 5).cleared is None


def test_bins_on_one_side_only_say_nothing_of_the_shape() -> None:
    one_sided = asymmetry_of(geometry_of(conicity=0.2, known_from=-1e-3))
    assert one_sided.shape.status is Status.UNESTIMATED
    assert "0.75 mm" in str(one_sided.shape.reason)


def test_silence_counts_from_the_last_usable_data_or_from_mounting() -> None:
    rule, now = NoDataRule(days=7.0, critical_days=28.0), 100 * DAY_NS
    fresh = silence_finding(rule, 95 * DAY_NS, 0, now)
    assert (fresh.breached, fresh.cleared, fresh.measured_ns) == (False, True, 95 * DAY_NS)
    silent = silence_finding(rule, 90 * DAY_NS, 0, now)
    assert (silent.breached, silent.severity, silent.measured_ns) == (True, Severity.WARNING, 97 * DAY_NS)
    assert silence_finding(rule, 90 * DAY_NS, 0, now + 12345).evidence == silent.evidence
    assert silence_finding(rule, 60 * DAY_NS, 0, now).severity is Severity.CRITICAL
    assert silence_finding(rule, None, 99 * DAY_NS, now).breached is False
    assert silence_finding(rule, None, 50 * DAY_NS, now).breached is True
    assert silence_finding(rule, 20 * DAY_NS, 99 * DAY_NS, now).breached is False  # mounted yesterday


@pytest.mark.parametrize(("faulty", "good"), [(3, 0), (2, 0), (5, 15), (18, 2), (0, 20), (1, 19), (0, 3)])
def test_the_share_of_faulty_windows_is_judged_by_its_posterior(faulty: int, good: int) -> None:
    rule = SensorFaultRule()
    windows = [window_record("W", i, sensor_fault=i < faulty) for i in range(faulty + good)]
    found = windows_finding(rule, windows[::-1])
    if faulty + good < 3:
        assert found.breached is None
        return
    posterior = stats.beta(faulty + 1, good + 1)
    assert found.probability == pytest.approx(posterior.sf(0.5), rel=1e-2, abs=1e-9)
    assert found.breached == (posterior.sf(0.5) >= 0.8)
    assert found.cleared == (posterior.cdf(0.1) >= 0.8)


def test_only_the_latest_windows_count_and_clipping_is_a_fault_too() -> None:
    old = [window_record("W", i, sensor_fault=True) for i in range(40)]
    new = [window_record("W", 100 + i) for i in range(20)]
    assert windows_finding(SensorFaultRule(), old + new).cleared is True
    clipped = [window_record("W", 200 + i, clipped=0.2) for i in range(15)]
    invalid = [window_record("W", 300 + i, invalid=0.5) for i in range(5)]
    found = windows_finding(SensorFaultRule(), old + new + clipped + invalid)
    assert found.breached is True
    assert found.evidence["reasons"] == {"clipping": 15, "invalid_values": 5}
