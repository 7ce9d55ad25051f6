"""Delays in kilometres: decided by the mileage of the data, whatever order they came in and however often evaluated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wheelset_life import START_NS, window_record

from estimation.alerts.life_cycle import transition
from estimation.alerts.parameters import FINDINGS
from estimation.alerts.rules.rule import AlertDelays, WheelsetFacts, began, latest_run, raised_at, within_reach
from estimation.alerts.rules.sensor_data import SensorFaultRule
from estimation.values.alerts import Alert, Condition, Finding, Severity
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, WheelsetRecord
from estimation.values.windows import WindowRecord

WHEELSET = WheelsetRecord("W", "F", "P8", 0.45, Mounting("W", "V", 1, START_NS, None, 0.0, 0.0))
BREACHED, CLEARED, BETWEEN, UNDECIDED = "b", "c", "-", "?"


def found(what: str, number: int, km: float | None) -> Finding:
    decided = what != UNDECIDED
    return Finding(
        wheelset="W",
        kind="sensor_fault",
        breached=what == BREACHED if decided else None,
        cleared=what == CLEARED if decided else None,
        severity=Severity.WARNING,
        probability=None,
        evidence={},
        action="",
        raise_limit=None,
        clear_limit=None,
        measured_ns=number,
        mileage_km=km,
    )


def run_of(text: str, every_km: float = 10.0) -> list[Finding]:
    return [found(what, number, number * every_km) for number, what in enumerate(text)]


KM = AlertDelays(on_evaluations=1000, off_evaluations=1000, on_delay_km=30.0, off_delay_km=20.0)


@pytest.mark.parametrize(
    ("text", "since"),
    [
        ("bbb", None),  # 20 km
        ("bbbb", 3),  # 30 km, both ends of the breach included
        ("bb-bbb", None),  # what is between begins it again
        ("bb?bb", 3),  # what decides nothing does not
        ("bbbbcc", 3),
        ("bbbbccc", None),  # 20 km beyond the clear limit
        ("bbbbcc-cc", 3),
        ("bbbbcccbbbb", 10),
    ],
)
def test_a_run_of_findings_must_cover_the_distance(text: str, since: int | None) -> None:
    findings = run_of(text)
    deciding = [one for one in findings if one.breached is not None]
    assert raised_at(findings, KM) == since
    assert latest_run(reversed(deciding), KM) is (since is not None)


def test_the_distance_is_that_run_not_how_often_somebody_looked() -> None:
    rare, dense = run_of("bb", 30.0), run_of("b" * 31, 1.0)
    assert raised_at(rare, KM) == 1
    assert raised_at(dense, KM) == 30
    assert raised_at(dense[:30], KM) is None
    mixed = AlertDelays(on_evaluations=3, off_evaluations=1, off_delay_km=20.0)  # one in evaluations, one in kilometres
    assert raised_at(run_of("bbbcc"), mixed) == 2
    assert raised_at(run_of("bbbccc"), mixed) is None


def test_a_mileage_that_is_not_believed_covers_nothing() -> None:
    findings = [found(BREACHED, number, km) for number, km in enumerate([None, 0.0, None, 29.0])]
    assert raised_at(findings, KM) is None
    assert raised_at([*findings, found(BREACHED, 4, 30.0)], KM) == 4


@given(
    st.text("bc-", max_size=14),
    st.lists(st.integers(1, 40), min_size=14, max_size=14),
    st.sampled_from([0.0, 10.0, 45.0]),
    st.sampled_from([0.0, 10.0, 45.0]),
    st.integers(1, 3),
)
def test_going_back_and_going_forward_agree(text: str, steps: list[int], on: float, off: float, counted: int) -> None:
    delays = AlertDelays(counted, counted, on_delay_km=on, off_delay_km=off)
    findings = [found(what, i, float(sum(steps[:i]))) for i, what in enumerate(text)]
    since = raised_at(findings, delays)
    assert latest_run(reversed(findings), delays) is (since is not None)
    if since is not None:
        assert began(reversed(findings), delays) == since


RULE = SensorFaultRule(latest_windows=4, minimum_windows=2, raise_probability=0.5, clear_probability=0.5, delays=KM)


def windows_of(pattern: Sequence[bool], step_km: float = 4.0) -> list[WindowRecord]:
    return [
        replace(window_record("W", number, sensor_fault=faulty), mileage_km=number * step_km)
        for number, faulty in enumerate(pattern)
    ]


def evaluated(alert: Alert | None, windows: Sequence[WindowRecord], rule: SensorFaultRule = RULE) -> Alert | None:
    facts = WheelsetFacts(wheelset=WHEELSET, vehicle=None, geometry=None, trend=None, windows=windows)
    finding = rule.find(facts, 0)
    assert finding is not None
    change = transition(alert, finding, 0, fleet="F", delays=rule.delays, rules_version="v")
    after = alert if change is None else change.alert
    return None if after is None or after.closed_ns is not None else after


@settings(max_examples=60)
@given(st.lists(st.booleans(), min_size=4, max_size=40), st.randoms(use_true_random=False), st.data())
def test_any_order_and_any_split_give_the_same_alerts(pattern: list[bool], random: object, data: st.DataObject) -> None:
    windows = windows_of(pattern)
    once = evaluated(None, windows)
    order = list(windows)
    random.shuffle(order)  # type: ignore[attr-defined]  # of hypothesis
    cuts = sorted(data.draw(st.lists(st.integers(1, len(windows)), max_size=5)))
    alert: Alert | None = None
    for count in [*cuts, len(windows)]:
        alert = evaluated(alert, sorted(order[:count], key=lambda window: window.start_ns))
    assert (alert is None) == (once is None)
    if alert is not None and once is not None:
        assert (alert.condition, alert.severity, alert.probability) == (once.condition, once.severity, once.probability)


def test_it_looks_back_as_far_as_its_delays_and_no_further() -> None:
    assert FINDINGS.look_back_factor * 30.0 == 150.0
    assert within_reach([float(km) for km in range(0, 400, 10)], 3, 150.0) == 16  # both ends
    assert within_reach([0.0, None, 390.0], 1, 150.0) == 1
    assert within_reach([0.0, None, 390.0], 2, 150.0) == 2
    assert within_reach([None, None], 1, 150.0) == 1
    assert within_reach([0.0, 1.0], 5, 0.0) == 2
    far = replace(RULE, delays=replace(KM, on_delay_km=100.0))  # 25 windows: more than 5 times the latest 4
    faulty = windows_of([True] * 29)
    assert evaluated(None, faulty[:25], far) is None
    assert evaluated(None, faulty, far) is not None


def test_an_implausible_mileage_does_not_make_a_wheelset_run_far() -> None:
    windows = windows_of([True] * 6, 1.0)
    jumped = replace(windows[-1], mileage_km=9e5)
    assert evaluated(None, [*windows[:-1], jumped]) is not None
    doubted = replace(jumped, implausible=Reason(ReasonCode.ODOMETER_IMPLAUSIBLE, "jumps"))
    assert evaluated(None, [*windows[:-1], doubted]) is None


def test_the_delays_are_kept_on_the_alert_as_they_were() -> None:
    alert = evaluated(None, windows_of([True] * 12))
    assert alert is not None
    assert (alert.condition, alert.rules_version) == (Condition.ACTIVE, "v")
    delays = alert.evidence["delays"]
    assert isinstance(delays, dict)
    assert (delays["on_delay_km"], delays["off_delay_km"]) == (30.0, 20.0)


def test_where_runs_are_counted_the_distance_decides_too() -> None:
    def seen(alert: Alert | None, what: str, number: int, km: float) -> Alert:
        change = transition(alert, found(what, number, km), 0, fleet="F", delays=KM)
        after = alert if change is None else change.alert
        assert after is not None
        return after

    alert = seen(None, BREACHED, 1, 100.0)
    assert alert.condition is Condition.PENDING
    alert = seen(alert, BREACHED, 2, 129.9)
    assert alert.condition is Condition.PENDING
    alert = seen(alert, BREACHED, 3, 130.0)
    assert alert.condition is Condition.ACTIVE
    alert = seen(alert, CLEARED, 4, 140.0)
    alert = seen(alert, CLEARED, 5, 159.9)
    assert alert.closed_ns is None
    alert = seen(alert, BREACHED, 6, 160.0)
    alert = seen(alert, CLEARED, 7, 170.0)
    assert alert.closed_ns is None
    assert seen(alert, CLEARED, 8, 190.0).closed_ns == 8
