"""The shipped limits of the alert rules, each just inside and just outside, and what ends or hides an alert."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from wheelset_life import DAY_NS, geometry_of, known, quality, window_record

from estimation.alerts.identity import IdentityEvent, Mistake
from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.conicity_limit import ConicityLimitRule, SpeedBand, conicity_limit_finding
from estimation.alerts.rules.evaluation import findings, superseded
from estimation.alerts.rules.identity import IdentityRule, identity_finding, mounting_corrected
from estimation.alerts.rules.limit_forecast import LimitForecastRule, limit_forecast_finding
from estimation.alerts.rules.no_data import NoDataRule, no_data_finding
from estimation.alerts.rules.rule import (
    AlertDelays,
    WheelsetFacts,
    estimate_evidence,
    forecast_evidence,
    number_evidence,
)
from estimation.alerts.rules.sensor_fault import SensorFaultRule, faulty, sensor_fault_finding
from estimation.alerts.rules.wheel_asymmetry import Asymmetry, WheelAsymmetryRule, asymmetry_of, wheel_asymmetry_finding
from estimation.values.alerts import Alert, CloseReason, Condition, Finding, Severity
from estimation.values.geometry import BinStatus, BinValues, GeometryRecord, WheelsetGeometry
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, Reprofiling, VehicleRecord, WheelsetRecord
from estimation.values.trend import TrendRecord, WearTrend
from estimation.values.windows import WindowState

MOUNTING = Mounting("W", "V", 1, 100, None, 0.0, 0.0)
WHEELSET = WheelsetRecord("W", "F", "P8", 0.45, MOUNTING)
VEHICLE = VehicleRecord("V", "F", "metro", 4, 100.0 / 3.6, (0.0, 2.5, 15.0, 17.5))
OTHER = Reason(ReasonCode.SENSOR_FAULTY, "faulty")


def above(probability: float, limit: float, std: float) -> Estimate:
    """Return an estimate that is above a limit with a probability."""
    return known(limit + std * float(stats.norm.ppf(probability)), std)


def conicity_at(value: Estimate, windows: int = 3) -> Finding:
    return conicity_limit_finding(ConicityLimitRule(), "W", value, windows, 0.4, 5)


def test_conicity_is_over_its_limit_from_nine_in_ten() -> None:
    assert conicity_at(above(0.899, 0.4, 0.01)).breached is False
    assert conicity_at(above(0.901, 0.4, 0.01)).breached is True


def test_conicity_clears_where_it_is_below_the_clear_limit_with_nine_in_ten() -> None:
    assert conicity_at(above(0.101, 0.38, 0.01)).cleared is False
    assert conicity_at(above(0.099, 0.38, 0.01)).cleared is True
    assert conicity_at(above(0.5, 0.39, 0.001)).cleared is False
    assert conicity_at(above(0.5, 0.37, 0.001)).cleared is True


def test_conicity_is_critical_where_it_is_over_by_the_margin() -> None:
    warning, critical = conicity_at(above(0.899, 0.45, 0.01)), conicity_at(above(0.901, 0.45, 0.01))
    assert (warning.severity, warning.action) == (Severity.WARNING, "plan_reprofiling")
    assert (critical.severity, critical.action) == (Severity.CRITICAL, "reprofile")


def test_conicity_needs_three_windows() -> None:
    two, three = conicity_at(known(0.5, 0.01), 2), conicity_at(known(0.5, 0.01), 3)
    assert (two.breached, two.cleared, two.evidence["unknown_because_code"]) == (None, None, "too_few_windows")
    assert (three.breached, three.evidence["unknown_because"], three.probability) == (True, None, 1.0)


@pytest.mark.parametrize(
    ("km_h", "limit"),
    [(119.0, 0.4), (121.0, 0.534 - 121 / 900), (250.0, 0.534 - 250 / 900), (299.0, 0.534 - 299 / 900), (301.0, 0.2)],
)
def test_the_limit_of_a_vehicle_is_that_of_its_greatest_speed(km_h: float, limit: float) -> None:
    vehicle = replace(VEHICLE, max_speed_m_s=km_h / 3.6)
    assert ConicityLimitRule().limit_for(vehicle) == pytest.approx(limit, abs=1e-12)


def test_a_band_lasts_to_its_speed() -> None:
    bands = (SpeedBand(0.3, 100.0), SpeedBand(0.2, vehicle_class="metro"))
    assert ConicityLimitRule(bands=bands).limit_at("metro", 90.0) == 0.2
    assert ConicityLimitRule(bands=bands).limit_at("tram", 90.0) == 0.3
    assert ConicityLimitRule(bands=bands).limit_at("tram", 101.0) is None


def geometry_record(geometry: WheelsetGeometry, *, baseline: int = 0, to_ns: int = 500) -> GeometryRecord:
    return GeometryRecord("W", baseline, None, 1.0, 200, to_ns, geometry, "d", {}, {}, "test", 1)


def trend_of(*, current: Estimate | None = None, points: int = 3, probability: float | None = 0.0) -> WearTrend:
    return WearTrend(
        quantity="conicity at 2 mm",
        mileage_km=np.arange(points, dtype=float),
        measured_ns=np.arange(points),
        value=np.full(points, 0.3),
        std=np.full(points, 0.01),
        slope_per_1000_km=known(0.01, 0.001),
        slope_per_year=known(0.01, 0.001),
        current=current or known(0.3, 0.01),
        limit=0.4,
        distance_to_limit_km=Forecast(10_000.0, 20_000.0, 30_000.0),
        date_of_limit_ns=Forecast(1.0, 2.0, 3.0),
        probability_over_limit=probability,
        status=Status.ESTIMATED,
    )


def facts_of(**changes: object) -> WheelsetFacts:
    plain = WheelsetFacts(
        wheelset=WHEELSET,
        vehicle=VEHICLE,
        geometry=geometry_record(geometry_of(conicity=0.6)),
        trend=None,
        windows=(),
    )
    return replace(plain, **changes)  # type: ignore[arg-type]


def trend_record(trend: WearTrend, baseline: int = 0) -> TrendRecord:
    return TrendRecord("W", baseline, trend, "d", "test", 1)


def test_the_conicity_judged_is_that_of_the_trend_of_this_profile() -> None:
    rule, facts = ConicityLimitRule(), facts_of()
    found = rule.find(facts, 0)
    assert found is not None
    assert (found.breached, found.evidence["quantity"], found.measured_ns) == (True, "equivalent_conicity", 500)
    low = trend_of(current=known(0.2, 0.01))
    for trend, breached in (
        (trend_record(low), False),
        (trend_record(low, baseline=1), True),
        (trend_record(trend_of(current=Estimate.unknown(OTHER))), True),
    ):
        by_trend = rule.find(replace(facts, trend=trend), 0)
        assert by_trend is not None
        assert by_trend.breached is breached
    assert rule.find(replace(facts, vehicle=None), 0) is None
    assert rule.find(replace(facts, geometry=None), 0) is None
    assert replace(rule, bands=()).find(facts, 0) is None
    hidden = rule.find(replace(facts, not_assessable_reason=OTHER), 0)
    assert hidden is not None
    assert (hidden.breached, hidden.probability) == (None, None)


def forecast(trend: WearTrend) -> Finding:
    return limit_forecast_finding(LimitForecastRule(), "W", trend, 5)


def at_km(p10: float, p50: float, p90: float) -> WearTrend:
    return replace(trend_of(), distance_to_limit_km=Forecast(p10, p50, p90))


def test_a_limit_is_near_where_it_is_within_20_000_km_as_likely_as_not() -> None:
    assert forecast(at_km(10_000.0, 20_100.0, 90_000.0)).breached is False
    near = forecast(at_km(10_000.0, 19_900.0, 90_000.0))
    assert (near.breached, near.severity, near.cleared) == (True, Severity.INFO, False)


def test_a_near_limit_is_a_warning_from_four_in_five() -> None:
    # at 20 000 km between the quantiles 0.5 at 0 + and 0.9: linear
    def trend(p90: float) -> WearTrend:
        return at_km(1_000.0, 10_000.0, p90)

    exact = 10_000.0 + 0.4 / 0.3 * 10_000.0  # where 20 000 km has 0.8
    assert forecast(trend(exact + 100.0)).severity is Severity.INFO
    assert forecast(trend(exact - 100.0)).severity is Severity.WARNING


def test_a_forecast_clears_where_the_limit_is_beyond_30_000_km_with_four_in_five() -> None:
    # 0.2 is a quarter of the way from p10 to p50
    assert forecast(at_km(20_000.0, 59_000.0, 90_000.0)).cleared is False
    assert forecast(at_km(20_000.0, 61_000.0, 90_000.0)).cleared is True
    assert forecast(at_km(26_000.0, 40_000.0, 90_000.0)).cleared is False
    assert forecast(at_km(28_000.0, 40_000.0, 90_000.0)).cleared is True


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


def asymmetry(offset: Estimate | None = None, shape: Estimate | None = None, windows: int = 3) -> Finding:
    both = Asymmetry(offset or known(0.0, 1e-6), shape or known(0.0, 1e-6))
    return wheel_asymmetry_finding(WheelAsymmetryRule(), "W", both, windows, 5)


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


def test_silence_is_reported_after_seven_days_and_critical_after_28() -> None:
    rule = NoDataRule()
    at = {days: no_data_finding(rule, "W", 0, 0, round(days * DAY_NS)) for days in (6.99, 7.01, 27.99, 28.01)}
    assert [one.breached for one in at.values()] == [False, True, True, True]
    assert [one.cleared for one in at.values()] == [True, False, False, False]
    assert [one.probability for one in at.values()] == [0.0, 1.0, 1.0, 1.0]
    assert [one.severity for one in at.values()] == [Severity.WARNING] * 3 + [Severity.CRITICAL]
    assert [one.measured_ns for one in at.values()] == [0, 7 * DAY_NS, 7 * DAY_NS, 28 * DAY_NS]
    assert [one.evidence["limit_days"] for one in at.values()] == [7.0, 7.0, 7.0, 28.0]
    assert (rule.delays.on_evaluations, rule.delays.off_evaluations) == (1, 1)


def test_silence_counts_from_data_or_mounting() -> None:
    rule, ten = NoDataRule(), 10 * DAY_NS
    assert no_data_finding(rule, "W", None, 0, ten).breached is True
    assert no_data_finding(rule, "W", 5 * DAY_NS, 0, ten).breached is False
    assert no_data_finding(rule, "W", 0, 5 * DAY_NS, ten).breached is False
    assert rule.find(facts_of(wheelset=replace(WHEELSET, mounting=None)), ten) is None
    window = replace(window_record("W", 0), start_ns=5 * DAY_NS, length_ns=DAY_NS)
    for state, breached in ((WindowState.REFUSED, True), (WindowState.ESTIMATED, False), (WindowState.PENDING, False)):
        found = rule.find(facts_of(windows=[replace(window, state=state)]), ten)
        assert found is not None
        assert found.breached is breached
    assert facts_of(windows=[window]).last_usable_ns == 6 * DAY_NS


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({}, ""),
        ({"clipped": 0.049}, ""),
        ({"clipped": 0.051}, "clipping"),
        ({"invalid": 0.199}, ""),
        ({"invalid": 0.201}, "invalid_values"),
        ({"sensor_fault": True}, "self_test_or_emergency"),
    ],
)
def test_what_makes_a_window_faulty(changes: dict[str, float], what: str) -> None:
    window = replace(window_record("W", 0), quality=quality(**changes))  # type: ignore[arg-type]
    assert faulty(SensorFaultRule(), window) == what


def sensor(bad: int, good: int) -> Finding:
    windows = [window_record("W", i, sensor_fault=i < bad) for i in range(bad + good)]
    return sensor_fault_finding(SensorFaultRule(), "W", windows, 5)


def test_the_share_of_faulty_windows_by_its_posterior() -> None:
    for bad, good in ((3, 0), (2, 1), (1, 2), (11, 9), (12, 8), (13, 7), (0, 11), (0, 14), (0, 15), (1, 19), (0, 20)):
        found, posterior = sensor(bad, good), stats.beta(bad + 1, good + 1)
        assert found.probability == pytest.approx(posterior.sf(0.5), rel=5e-3)
        assert found.breached == (posterior.sf(0.5) >= 0.8)
        assert found.cleared == (posterior.cdf(0.1) >= 0.8)
        assert found.severity is Severity.WARNING
    assert [sensor(bad, 20 - bad).breached for bad in (11, 12)] == [False, True]
    assert [sensor(0, good).cleared for good in (14, 15)] == [False, True]


def test_the_sensor_is_judged_by_the_latest_twenty_windows_and_not_by_fewer_than_three() -> None:
    assert sensor(2, 0).breached is None
    assert (sensor(2, 0).cleared, sensor(2, 0).probability) == (None, None)
    assert sensor(2, 0).evidence["unknown_because_code"] == "too_few_windows"
    assert sensor(3, 0).breached is True
    old = sensor(1, 20)
    assert (old.evidence["windows"], old.evidence["faulty_windows"]) == (20, 0)
    assert sensor(1, 19).evidence["faulty_windows"] == 1
    last = window_record("W", 20)
    assert old.measured_ns == last.start_ns + last.length_ns
    assert sensor_fault_finding(SensorFaultRule(), "W", [], 5).measured_ns == 5
    assert SensorFaultRule().find(facts_of(wheelset=replace(WHEELSET, mounting=None)), 0) is None


def event() -> IdentityEvent:
    return IdentityEvent("W", Mistake.REVERSED, None, 10, 20, 30, 5.0, 0.8)


def test_an_identity_event_is_an_alert_until_the_mounting_is_corrected() -> None:
    found = identity_finding(event(), MOUNTING, None)
    assert found is not None
    assert (found.breached, found.cleared, found.measured_ns) == (True, False, 30)
    standing = open_alert(IdentityRule.kind, evidence=dict(found.evidence) | {"delays": {}})
    assert not mounting_corrected(standing, MOUNTING)
    assert mounting_corrected(standing, replace(MOUNTING, reversed=True))
    assert not mounting_corrected(replace(standing, kind="conicity_limit"), replace(MOUNTING, reversed=True))
    again = identity_finding(None, MOUNTING, standing)
    assert again is not None
    assert (again.breached, again.cleared, again.evidence) == (True, False, found.evidence)
    assert identity_finding(None, MOUNTING, None) is None


def test_the_identity_rule_keeps_a_standing_alert_of_this_mounting() -> None:
    rule = IdentityRule()
    found = rule.find(facts_of(identity=event()), 0)
    assert found is not None
    standing = replace(open_alert(IdentityRule.kind, evidence=found.evidence), opened_ns=300)
    kept = rule.find(facts_of(open_alerts=[standing]), 0)
    assert kept is not None
    assert kept.breached is True
    later = replace(MOUNTING, from_ns=301)
    assert rule.find(facts_of(open_alerts=[standing], wheelset=replace(WHEELSET, mounting=later)), 0) is None
    turned = replace(MOUNTING, reversed=True)
    assert rule.find(facts_of(open_alerts=[standing], wheelset=replace(WHEELSET, mounting=turned)), 0) is None
    moved = replace(standing, evidence=dict(found.evidence) | {"mounted": ["V", 1, 301, False]})
    assert rule.find(facts_of(open_alerts=[moved], wheelset=replace(WHEELSET, mounting=later)), 0) is None
    assert rule.find(facts_of(open_alerts=[replace(standing, kind="no_data")]), 0) is None
    assert rule.find(facts_of(identity=event(), wheelset=replace(WHEELSET, mounting=None)), 0) is None
    assert replace(rule, enabled=False).find(facts_of(identity=event()), 0) is None


def open_alert(kind: str, evidence: object = None, opened_ns: int = 200) -> Alert:
    return Alert(
        alert_id=1,
        fleet="F",
        wheelset="W",
        kind=kind,
        severity=Severity.WARNING,
        condition=Condition.ACTIVE,
        opened_ns=opened_ns,
        last_seen_ns=250,
        occurrence_count=1,
        probability=None,
        evidence=evidence or {},  # type: ignore[arg-type]
        action="",
        raise_limit=None,
        clear_limit=None,
    )


def ending(kind: str, *, opened_ns: int = 200, book: RuleBook | None = None, **wheelset: object) -> object:
    facts = facts_of(wheelset=replace(WHEELSET, **wheelset), open_alerts=[open_alert(kind, opened_ns=opened_ns)])  # type: ignore[arg-type]
    ended = superseded(facts, book or RuleBook())
    return ended[0][1:] if ended else None


def test_what_ends_an_alert_besides_the_data() -> None:
    wear, other = "conicity_limit", "no_data"
    assert ending(wear) is None
    turned = (Reprofiling("W", 210, 1.0),)
    assert ending(wear, reprofilings=turned) == (CloseReason.REPROFILED, 210)
    assert ending(other, reprofilings=turned) is None
    assert ending(wear, opened_ns=211, reprofilings=turned) is None
    assert ending(wear, mounting=None) == (CloseReason.OUT_OF_SERVICE, 250)
    assert ending(wear, opened_ns=99) == (CloseReason.WHEELSET_EXCHANGED, 100)
    assert ending(wear, opened_ns=101) is None
    assert ending(IdentityRule.kind) == (CloseReason.MOUNTING_CORRECTED, 250)
    off = RuleBook().with_rules(NoDataRule(enabled=False))
    assert ending(other, book=off) == (CloseReason.RULE_DISABLED, 250)
    assert ending(wear, book=off) is None


def breached(facts: WheelsetFacts, book: RuleBook | None = None) -> dict[str, bool | None]:
    return {one.kind: one.breached for one in findings(facts, book or RuleBook(), 600)}


def test_old_numbers_are_never_read_as_the_present_state() -> None:
    assert breached(facts_of())["conicity_limit"] is True
    assert breached(facts_of(wheelset=replace(WHEELSET, mounting=None))) == {}
    once = (Reprofiling("W", 50, 1.0),)
    old = facts_of(wheelset=replace(WHEELSET, reprofilings=once))
    assert breached(old)["conicity_limit"] is None
    current = geometry_record(geometry_of(conicity=0.6), baseline=1)
    assert breached(replace(old, geometry=current))["conicity_limit"] is True
    for at, expected in ((499, True), (500, None), (501, None)):
        mounted = replace(WHEELSET, mounting=replace(MOUNTING, from_ns=at))
        assert breached(facts_of(wheelset=mounted))["conicity_limit"] is expected
    faults = [window_record("W", i, sensor_fault=True) for i in range(3)]
    assert breached(facts_of(windows=faults)) == {
        "sensor_fault": True,
        "no_data": False,
        "conicity_limit": None,
        "wheel_asymmetry": None,
    }
    assert "sensor_fault" not in breached(facts_of(), RuleBook().with_rules(SensorFaultRule(enabled=False)))


def test_why_the_profile_cannot_be_judged() -> None:
    def why(facts: WheelsetFacts) -> object:
        return next(one for one in findings(facts, RuleBook(), 600) if one.kind == "conicity_limit").evidence[
            "unknown_because_code"
        ]

    turned = replace(WHEELSET, reprofilings=(Reprofiling("W", 50, 1.0),))
    assert why(facts_of(wheelset=turned)) == "no_geometry_since_reprofiling"
    assert why(facts_of(wheelset=replace(WHEELSET, mounting=replace(MOUNTING, from_ns=501)))) == (
        "no_data_since_mounting"
    )
    assert why(facts_of(identity=event())) == "identity_doubtful"


def test_the_shipped_delays() -> None:
    assert AlertDelays() == AlertDelays(on_evaluations=1, off_evaluations=2, acknowledgement_days=90.0)
    book = RuleBook()
    assert book.enabled("no_data")
    assert not book.enabled("gone")
    assert not book.with_rules(NoDataRule(enabled=False)).enabled("no_data")
    assert book.delays_of("no_data").off_evaluations == 1
    assert book.delays_of("conicity_limit").off_evaluations == 2
    with pytest.raises(LookupError):
        book.delays_of("gone")


def test_probabilities_are_published_with_the_digits_they_are_worth() -> None:
    assert conicity_at(above(0.98765, 0.4, 0.01)).probability == 0.988
    assert asymmetry(offset=above(0.98765, 2e-3, 1e-5)).probability == 0.988
    assert sensor(2, 2).probability == 0.5
    assert sensor(3, 1).probability == 0.812
    near = forecast(at_km(10_000.0, 17_000.0, 90_000.0))
    assert near.probability == 0.52  # 0.5 + 0.4 * 3 / 73
    assert near.evidence["distance_to_limit_km"] == {"p10": 10_000.0, "p50": 17_000.0, "p90": 90_000.0}
    dated = forecast(replace(trend_of(), date_of_limit_ns=Forecast(1234567.0, None, None)))
    assert dated.evidence["date_of_limit_ns"] == {"p10": 1234570.0, "p50": None, "p90": None}


def test_evidence_has_no_float_noise() -> None:
    assert number_evidence(0.123456) == 0.1235
    assert number_evidence(0.123456, 2) == 0.12
    assert number_evidence(None) is None
    assert number_evidence(float("inf")) is None
    shown = estimate_evidence(Estimate(1.23456, 0.0123456, 1.0, 2.0, 5.0, Status.ESTIMATED))
    assert (shown["value"], shown["std"], shown["interval_95"]) == (1.235, 0.0123, [1.0, 2.0])
    assert estimate_evidence(Estimate.unknown(OTHER))["interval_95"] is None
    assert forecast_evidence(Forecast(12345.0, None, 3.14159)) == {"p10": 12300.0, "p50": None, "p90": 3.14}
