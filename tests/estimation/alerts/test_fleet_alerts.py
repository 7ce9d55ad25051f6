"""Too many alerts of one kind in one fleet become one: which they are, and what the feed contains of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from one_database import on_sqlite
from wheelset_life import DAY_NS, START_NS, SetClock, register, run_windows

from estimation.alerts.life_cycle import acknowledge
from estimation.alerts.rule_book import AlarmFloodRule, RuleBook, in_flood, opened, refreshed
from estimation.alerts.rules.sensor_data import NoDataRule
from estimation.errors import ConflictError, InputError
from estimation.jobs import evaluate_alerts
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.jobs.stage import Outcome
from estimation.storage import Storage
from estimation.values.alerts import Alert, AlertEventKind, AlertScope, CloseReason, Condition, Severity
from estimation.values.runs import JobRun, JobTrigger
from estimation.values.units import HOUR_NS

RAISED, UPDATED, ACKNOWLEDGED, CLEARED, CLOSED = (
    AlertEventKind.RAISED,
    AlertEventKind.UPDATED,
    AlertEventKind.ACKNOWLEDGED,
    AlertEventKind.CLEARED,
    AlertEventKind.CLOSED,
)
SILENT = "no_data"
WHEELSETS = [f"W{number}" for number in range(1, 9)]


@given(st.lists(st.integers(0, 100), max_size=14), st.integers(1, 5), st.integers(1, 40))
def test_a_flood_is_any_span_that_holds_too_many(hours: list[int], more_than: int, within: int) -> None:
    found = in_flood([hour * HOUR_NS for hour in hours], AlarmFloodRule(more_than, float(within)))
    for i, hour in enumerate(hours):
        starts = [start for start in hours if start <= hour <= start + within]
        crowds = [sum(start <= other <= start + within for other in hours) for start in starts]
        assert found[i] == any(crowd > more_than for crowd in crowds)


def test_the_shipped_flood_is_more_than_five_within_a_day() -> None:
    assert in_flood([0] * 5, AlarmFloodRule()) == [False] * 5
    assert in_flood([0] * 5 + [24 * HOUR_NS], AlarmFloodRule()) == [True] * 6
    assert in_flood([0] * 5 + [24 * HOUR_NS + 1], AlarmFloodRule()) == [False] * 6


def member(number: int, **changes: object) -> Alert:
    alert = Alert(
        alert_id=number,
        fleet="F",
        wheelset=f"W{number}",
        kind=SILENT,
        severity=Severity.WARNING,
        condition=Condition.ACTIVE,
        opened_ns=100 + number,
        last_seen_ns=200 + number,
        occurrence_count=1,
        probability=1.0,
        evidence={},
        action="check",
        raise_limit=7.0,
        clear_limit=7.0,
        fleet_alert_id=9,
    )
    return replace(alert, **changes)  # type: ignore[arg-type]


def standing(*members: Alert) -> Alert:
    """Return a raised fleet alert of these members."""
    change = refreshed(replace(opened("F", SILENT, members, RuleBook()), alert_id=9), members, 0)
    assert change is not None
    assert refreshed(change.alert, members, 0) is None
    return change.alert


def test_a_fleet_alert_is_what_its_members_are() -> None:
    alert = standing(member(1), member(2, severity=Severity.CRITICAL, action="replace"), member(3))
    assert (alert.wheelset, alert.scope, alert.severity) == (None, AlertScope.FLEET, Severity.CRITICAL)
    assert (alert.opened_ns, alert.last_seen_ns, alert.occurrence_count) == (101, 203, 3)
    assert (alert.action, alert.probability, alert.raise_limit) == ("replace", None, None)
    counted = {name: alert.evidence[name] for name in ("member_count", "open_member_count", "wheelsets")}
    assert counted == {"member_count": 3, "open_member_count": 3, "wheelsets": ["W2", "W1", "W3"]}
    with pytest.raises(InputError):
        opened("F", SILENT, [], RuleBook())


@given(st.permutations(range(1, 9)))
def test_it_names_five_members_the_open_and_most_severe_first_whatever_their_numbers(order: list[int]) -> None:
    members = [replace(member(k), alert_id=10 * i) for i, k in enumerate(order)]
    members = [replace(one, severity=Severity.CRITICAL) if one.wheelset == "W7" else one for one in members]
    members = [replace(one, closed_ns=300) if one.wheelset == "W1" else one for one in members]
    evidence = standing(*members).evidence
    assert evidence["wheelsets"] == ["W7", "W2", "W3", "W4", "W5"]
    assert (evidence["member_count"], evidence["open_member_count"]) == (8, 7)


def test_it_is_unknown_only_where_all_open_members_are() -> None:
    unknown = member(1, condition=Condition.UNKNOWN)
    assert standing(unknown, member(2)).condition is Condition.ACTIVE
    assert standing(unknown, member(2, condition=Condition.CLEARED, closed_ns=300)).condition is Condition.UNKNOWN


def test_a_member_that_gets_worse_ends_its_acknowledgement() -> None:
    seen = acknowledge(standing(member(1), member(2)), "j.smith", 50).alert
    joined = refreshed(seen, [member(1), member(2), member(3)], 60)
    assert joined is not None
    assert (joined.events, joined.alert.acknowledged_by) == ((UPDATED,), "j.smith")
    worse = refreshed(seen, [member(1), member(2, severity=Severity.CRITICAL)], 60)
    assert worse is not None
    assert (worse.events, worse.alert.acknowledged_by) == ((UPDATED,), None)
    stale = refreshed(seen, [member(1), member(2)], 91 * DAY_NS)
    assert stale is not None
    assert stale.alert.acknowledged_by is None


@pytest.mark.parametrize(
    ("last", "condition", "events"),
    [(Condition.CLEARED, Condition.CLEARED, (CLEARED, CLOSED)), (Condition.ACTIVE, Condition.ACTIVE, (CLOSED,))],
)
def test_it_closes_with_its_last_member(
    last: Condition, condition: Condition, events: tuple[AlertEventKind, ...]
) -> None:
    first = member(1, condition=Condition.CLEARED, closed_ns=400)
    some = refreshed(standing(member(1), member(2)), [first, member(2)], 0)
    assert some is not None
    assert (some.events, some.alert.closed_ns) == ((UPDATED,), None)
    every = refreshed(some.alert, [first, member(2, condition=last, closed_ns=500)], 0)
    assert every is not None
    assert (every.events, every.alert.condition, every.alert.closed_ns) == (events, condition, 500)
    assert every.alert.close_reason is CloseReason.MEMBERS_CLOSED


def fleet_of(storage: Storage, last_day: dict[str, float]) -> None:
    """Register wheelsets whose last data are of these days."""
    register(storage, *list(last_day)[:4], vehicle="V1")
    register(storage, *list(last_day)[4:], vehicle="V2")
    for serial, day in last_day.items():
        run_windows(storage, serial, day, 20)


def evaluate(storage: Storage, day: float, rules: RuleBook | None = None) -> JobRun:
    clock = SetClock(START_NS + round(day * DAY_NS))
    settings = JobSettings(rules=rules or RuleBook())
    run = run_job(evaluate_alerts.JOB, JobContext(storage, clock, "test", settings), JobTrigger.CLI)
    assert run.outcome == "succeeded", run
    return run


def feed_of(storage: Storage) -> list[tuple[AlertEventKind, str | None]]:
    with storage.read() as unit:
        return [(event.kind, event.alert.wheelset) for event in unit.alerts.feed(0, 1000)]


def open_of_fleet(storage: Storage) -> Sequence[Alert]:
    with storage.read() as unit:
        return [alert for alert in unit.alerts.open_in_fleet("F") if alert.scope is AlertScope.FLEET]


def test_many_at_once_are_raised_as_one(storage: Storage) -> None:
    fleet_of(storage, dict.fromkeys(WHEELSETS, 1.0))
    evaluate(storage, 8.5)
    assert feed_of(storage) == [(RAISED, None)]
    (fleet_alert,) = open_of_fleet(storage)
    with storage.read() as unit:
        members = unit.alerts.members(fleet_alert.alert_id)
        assert [alert.wheelset for alert in members] == WHEELSETS
        assert {alert.fleet_alert_id for alert in members} == {fleet_alert.alert_id}
        assert [event.kind for event in unit.alerts.events(members[0].alert_id)] == [RAISED]
        (raised,) = unit.alerts.feed(0, 10)
    assert raised.alert == fleet_alert
    assert fleet_alert.evidence["member_count"] == len(members)
    assert fleet_alert.evidence["wheelsets"] == WHEELSETS[:5]
    assert fleet_alert.opened_ns == members[0].opened_ns < START_NS + round(8.1 * DAY_NS)  # of the data
    again = evaluate(storage, 9.0)
    assert set(again.counts.values()) == {0, len(WHEELSETS)}
    assert feed_of(storage) == [(RAISED, None)]
    assert open_of_fleet(storage) == [fleet_alert]


@on_sqlite
def test_it_follows_its_members_in_one_event_an_evaluation(storage: Storage) -> None:
    fleet_of(storage, dict.fromkeys(WHEELSETS, 1.0))
    evaluate(storage, 8.5)
    evaluate(storage, 30.0)  # all critical by now
    assert feed_of(storage)[1:] == [(UPDATED, None)]
    assert open_of_fleet(storage)[0].severity is Severity.CRITICAL
    for serial in WHEELSETS[:6]:
        run_windows(storage, serial, 31.0, 20)
    evaluate(storage, 31.5)
    assert feed_of(storage)[2:] == [(UPDATED, None)]
    for serial in WHEELSETS[6:]:
        run_windows(storage, serial, 32.0, 20)
    evaluate(storage, 32.5)
    assert feed_of(storage)[3:] == [(CLEARED, None), (CLOSED, None)]
    with storage.read() as unit:
        assert unit.alerts.all_open() == []
        closed = unit.alerts.feed(0, 10)[-1].alert
        members = unit.alerts.members(closed.alert_id)
        kinds = [event.kind for event in unit.alerts.events(members[0].alert_id)]
    assert closed.closed_ns == max(alert.closed_ns or 0 for alert in members) < START_NS + round(32.4 * DAY_NS)
    assert kinds == [RAISED, UPDATED, CLEARED, CLOSED]
    evaluate(storage, 33.0)
    assert len(feed_of(storage)) == 5


@on_sqlite
def test_as_many_as_allowed_are_raised_one_by_one(storage: Storage) -> None:
    fleet_of(storage, dict.fromkeys(WHEELSETS[:5], 1.0))
    evaluate(storage, 8.5)
    assert feed_of(storage) == [(RAISED, serial) for serial in WHEELSETS[:5]]
    assert open_of_fleet(storage) == []


@on_sqlite
def test_what_was_raised_before_stays_raised(storage: Storage) -> None:
    """Three are raised alone; three more within the day make a flood; the first three join it and stay open."""
    first, then, later = WHEELSETS[:3], WHEELSETS[3:6], WHEELSETS[6:]
    fleet_of(storage, dict.fromkeys(first, 1.0) | dict.fromkeys(then, 1.6) | dict.fromkeys(later, 4.0))
    evaluate(storage, 8.3)
    assert feed_of(storage) == [(RAISED, serial) for serial in first]
    evaluate(storage, 8.8)
    assert feed_of(storage)[3:] == [(UPDATED, serial) for serial in first] + [(RAISED, None)]
    evaluate(storage, 11.5)  # two days after, and only two: by themselves
    assert feed_of(storage)[7:] == [(RAISED, serial) for serial in later]
    for serial in (*first, *then):
        run_windows(storage, serial, 12.0, 20)
    evaluate(storage, 12.2)
    news = feed_of(storage)[9:]
    assert [event for event in news if event[1] is not None] == [
        (kind, serial) for serial in first for kind in (CLEARED, CLOSED)
    ]
    assert [event for event in news if event[1] is None] == [(CLEARED, None), (CLOSED, None)]


@on_sqlite
def test_a_wheelset_that_falls_silent_within_the_flood_joins_it(storage: Storage) -> None:
    fleet_of(storage, dict.fromkeys(WHEELSETS[:6], 1.0) | dict.fromkeys(WHEELSETS[6:], 1.9))
    evaluate(storage, 8.5)
    (fleet_alert,) = open_of_fleet(storage)
    with storage.write() as unit:
        seen = acknowledge(fleet_alert, "j.smith", START_NS + 9 * DAY_NS)
        unit.alerts.save(seen.alert, seen.events, START_NS + 9 * DAY_NS, "j.smith")
    evaluate(storage, 9.5)
    assert feed_of(storage) == [(RAISED, None), (ACKNOWLEDGED, None), (UPDATED, None)]
    (fleet_alert,) = open_of_fleet(storage)
    assert (fleet_alert.occurrence_count, fleet_alert.acknowledged_by) == (8, "j.smith")


@on_sqlite
def test_the_operator_sets_what_a_flood_is(storage: Storage) -> None:
    fleet_of(storage, {"W1": 1.0, "W2": 1.0, "W3": 3.0})
    book = replace(RuleBook(), alarm_flood=AlarmFloodRule(more_than=2, within_hours=49.0)).with_rules(
        NoDataRule(days=5.0)
    )
    evaluate(storage, 9.0, book)
    assert feed_of(storage) == [(RAISED, None)]
    assert open_of_fleet(storage)[0].evidence["more_than"] == 2


def test_a_run_that_is_stopped_raises_what_it_found_and_the_next_one_the_rest(
    storage: Storage, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet_of(storage, dict.fromkeys(WHEELSETS, 1.0))
    evaluated: list[str] = []

    def compute(inputs: evaluate_alerts.AlertInputs) -> Outcome[evaluate_alerts.Evaluated]:
        evaluated.append(inputs.facts.wheelset.serial)
        return evaluate_alerts.compute(inputs)

    monkeypatch.setattr(evaluate_alerts, "ALERTS", replace(evaluate_alerts.ALERTS, compute=compute, at_once=1))
    clock = SetClock(START_NS + round(8.5 * DAY_NS))
    context = JobContext(storage, clock, "test", JobSettings(), stopping=lambda: bool(evaluated))
    assert run_job(evaluate_alerts.JOB, context, JobTrigger.CLI).outcome == "abandoned"
    first = tuple(evaluated)
    assert 0 < len(first) < len(WHEELSETS)
    assert feed_of(storage) == [(RAISED, serial) for serial in first]
    evaluate(storage, 8.6)
    assert feed_of(storage)[len(first) :] == [*((UPDATED, serial) for serial in first), (RAISED, None)]


def test_two_open_fleet_alerts_of_a_kind_are_refused(storage: Storage) -> None:
    fleet_of(storage, dict.fromkeys(WHEELSETS, 1.0))
    evaluate(storage, 8.5)
    (fleet_alert,) = open_of_fleet(storage)
    with pytest.raises(ConflictError, match="already open for fleet 'F'"), storage.write() as unit:
        unit.alerts.save(replace(fleet_alert, alert_id=0), (RAISED,), 1)
