"""What the life of an alert and an alarm flood count: delays, bands of probability, how long somebody is believed."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from estimation.alerts.life_cycle import acknowledge, close, link, shelve, transition, without_stale_acknowledgement
from estimation.alerts.rule_book import AlarmFloodRule, RuleBook, in_flood, opened, refreshed
from estimation.alerts.rules.rule import AlertDelays
from estimation.errors import ConflictError, InputError
from estimation.values.alerts import Alert, AlertEventKind, CloseReason, Condition, Finding, Severity, Transition
from estimation.values.fields import JsonValue

DAY = 86_400 * 10**9
HOUR = 3_600 * 10**9
NO_EVENT: tuple[AlertEventKind, ...] = ()
UPDATED = (AlertEventKind.UPDATED,)


def finding(at: int, *, breached: bool | None = True, cleared: bool | None = None, **changes: object) -> Finding:
    if cleared is None and breached is not None:
        cleared = not breached
    plain = Finding(
        wheelset="W", kind="no_data", breached=breached, cleared=cleared, probability=0.9, evidence={"x": 1},
        action="check", raise_limit=2.0, clear_limit=1.0, measured_ns=at,
    )  # fmt: skip
    return replace(plain, **changes)  # type: ignore[arg-type]


def moved(alert: Alert | None, now: Finding, delays: AlertDelays | None = None, now_ns: int = 0) -> Transition:
    change = transition(alert, now, now_ns, fleet="F", delays=delays)
    assert change is not None
    return change


def raised(**changes: object) -> Alert:
    return moved(None, finding(1, **changes)).alert


def test_the_shipped_delays_raise_at_once_and_clear_at_the_second_evaluation() -> None:
    first = moved(None, finding(1))
    assert (first.alert.condition, first.events) == (Condition.ACTIVE, (AlertEventKind.RAISED,))
    once = moved(first.alert, finding(2, breached=False))
    assert (once.alert.condition, once.alert.closed_ns, once.events) == (Condition.ACTIVE, None, NO_EVENT)
    twice = moved(once.alert, finding(3, breached=False))
    assert (twice.alert.condition, twice.alert.cleared_ns, twice.alert.closed_ns) == (Condition.CLEARED, 3, 3)
    assert twice.alert.close_reason is CloseReason.CLEARED
    assert twice.events == (AlertEventKind.CLEARED, AlertEventKind.CLOSED)


@pytest.mark.parametrize("needed", [1, 2, 3])
def test_delays_are_counted_in_evaluations_with_newer_data(needed: int) -> None:
    delays = AlertDelays(on_evaluations=needed, off_evaluations=needed)
    alert, at = moved(None, finding(1), delays).alert, 1
    for count in range(2, needed + 1):
        assert alert.condition is Condition.PENDING
        assert transition(alert, finding(at), 0, fleet="F") is None
        at += 1
        change = moved(alert, finding(at))
        assert change.events == ((AlertEventKind.RAISED,) if count == needed else NO_EVENT)
        alert = change.alert
    assert (alert.condition, alert.occurrence_count) == (Condition.ACTIVE, needed)
    for count in range(1, needed + 1):
        assert alert.closed_ns is None
        at += 1
        alert = moved(alert, finding(at, breached=False)).alert
        assert (alert.closed_ns is not None) == (count == needed)


def test_a_pending_alert_waits_on_silence_and_ends_unconfirmed() -> None:
    pending = moved(None, finding(1), AlertDelays(on_evaluations=2)).alert
    assert transition(pending, finding(2, breached=None), 0, fleet="F") is None
    assert transition(pending, finding(1, breached=False), 0, fleet="F") is None
    gone = moved(pending, finding(2, breached=False))
    assert (gone.alert.condition, gone.alert.close_reason) == (Condition.CLEARED, CloseReason.NOT_CONFIRMED)
    assert gone.events == NO_EVENT


def test_between_the_limits_the_count_of_clearing_begins_again() -> None:
    alert = moved(raised(), finding(2, breached=False)).alert
    between = moved(alert, finding(3, breached=False, cleared=False)).alert
    assert (between.occurrence_count, between.last_seen_ns) == (1, 1)
    again = moved(between, finding(4, breached=False)).alert
    assert again.closed_ns is None
    assert moved(again, finding(5, breached=False)).alert.closed_ns == 5
    breached = moved(alert, finding(3)).alert
    assert moved(breached, finding(4, breached=False)).alert.closed_ns is None
    unknown = moved(alert, finding(3, breached=None))
    assert (unknown.alert.condition, unknown.events) == (Condition.UNKNOWN, UPDATED)
    assert moved(unknown.alert, finding(4)).alert.condition is Condition.ACTIVE


def test_the_same_data_are_counted_once() -> None:
    alert = moved(raised(), finding(2, breached=False)).alert
    assert transition(alert, finding(2, breached=False), 0, fleet="F") is None
    assert transition(raised(), finding(1), 0, fleet="F") is None
    assert moved(raised(), finding(2)).alert.occurrence_count == 2


def test_an_alert_without_counters_clears_with_the_first_newer_data() -> None:
    bare = replace(raised(), evidence={})
    assert moved(bare, finding(2, breached=False)).alert.closed_ns == 2
    counted = moved(bare, finding(2)).alert
    assert moved(counted, finding(2, breached=False, probability=0.1)).alert.closed_ns is None
    assert moved(counted, finding(3, breached=False)).alert.closed_ns == 3


@pytest.mark.parametrize("edge", [0.05, 0.5, 0.8, 0.95, 0.99])
def test_an_update_is_published_where_a_probability_crosses_a_band(edge: float) -> None:
    odds, step = edge / (1.0 - edge), math.exp(0.4)
    alert = raised(probability=edge - 1e-6)
    assert moved(alert, finding(2, probability=edge - 2e-6)).events == NO_EVENT
    assert moved(alert, finding(2, probability=1.0 - 1.0 / (1.0 + odds * step * 0.98))).events == NO_EVENT
    assert moved(alert, finding(2, probability=1.0 - 1.0 / (1.0 + odds * step * 1.02))).events == UPDATED
    assert moved(raised(probability=edge + 0.001), finding(2, probability=edge + 0.002)).events == NO_EVENT


def test_a_probability_that_creeps_is_published_in_the_end() -> None:
    alert, events = raised(probability=0.79), []
    for number in range(12):
        change = moved(alert, finding(2 + number, probability=0.79 + 0.01 * number))
        alert, events = change.alert, [*events, *change.events]
    assert events == list(UPDATED)


def forecast_evidence(*days: float | None, slope: float = 0.03) -> dict[str, JsonValue]:
    dates = [None if day is None else round(day * DAY) for day in days]
    estimate = {"value": slope, "interval_95": [0.02, 0.04], "status": "estimated", "reason_code": None, "std": slope}
    return {"date_of_limit_ns": dict(zip(("p10", "p50", "p90"), dates, strict=True)), "slope": estimate, "points": 8}


@pytest.mark.parametrize(
    ("changed", "published"),
    [
        (forecast_evidence(90, 110, 180), False),
        (forecast_evidence(60, 68, 180), False),  # a third of 100 days that were left is 33
        (forecast_evidence(60, 66, 180), True),
        (forecast_evidence(90, 132, 180), False),
        (forecast_evidence(90, 134, 180), True),
        (forecast_evidence(40, 49, 60), True),  # behind what was said to be the earliest
        (forecast_evidence(80, 100, 180, slope=0.0399), False),
        (forecast_evidence(80, 100, 180, slope=0.0401), True),  # out of its interval
        (forecast_evidence(80, 100, 180) | {"points": 12}, False),
        (forecast_evidence(80, 100, 180) | {"points": 13}, True),  # more than half as many again
        (forecast_evidence(80, None, None), True),
    ],
)
def test_an_update_is_published_where_a_date_or_a_number_leaves_what_was_published(
    changed: dict[str, JsonValue], *, published: bool
) -> None:
    alert = raised(evidence=forecast_evidence(50, 100, 200))
    assert moved(alert, finding(2, evidence=changed)).events == (UPDATED if published else NO_EVENT)


@pytest.mark.parametrize(("shift", "news"), [(13, False), (15, True)])
def test_a_date_moves_by_two_weeks_at_least_and_not_where_the_limit_is_reached(shift: int, *, news: bool) -> None:
    alert = raised(evidence=forecast_evidence(20, 30, 40))
    assert moved(alert, finding(2, evidence=forecast_evidence(20, 30 + shift, 60))).events == (
        UPDATED if news else NO_EVENT
    )
    reached = raised(evidence=forecast_evidence(0, 1, 40))
    late = finding(50 * DAY, evidence=forecast_evidence(50, 50 + shift, 90))
    assert moved(reached, late).events == (UPDATED if news else NO_EVENT)


def test_an_update_is_published_of_what_matters() -> None:
    alert = raised()
    for change in ({"severity": Severity.CRITICAL}, {"evidence": {"x": 2}}, {"action": "other"}, {"raise_limit": 3.0}):
        assert moved(alert, finding(2, **change)).events == UPDATED
    assert moved(alert, finding(2, clear_limit=0.5)).events == UPDATED
    assert moved(alert, finding(2, probability=None)).events == UPDATED
    assert moved(alert, finding(2)).events == NO_EVENT


def acknowledged(days: float | None = None) -> Alert:
    delays = AlertDelays() if days is None else AlertDelays(acknowledgement_days=days)
    return acknowledge(moved(None, finding(1), delays).alert, " Ann ", 5 * DAY).alert


@pytest.mark.parametrize("days", [None, 10.0])
def test_an_acknowledgement_lasts_its_days(days: float | None) -> None:
    alert, end = acknowledged(days), round((5.0 + (days or 90.0)) * DAY)
    assert alert.acknowledged_by == "Ann"
    assert without_stale_acknowledgement(alert, end) == alert
    assert without_stale_acknowledgement(alert, end + 1).acknowledged_by is None
    assert moved(alert, finding(2), now_ns=end + 1).alert.acknowledged_ns is None
    bare = replace(alert, evidence={})
    assert without_stale_acknowledgement(bare, 95 * DAY) == bare
    assert without_stale_acknowledgement(bare, 95 * DAY + 1).acknowledged_by is None
    never = raised()
    assert without_stale_acknowledgement(never, 10**20) == never


@pytest.mark.parametrize(
    ("before", "after", "kept"),
    [
        (Severity.INFO, Severity.WARNING, False),
        (Severity.WARNING, Severity.CRITICAL, False),
        (Severity.INFO, Severity.CRITICAL, False),
        (Severity.WARNING, Severity.WARNING, True),
        (Severity.CRITICAL, Severity.WARNING, True),
        (Severity.WARNING, Severity.INFO, True),
    ],
)
def test_a_rise_in_severity_ends_the_acknowledgement(before: Severity, after: Severity, *, kept: bool) -> None:
    alert = acknowledge(raised(severity=before), "Ann", 0).alert
    now = moved(alert, finding(2, severity=after)).alert
    assert (now.acknowledged_by == "Ann", now.acknowledged_ns == 0) == (kept, kept)
    members = [replace(raised(severity=before), alert_id=1, fleet_alert_id=9)]
    fleet = replace(opened("F", "no_data", members, RuleBook()), alert_id=9, acknowledged_by="Ann", acknowledged_ns=0)
    change = refreshed(fleet, [replace(members[0], severity=after)], 0)
    assert change is not None
    assert (change.alert.acknowledged_by == "Ann") == kept
    assert change.alert.severity is after


def test_clearing_ends_the_acknowledgement() -> None:
    alert = moved(acknowledged(), finding(2, breached=False)).alert
    assert alert.acknowledged_by == "Ann"
    assert moved(alert, finding(3, breached=False)).alert.acknowledged_by is None


def test_references_are_bounded() -> None:
    alert = raised()
    for length, allowed in ((0, False), (1, True), (200, True), (201, False)):
        if allowed:
            assert link(alert, "x" * length) is not None
        else:
            with pytest.raises(InputError):
                link(alert, "x" * length)
    full = replace(alert, external_refs=tuple(f"{i}" for i in range(19)))
    change = link(full, "20th")
    assert change is not None
    assert change.events == UPDATED
    assert link(change.alert, "20th") is None
    with pytest.raises(ConflictError):
        link(change.alert, "21st")


def test_what_people_may_do() -> None:
    alert = raised()
    closed = close(alert, CloseReason.REPROFILED, 5)
    assert (closed.alert.closed_ns, closed.alert.close_reason) == (5, CloseReason.REPROFILED)
    assert closed.events == (AlertEventKind.CLOSED,)
    pending = moved(None, finding(1), AlertDelays(on_evaluations=2)).alert
    assert close(pending, CloseReason.REPROFILED, 5).events == NO_EVENT
    for gone in (closed.alert, pending):
        with pytest.raises(ConflictError):
            acknowledge(gone, "Ann", 0)
        with pytest.raises(ConflictError):
            shelve(gone, 10, "why", 0)
    with pytest.raises(ConflictError):
        transition(closed.alert, finding(9), 0, fleet="F")
    with pytest.raises(ConflictError, match=r"closed \(reprofiled\)"):
        close(closed.alert, CloseReason.REPROFILED, 6)
    with pytest.raises(ConflictError):
        transition(alert, finding(9, wheelset="X"), 0, fleet="F")
    with pytest.raises(ConflictError):
        transition(alert, finding(9, kind="X"), 0, fleet="F")
    with pytest.raises(ConflictError):
        acknowledge(acknowledged(), "Bob", 0)
    with pytest.raises(InputError):
        acknowledge(alert, " ", 0)
    with pytest.raises(InputError):
        shelve(alert, 9, "why", 10)
    with pytest.raises(InputError):
        shelve(alert, 11, " ", 10)
    assert shelve(alert, 11, " why ", 10).alert.shelved_reason == "why"


def test_the_shipped_flood_is_more_than_five_within_a_day() -> None:
    for more_than, hours, rule in ((5, 24.0, AlarmFloodRule()), (2, 0.5, AlarmFloodRule(2, 0.5))):
        span = round(hours * HOUR)
        assert not any(in_flood([0] * more_than, rule))
        assert all(in_flood([0] * more_than + [span], rule))
        assert not any(in_flood([0] * more_than + [span + 1], rule))


def test_only_those_within_the_span_are_in_the_flood() -> None:
    rule = AlarmFloodRule(1, 1.0)
    assert in_flood([4 * HOUR, 0, HOUR, 9 * HOUR, 2 * HOUR], rule) == [False, True, True, False, True]
    assert in_flood([], rule) == []


def member(number: int, **changes: object) -> Alert:
    return replace(raised(), **({"alert_id": number, "wheelset": f"W{number}", "fleet_alert_id": 9} | changes))  # type: ignore[arg-type]


def test_a_fleet_alert_is_as_bad_as_its_worst_member_and_spans_them() -> None:
    members = [
        member(1, opened_ns=5, last_seen_ns=7, severity=Severity.INFO, action="a"),
        member(2, opened_ns=3, last_seen_ns=9, severity=Severity.CRITICAL, action="b"),
        member(3, opened_ns=4, last_seen_ns=8, condition=Condition.UNKNOWN),
    ]
    found = opened("F", "no_data", members, RuleBook())
    assert (found.opened_ns, found.last_seen_ns, found.occurrence_count) == (3, 9, 3)
    assert (found.severity, found.action, found.condition) == (Severity.CRITICAL, "b", Condition.ACTIVE)
    assert found.evidence["more_than"] == 5
    assert found.evidence["within_hours"] == 24.0
    silent = [replace(one, condition=Condition.UNKNOWN) for one in members]
    assert opened("F", "no_data", silent, RuleBook()).condition is Condition.UNKNOWN
    with pytest.raises(InputError):
        opened("F", "no_data", [], RuleBook())


def test_a_fleet_alert_closes_with_its_last_member() -> None:
    fleet = replace(opened("F", "no_data", [member(1), member(2)], RuleBook()), alert_id=9)
    fleet = acknowledge(fleet, "Ann", 0).alert
    gone = {"closed_ns": 20, "condition": Condition.CLEARED}
    one = refreshed(fleet, [member(1), member(2, **gone, severity=Severity.CRITICAL)], 0)
    assert one is not None
    assert (one.alert.closed_ns, one.alert.severity) == (None, Severity.WARNING)
    assert (one.alert.evidence["member_count"], one.alert.evidence["open_member_count"]) == (2, 1)
    both = refreshed(fleet, [member(1, **gone | {"closed_ns": 30}), member(2, **gone)], 0)
    assert both is not None
    assert (both.alert.closed_ns, both.alert.cleared_ns, both.alert.condition) == (30, 30, Condition.CLEARED)
    assert both.alert.acknowledged_by is None
    assert both.events == (AlertEventKind.CLEARED, AlertEventKind.CLOSED)
    assert both.alert.close_reason is CloseReason.MEMBERS_CLOSED
    reprofiled = refreshed(fleet, [member(1, closed_ns=30), member(2, **gone)], 0)
    assert reprofiled is not None
    assert (reprofiled.alert.condition, reprofiled.events) == (Condition.ACTIVE, (AlertEventKind.CLOSED,))
    assert reprofiled.alert.cleared_ns is None
