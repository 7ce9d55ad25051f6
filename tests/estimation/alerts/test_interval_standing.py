"""An alert on estimates stands by all intervals of mileage: how often it was evaluated in between does not matter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from wheelset_life import DAY_NS, START_NS, geometry_of, geometry_record, known

from estimation.alerts.identity import IdentityEvent, Mistake
from estimation.alerts.life_cycle import transition
from estimation.alerts.parameters import FINDINGS
from estimation.alerts.rule_book import RuleBook, findings
from estimation.alerts.rules.conicity_limit import ConicityLimitRule
from estimation.alerts.rules.rule import AlertDelays, AlertRule, WheelsetFacts, latest_run
from estimation.alerts.rules.trend import LimitForecastRule
from estimation.alerts.rules.wheels import WheelAsymmetryRule
from estimation.trend.extrapolation import conicity_points
from estimation.trend.trend import refresh, with_step
from estimation.values.alerts import Alert, Finding, MileageNow
from estimation.values.geometry import GeometryRecord, WheelsetGeometry, interval_conicities
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, VehicleRecord, WheelsetRecord
from estimation.values.trend import TrendRecord, TrendStep

HIDDEN = Reason(ReasonCode.SENSOR_FAULTY, "faulty")
NOW_NS = START_NS + 10 * DAY_NS
WHEELSET = WheelsetRecord("W", "F", "P8", 0.45, Mounting("W", "V", 1, START_NS - 5 * DAY_NS, None, 0.0, 0.0))
VEHICLE = VehicleRecord("V", "F", "metro", 4, 100.0 / 3.6, (0.0, 2.5, 15.0, 17.5))
WORN = (0.30, 0.34, 0.38, 0.42, 0.46, 0.46)
BETWEEN = (*WORN, 0.41, 0.395, 0.39, 0.39, 0.39, 0.39)
CLEARED = (*WORN, *[0.30] * 12)


def records_of(conicities: Sequence[float]) -> list[GeometryRecord]:
    return [geometry_record("W", number, float(number), value) for number, value in enumerate(conicities)]


def facts_of(records: Sequence[GeometryRecord]) -> WheelsetFacts:
    points = conicity_points([interval_conicities(one) for one in records])
    trend = refresh(points.points, 0.4, quantity=points.quantity, not_comparable=points.not_comparable)
    return WheelsetFacts(
        wheelset=WHEELSET,
        vehicle=VEHICLE,
        geometry=replace(records[-1], interval=None),
        trend=TrendRecord("W", 0, trend, "d", "test", 1),
        windows=(),
        intervals=records,
    )


def after(alert: Alert | None, facts: WheelsetFacts, rule: AlertRule) -> Alert | None:
    facts = replace(facts, open_alerts=() if alert is None else (alert,))
    finding = next(one for one in findings(facts, RuleBook(), NOW_NS) if one.kind == rule.kind)
    change = transition(alert, finding, 0, fleet="F", delays=rule.delays)
    now = alert if change is None else change.alert
    return None if now is None or now.closed_ns is not None else now


@pytest.mark.parametrize("conicities", [WORN, BETWEEN, CLEARED, WORN[:3]])
@pytest.mark.parametrize("rule", [ConicityLimitRule(), LimitForecastRule()])
def test_evaluated_at_each_interval_or_once_the_same_alert_is_open(
    rule: AlertRule, conicities: Sequence[float]
) -> None:
    records = records_of(conicities)
    once = after(None, facts_of(records), rule)
    alert: Alert | None = None
    for end in range(2, len(records) + 1):
        alert = after(alert, facts_of(records[:end]), rule)
    late = after(after(None, facts_of([*records[:2], *records[-2:]]), rule), facts_of(records), rule)
    for one in (alert, late):
        assert (one is None) == (once is None)
        if one is not None and once is not None:
            assert (one.condition, one.severity) == (once.condition, once.severity)
            assert (one.probability, one.action) == (once.probability, once.action)


@pytest.mark.parametrize("seed", range(6))
def test_a_forecast_that_the_mileage_raised_between_two_intervals_does_not_close_at_the_next(seed: int) -> None:
    rng, rule, step_km, alert = np.random.default_rng(seed), LimitForecastRule(), 5_000.0, None
    open_after: list[bool] = []
    records: list[GeometryRecord] = []
    for number in range(30):
        conicity = 0.2 + 0.007 * number + 0.008 * float(rng.standard_normal())
        records.append(geometry_record("W", number, number * step_km / 1e3, conicity))
        if number < 4:
            continue
        facts = facts_of(records)
        for run_km in (0.0, 0.98 * step_km):
            mileage = MileageNow(records[-1].mileage_km + run_km, records[-1].to_ns + 1)
            alert = after(alert, replace(facts, mileage=mileage), rule)
            open_after.append(alert is not None)
    assert open_after[-1]
    assert open_after == sorted(open_after)


def test_few_points_behind_a_step_raised_no_forecast_earlier_either() -> None:
    records = records_of([0.30, 0.31, 0.32, 0.33])
    facts = facts_of(records)
    assert facts.trend is not None
    assert LimitForecastRule().find(facts, 0).stands is True  # type: ignore[union-attr]
    size = known(-0.2, 0.01)
    step = TrendStep(0.0, 100.0, 0, 1, 2, size, 0.5, amplitude=3e-3, probability=0.99, before=9, behind=4)
    few = replace(facts.trend, trend=with_step(facts.trend.trend, step))
    finding = LimitForecastRule().find(replace(facts, trend=few), 0)
    assert finding is not None
    assert (finding.breached, finding.stands) == (None, None)


def test_a_forecast_of_a_conicity_that_falls_clears_as_it_runs() -> None:
    falls = [0.46 - 0.004 * number for number in range(14)]  # 0.408 at the last
    records = [geometry_record("W", number, 5.0 * number, value) for number, value in enumerate(falls)]
    facts, rule = facts_of(records), LimitForecastRule()

    def after_km(run_km: float) -> Finding:
        mileage = MileageNow(records[-1].mileage_km + run_km, records[-1].to_ns + 1)
        finding = rule.find_now(replace(facts, mileage=mileage))
        assert finding is not None
        return finding

    assert after_km(0.0).breached
    assert after_km(90_000.0).cleared


def test_the_three_ways_of_wear_differ() -> None:
    rule = ConicityLimitRule()
    assert [after(None, facts_of(records_of(one)), rule) is None for one in (WORN, CLEARED, WORN[:3])] == [
        False,
        True,
        True,
    ]


def test_what_hides_the_present_state_leaves_an_alert_unknown_with_the_severity_of_the_data() -> None:
    facts = replace(facts_of(records_of(WORN)), not_assessable_reason=None)
    rule = ConicityLimitRule()
    shown = rule.find(facts, 0)
    assert shown is not None
    assert shown.evidence["unknown_because"] is None
    hidden = rule.find(replace(facts, not_assessable_reason=HIDDEN), 0)
    assert hidden is not None
    assert (hidden.breached, hidden.stands, hidden.severity) == (None, True, shown.severity)


def test_an_alert_that_is_opened_late_is_dated_by_the_interval_that_raised_it() -> None:
    records = records_of([0.30, 0.34, 0.38, *[0.46] * 9])
    in_order = [after(None, facts_of(records[:end]), ConicityLimitRule()) for end in range(2, len(records) + 1)]
    first = next(alert for alert in in_order if alert is not None)
    assert first.opened_ns < records[-1].to_ns
    assert [alert.opened_ns for alert in in_order if alert is not None] == [first.opened_ns] * in_order[::-1].index(
        None
    )


def test_no_wear_alert_is_opened_while_the_identity_is_in_doubt() -> None:
    facts = facts_of(records_of(WORN))
    event = IdentityEvent("W", Mistake.SWAPPED, "X", START_NS, START_NS, 0.2, 0.0, START_NS)
    kinds = {one.kind: one for one in findings(replace(facts, identity=event), RuleBook(), NOW_NS)}
    assert kinds["identity"].breached
    assert [kinds[kind].stands for kind in ("conicity_limit", "limit_forecast", "wheel_asymmetry")] == [None] * 3
    assert {one.kind: one.stands for one in findings(facts, RuleBook(), NOW_NS)}["conicity_limit"] is True


def test_what_no_interval_has_shown_for_long_stands_no_more() -> None:
    between = [0.45, 0.45, *[0.395] * (FINDINGS.look_back_intervals - 1)]

    def standing(conicities: Sequence[float]) -> bool | None:
        found = ConicityLimitRule().find(replace(facts_of(records_of(conicities)), trend=None), 0)
        assert found is not None
        assert found.breached is found.cleared is False
        return found.stands

    assert standing(between)
    assert not standing([*between, 0.395])


def even_of(even: float) -> WheelsetGeometry:
    return replace(geometry_of(conicity=0.2, even=even), zero_crossing=known(1e-4, 2e-4))


def test_between_the_limits_of_asymmetry_an_alert_stands_once_it_was_raised() -> None:
    def standing(evens: Sequence[float]) -> bool | None:
        records = [
            replace(geometry_record("W", number, float(number), 0.2), geometry=even_of(even))
            for number, even in enumerate(evens)
        ]
        found = WheelAsymmetryRule().find(facts_of(records), 0)
        assert found is not None
        return found.stands

    raised, between, sound = 0.1, 0.06, 0.0
    assert standing([raised, between, between])
    assert not standing([sound, between, between])
    assert standing([raised, sound])
    assert not standing([raised, sound, sound])


def found(state: str) -> Finding:
    return Finding(
        wheelset="W", kind="k", breached=state == "r", cleared=state == "c", evidence={}, action="", measured_ns=0
    )


def forwards(states: str, delays: AlertDelays) -> bool:
    raised, counted = False, 0
    for state in states:
        counted = counted + 1 if state == ("c" if raised else "r") else 0
        if counted >= (delays.off_evaluations if raised else delays.on_evaluations):
            raised, counted = not raised, 0
    return raised


@pytest.mark.parametrize("on", [1, 2, 3])
@pytest.mark.parametrize("off", [1, 2, 3])
def test_going_back_finds_what_going_forward_ends_at(on: int, off: int) -> None:
    delays = AlertDelays(on_evaluations=on, off_evaluations=off)
    for states in product("rcb", repeat=6):
        newest_first = [found(state) for state in reversed(states)]
        assert latest_run(newest_first, delays) is forwards("".join(states), delays)
