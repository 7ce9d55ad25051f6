"""The limits of silence, faults and identity, and what ends or withholds an alert."""

from __future__ import annotations

from dataclasses import replace

import pytest
from plain_facts import (
    MOUNTING,
    OTHER,
    WHEELSET,
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
from scipy import stats
from wheelset_life import DAY_NS, geometry_of, known, quality, window_record
from windows_finding import silence_finding, windows_finding

from estimation.alerts.identity import IdentityEvent, Mistake
from estimation.alerts.rule_book import RuleBook, findings, superseded
from estimation.alerts.rules.rule import AlertDelays, WheelsetFacts
from estimation.alerts.rules.sensor_data import (
    IdentityRule,
    NoDataRule,
    SensorFaultRule,
    faulty,
    identity_finding,
    mounting_corrected,
)
from estimation.values.alerts import (
    CloseReason,
    Finding,
    Severity,
    estimate_evidence,
    forecast_evidence,
    number_evidence,
)
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Reprofiling
from estimation.values.windows import WindowState


def test_silence_is_reported_after_seven_days_and_critical_after_28() -> None:
    rule = NoDataRule()
    at = {days: silence_finding(rule, 0, 0, round(days * DAY_NS)) for days in (6.99, 7.01, 27.99, 28.01)}
    assert [one.breached for one in at.values()] == [False, True, True, True]
    assert [one.cleared for one in at.values()] == [True, False, False, False]
    assert [one.probability for one in at.values()] == [0.0, 1.0, 1.0, 1.0]
    assert [one.severity for one in at.values()] == [Severity.WARNING] * 3 + [Severity.CRITICAL]
    assert [one.measured_ns for one in at.values()] == [0, 7 * DAY_NS, 7 * DAY_NS, 28 * DAY_NS]
    assert [one.evidence["limit_days"] for one in at.values()] == [7.0, 7.0, 7.0, 28.0]
    assert (rule.delays.on_evaluations, rule.delays.off_evaluations) == (1, 1)


def test_silence_counts_from_data_or_mounting() -> None:
    rule, ten = NoDataRule(), 10 * DAY_NS
    assert silence_finding(rule, None, 0, ten).breached is True
    assert silence_finding(rule, 5 * DAY_NS, 0, ten).breached is False
    assert silence_finding(rule, 0, 5 * DAY_NS, ten).breached is False
    assert rule.find(facts_of(wheelset=replace(WHEELSET, mounting=None)), ten) is None
    window = replace(window_record("W", 0), start_ns=5 * DAY_NS, length_ns=DAY_NS)
    for state, breached in ((WindowState.REFUSED, True), (WindowState.ESTIMATED, False), (WindowState.PENDING, False)):
        found = rule.find(facts_of(windows=[replace(window, state=state)]), ten)
        assert found is not None
        assert found.breached is breached
    assert facts_of(windows=[window]).last_usable_ns == 6 * DAY_NS
    assert facts_of().last_usable_ns == 500
    assert facts_of(geometry=None).last_usable_ns is None


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
    return windows_finding(SensorFaultRule(), windows)


def test_the_share_of_faulty_windows_by_its_posterior() -> None:
    for bad, good in ((3, 0), (2, 1), (1, 2), (11, 9), (12, 8), (13, 7), (0, 11), (0, 14), (0, 15), (1, 19), (0, 20)):
        found, posterior = sensor(bad, good), stats.beta(bad + 1, good + 1)
        assert found.probability == pytest.approx(posterior.sf(0.5), rel=5e-3)
        assert found.breached == (posterior.sf(0.5) >= 0.8)
        assert found.cleared == (posterior.cdf(0.1) >= 0.8)
        assert found.severity is Severity.WARNING
    assert [sensor(bad, 20 - bad).breached for bad in (11, 12)] == [False, True]
    assert [sensor(0, good).cleared for good in (14, 15)] == [False, True]


@pytest.mark.parametrize("share", [0.2, 0.3, 0.4])
def test_the_sensor_clears_by_the_posterior_of_few_faults(share: float) -> None:
    rule = replace(SensorFaultRule(), clear_share=share)
    cleared = {}
    for bad in range(8):
        windows = [window_record("W", i, sensor_fault=i < bad) for i in range(20)]
        cleared[bad] = windows_finding(rule, windows).cleared
    assert cleared == {bad: stats.beta(bad + 1, 21 - bad).cdf(share) >= 0.8 for bad in range(8)}
    assert set(cleared.values()) == {True, False}


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
    assert windows_finding(SensorFaultRule(), []).measured_ns == 5
    assert SensorFaultRule().find(facts_of(wheelset=replace(WHEELSET, mounting=None)), 0) is None


def event() -> IdentityEvent:
    return IdentityEvent("W", Mistake.REVERSED, None, 10, 20, 30, 5.1234, 0.81234)


def test_an_identity_event_is_an_alert_until_the_mounting_is_corrected() -> None:
    found = identity_finding(event(), MOUNTING, None)
    assert found is not None
    assert (found.breached, found.cleared, found.measured_ns) == (True, False, 30)
    assert (found.evidence["jump"], found.evidence["left"]) == (5.12, 0.812)
    standing = open_alert(IdentityRule.kind, evidence=dict(found.evidence) | {"delays": {}})
    assert not mounting_corrected(standing, MOUNTING)
    assert mounting_corrected(standing, replace(MOUNTING, reversed=True))
    assert not mounting_corrected(replace(standing, kind="conicity_limit"), replace(MOUNTING, reversed=True))
    again = identity_finding(None, MOUNTING, standing)
    assert again is not None
    assert (again.wheelset, again.breached, again.cleared, again.evidence) == ("W", True, False, found.evidence)
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
    trend = trend_record(trend_of())
    assert breached(facts_of(trend=trend))["limit_forecast"] is True
    uneven = geometry_record(geometry_of(conicity=0.6, even=0.3))
    assert breached(facts_of(geometry=uneven))["wheel_asymmetry"] is True
    faults = [window_record("W", i, sensor_fault=True) for i in range(3)]
    assert breached(facts_of(windows=faults, trend=trend, geometry=uneven)) == {
        "sensor_fault": True,
        "no_data": False,
        "data_quality": False,
        "conicity_limit": None,
        "measure": None,
        "limit_forecast": None,
        "wheel_asymmetry": None,
        "hunting": False,
        "wheel_flat": False,
    }
    assert "sensor_fault" not in breached(facts_of(), RuleBook().with_rules(SensorFaultRule(enabled=False)))


def test_a_trend_is_not_read_as_the_present_state_where_the_newest_data_contradict_the_class() -> None:
    why = Reason(ReasonCode.YAW_SPRING_DIFFERS, "a moment of +90%")
    trend = trend_record(trend_of(fitted=known(0.6, 0.01)))
    before = facts_of(trend=trend)
    after = replace(before, geometry=geometry_record(geometry_of(conicity=0.6, even=0.3).mismatched(why)))
    of_wear = ("conicity_limit", "limit_forecast")
    assert [breached(before)[kind] for kind in of_wear] == [True, True]
    assert [breached(after)[kind] for kind in (*of_wear, "wheel_asymmetry")] == [None, None, None]
    (found,) = (one for one in findings(after, RuleBook(), 600) if one.kind == "conicity_limit")
    assert (found.evidence["unknown_because_code"], found.cleared) == ("yaw_spring_differs", None)


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
    assert book.rule(NoDataRule) == NoDataRule()
    assert book.rule(SensorFaultRule) == SensorFaultRule()
    with pytest.raises(LookupError):
        RuleBook(()).rule(NoDataRule)
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
    second = 1_000_000_000
    dated = forecast(replace(trend_of(), date_of_limit_ns=Forecast(1.5 * second + 1.0, 2.0**63, None)))
    assert dated.evidence["date_of_limit_ns"] == {"p10": 2 * second, "p50": None, "p90": None}


def test_evidence_has_no_float_noise() -> None:
    assert number_evidence(0.123456) == 0.1235
    assert number_evidence(0.123456, 2) == 0.12
    assert number_evidence(None) is None
    assert number_evidence(float("inf")) is None
    shown = estimate_evidence(Estimate(1.23456, 0.0123456, 1.0, 2.0, 5.0, Status.ESTIMATED))
    assert (shown["value"], shown["std"], shown["interval_95"]) == (1.23456, 0.0123456, [1.0, 2.0])
    assert estimate_evidence(Estimate.unknown(OTHER))["interval_95"] is None
    assert forecast_evidence(Forecast(12345.0, None, 3.14159)) == {"p10": 12345.0, "p50": None, "p90": 3.14159}
