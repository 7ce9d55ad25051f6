"""The shipped limits of the alert rules, each just inside and just outside, and what ends or hides an alert."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_facts import (
    OTHER,
    VEHICLE,
    above,
    asymmetry,
    at_km,
    conicity_at,
    facts_of,
    forecast,
    geometry_record,
    open_alert,
    trend_of,
    trend_record,
)
from wheelset_life import geometry_of, known

from estimation.alerts.rules.conicity_limit import ConicityLimitRule, SpeedBand
from estimation.alerts.rules.trend import LimitForecastRule
from estimation.alerts.rules.wheels import WheelAsymmetryRule, asymmetry_of
from estimation.values.alerts import Severity
from estimation.values.geometry import BinStatus, BinValues, WheelsetGeometry
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode


def test_conicity_is_over_its_limit_from_nine_in_ten() -> None:
    assert conicity_at(above(0.899, 0.4, 0.01)).breached is False
    assert conicity_at(above(0.901, 0.4, 0.01)).breached is True


def test_conicity_clears_where_it_is_below_the_clear_limit_with_nine_in_ten() -> None:
    assert conicity_at(above(0.101, 0.38, 0.01)).cleared is False
    assert conicity_at(above(0.099, 0.38, 0.01)).cleared is True
    assert conicity_at(above(0.5, 0.39, 0.001)).cleared is False
    assert conicity_at(above(0.5, 0.37, 0.001)).cleared is True


def test_conicity_is_critical_where_it_is_over_the_limit() -> None:
    warning, critical = conicity_at(above(0.899, 0.4, 0.01)), conicity_at(above(0.901, 0.4, 0.01))
    assert (warning.severity, warning.action) == (Severity.WARNING, "plan_reprofiling")
    assert (critical.severity, critical.action) == (Severity.CRITICAL, "reprofile")


def test_conicity_needs_three_windows() -> None:
    two, three = conicity_at(known(0.5, 0.01), 2), conicity_at(known(0.5, 0.01), 3)
    assert (two.breached, two.cleared, two.evidence["unknown_because_code"]) == (None, None, "too_few_windows")
    assert (three.breached, three.evidence["unknown_because"], three.probability) == (True, None, 1.0)


@pytest.mark.parametrize(
    ("km_h", "limit"),
    [
        (119.0, 0.4),
        (120.0, 0.4),
        (120.001, 0.534 - 120.001 / 900),
        (121.0, 0.534 - 121 / 900),
        (250.0, 0.534 - 250 / 900),
        (299.0, 0.534 - 299 / 900),
        (301.0, 0.2),
    ],
)
def test_the_limit_of_a_vehicle_is_that_of_its_greatest_speed(km_h: float, limit: float) -> None:
    vehicle = replace(VEHICLE, max_speed_m_s=km_h / 3.6)
    assert ConicityLimitRule().limit_for(vehicle) == pytest.approx(limit, abs=1e-12)


def test_a_band_lasts_to_its_speed() -> None:
    bands = (SpeedBand(0.3, 100.0), SpeedBand(0.2, vehicle_class="metro"))
    assert ConicityLimitRule(bands=bands).limit_at("metro", 90.0) == 0.2
    assert ConicityLimitRule(bands=bands).limit_at("tram", 90.0) == 0.3
    assert ConicityLimitRule(bands=bands).limit_at("tram", 101.0) is None


def test_the_conicity_judged_is_that_of_the_trend_of_this_profile() -> None:
    rule, facts = ConicityLimitRule(), facts_of()
    found = rule.find(facts, 0)
    assert found is not None
    assert (found.breached, found.evidence["quantity"], found.measured_ns) == (True, "equivalent_conicity", 500)
    low = trend_of(fitted=known(0.2, 0.01))
    for trend, breached in (
        (trend_record(low), False),
        (trend_record(low, baseline=1), True),
        (trend_record(trend_of(fitted=Estimate.unknown(OTHER))), True),
    ):
        by_trend = rule.find(replace(facts, trend=trend), 0)
        assert by_trend is not None
        assert by_trend.breached is breached
    elsewhere = replace(low, not_comparable=OTHER)  # at another amplitude than the limit
    by_geometry = rule.find(replace(facts, trend=trend_record(elsewhere)), 0)
    assert by_geometry is not None
    assert by_geometry.breached is True
    assert rule.find(replace(facts, vehicle=None), 0) is None
    assert rule.find(replace(facts, geometry=None), 0) is None
    assert replace(rule, bands=()).find(facts, 0) is None
    hidden = rule.find(replace(facts, not_assessable_reason=OTHER), 0)
    assert hidden is not None
    assert (hidden.breached, hidden.probability) == (None, None)


def test_a_limit_is_near_where_it_is_within_20_000_km_as_likely_as_not() -> None:
    assert forecast(at_km(10_000.0, 20_100.0, 90_000.0)).breached is False
    near = forecast(at_km(10_000.0, 19_900.0, 90_000.0))
    assert (near.breached, near.severity, near.cleared) == (True, Severity.WARNING, False)


def test_a_forecast_clears_where_the_limit_is_beyond_30_000_km_with_four_in_five() -> None:
    # 0.2 is a quarter of the way from p10 to p50
    assert forecast(at_km(20_000.0, 59_000.0, 90_000.0)).cleared is False
    assert forecast(at_km(20_000.0, 61_000.0, 90_000.0)).cleared is True
    assert forecast(at_km(26_000.0, 40_000.0, 90_000.0)).cleared is False
    assert forecast(at_km(28_000.0, 40_000.0, 90_000.0)).cleared is True


def test_no_conicity_at_another_amplitude_is_held_against_the_limit() -> None:
    covered = geometry_of(conicity=0.6)
    at_1_25 = replace(covered, amplitude=np.array([1.25e-3]), conicity=(known(0.6, 0.001),), reported_amplitude=1.25e-3)
    found = ConicityLimitRule().find(facts_of(geometry=geometry_record(at_1_25)), 0)
    assert found is not None
    assert (found.breached, found.cleared) == (None, None)
    assert found.evidence["unknown_because_code"] == "amplitude_not_comparable"
    ahead = forecast(replace(at_km(1.0, 2.0, 3.0), not_comparable=OTHER))
    assert (ahead.breached, ahead.cleared, ahead.evidence["unknown_because"]) == (None, None, "faulty")


def test_an_extrapolated_conicity_is_compared_with_its_interval() -> None:
    why = Reason(ReasonCode.AMPLITUDE_EXTRAPOLATED, "from 2.25 mm")
    assert conicity_at(replace(known(0.5, 0.03), reason=why)).breached is True
    assert conicity_at(replace(known(0.42, 0.03), reason=why)).breached is False


def test_a_forecast_needs_three_points_of_an_estimated_trend() -> None:
    two, three = forecast(trend_of(points=2)), forecast(trend_of())
    assert (two.breached, two.cleared, two.evidence["unknown_because_code"]) == (None, None, "too_few_points")
    assert (three.breached, three.evidence["unknown_because"]) == (True, None)
    unknown = forecast(replace(trend_of(), status=Status.UNESTIMATED, reason=OTHER))
    assert (unknown.breached, unknown.evidence["unknown_because_code"]) == (None, "sensor_faulty")


def test_a_forecast_is_of_the_trend_of_this_profile() -> None:
    rule, facts = LimitForecastRule(), facts_of(trend=trend_record(trend_of()))
    found = rule.find(facts, 0)
    assert found is not None
    assert found.breached is True
    assert rule.find(facts_of(), 0) is None
    assert rule.find(replace(facts, geometry=None), 0) is None
    assert rule.find(facts_of(trend=trend_record(trend_of(), baseline=1)), 0) is None
    hidden = rule.find(replace(facts, not_assessable_reason=OTHER), 0)
    assert hidden is not None
    assert hidden.breached is None


def side(sign: float, probability: float, limit: float, std: float) -> Estimate:
    found = above(probability, limit, std)
    assert found.value is not None
    return known(sign * found.value, std)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_limits_of_asymmetry_hold_both_ways(sign: float) -> None:
    for name, limit, clear in (("offset", 2.0e-3, 1.5e-3), ("shape", 0.5e-3, 0.35e-3)):
        std = 0.02 * limit
        assert asymmetry(**{name: side(sign, 0.949, limit, std)}).breached is False
        over = asymmetry(**{name: side(sign, 0.951, limit, std)})
        assert (over.breached, over.evidence["raised_by"]) == (True, [name])
        assert (over.raise_limit, over.clear_limit) == pytest.approx((limit * 1e3, clear * 1e3))
        assert asymmetry(**{name: side(sign, 0.101, clear, std)}).cleared is False
        assert asymmetry(**{name: side(sign, 0.099, clear, std)}).cleared is True


def test_asymmetry_needs_three_windows_and_both_indicators_to_be_none() -> None:
    assert (asymmetry(windows=2).breached, asymmetry(windows=2).evidence["unknown_because_code"]) == (
        None,
        "too_few_windows",
    )
    assert asymmetry().breached is False
    assert asymmetry(shape=Estimate.unknown(OTHER)).breached is None
    large = asymmetry(offset=known(3e-3, 1e-5), shape=Estimate.unknown(OTHER))
    assert (large.breached, large.action) == (True, "measure_wheel_diameters")
    assert asymmetry(shape=known(1e-3, 1e-5)).action == "measure_wheel_profiles"
    nothing = asymmetry(offset=Estimate.unknown(OTHER), shape=Estimate.unknown(OTHER))
    assert (nothing.breached, nothing.cleared, nothing.probability) == (None, None, None)


def test_indicators_are_shown_in_millimetres() -> None:
    shown = asymmetry(offset=Estimate(3e-3, 2e-4, 2.6e-3, 3.4e-3, 8.0, Status.ESTIMATED)).evidence["offset_mm"]
    assert isinstance(shown, dict)
    assert (shown["value"], shown["std"], shown["interval_95"], shown["n_windows"]) == (3.0, 0.2, [2.6, 3.4], 8.0)


def test_a_std_of_zero_is_certain() -> None:
    assert asymmetry(offset=known(-2.01e-3, 0.0)).probability == 1.0
    assert asymmetry(offset=known(1.99e-3, 0.0)).probability == 0.0


def test_the_shape_is_even_part_outside_against_inside() -> None:
    geometry = geometry_of(conicity=0.2, offset=1e-4, even=0.1)
    found = asymmetry_of(geometry).shape
    outer, inner = np.mean(0.1 * np.array([2.25, 2.75, 3.25]) ** 2), np.mean(0.1 * np.array([0.25, 0.75]) ** 2)
    assert found.value == pytest.approx((outer - inner) * 1e-3, rel=1e-9)
    # neighbouring bins err together: half of sqrt(2) of one bin's std, outside and inside
    assert found.std == pytest.approx(np.sqrt(2) * 0.5 * np.sqrt(2) * 2e-5, rel=1e-9)
    assert found.count == 8.0


def test_the_shape_needs_bins_on_both_sides() -> None:
    geometry = geometry_of(conicity=0.2)
    missing = replace(geometry, rolling_radius_difference=only(geometry, known_bins=1))
    assert asymmetry_of(missing).shape.reason == Reason(
        ReasonCode.TOO_FEW_BINS, "no bins of the rolling radius difference"
    )
    two = replace(geometry, rolling_radius_difference=only(geometry, known_bins=2))
    assert asymmetry_of(two).shape.reason == Reason(ReasonCode.TOO_FEW_BINS, "bins on both sides reach 0 mm")
    near = asymmetry_of(geometry_of(conicity=0.2, known_from=-1.9e-3)).shape
    assert near.reason is not None
    assert (near.reason.code, near.reason.text) == (ReasonCode.TOO_FEW_BINS, "bins on both sides reach 1.8 mm")
    assert asymmetry_of(geometry_of(conicity=0.2, known_from=-2.3e-3)).shape.status is Status.ESTIMATED


def only(geometry: WheelsetGeometry, known_bins: int) -> BinValues:
    chosen = np.arange(len(geometry.samples)) < known_bins
    status = tuple(BinStatus.ESTIMATED if one else BinStatus.TOO_FEW for one in chosen)
    return BinValues(np.where(chosen, 1e-4, np.nan), np.where(chosen, 1e-5, np.nan), status)


def test_an_alert_remembers_which_indicator_raised_it() -> None:
    unseen = facts_of(geometry=geometry_record(geometry_of(conicity=0.2)))
    rule = WheelAsymmetryRule()
    found = rule.find(unseen, 0)
    assert found is not None
    assert (found.cleared, found.measured_ns) == (True, 500)
    raised = open_alert(WheelAsymmetryRule.kind, evidence={"raised_by": ["offset"]})
    other = open_alert("conicity_limit", evidence={"raised_by": ["offset"]})
    for alerts, cleared in (((raised,), None), ((other,), True)):
        found = rule.find(replace(unseen, open_alerts=alerts), 0)
        assert found is not None
        assert found.cleared is cleared
    assert rule.find(facts_of(geometry=None), 0) is None
