"""The life of an alert: opened, delayed, repeated, unknown, cleared, closed, and what people do to it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimation.alerts.life_cycle import acknowledge, close, link, shelve, transition, unshelve
from estimation.alerts.rules.rule import AlertDelays
from estimation.errors import ConflictError, InputError
from estimation.values.alerts import Alert, AlertEventKind, CloseReason, Condition, Finding, Severity, Transition
from estimation.values.units import DAY_NS

DELAYS = AlertDelays(on_evaluations=1, off_evaluations=2, acknowledgement_days=30.0)


def finding(
    measured_ns: int,
    *,
    breached: bool | None = True,
    cleared: bool | None = None,
    severity: Severity = Severity.WARNING,
    probability: float | None = 0.97,
    value: float = 0.43,
) -> Finding:
    return Finding(
        wheelset="W1",
        kind="conicity_limit",
        breached=breached,
        cleared=(None if breached is None else not breached) if cleared is None else cleared,
        severity=severity,
        probability=probability,
        evidence={"value": value, "unknown_because": "no data" if breached is None else None},
        action="plan_reprofiling",
        raise_limit=0.4,
        clear_limit=0.38,
        measured_ns=measured_ns,
    )


def step(alert: Alert | None, now: Finding, *, now_ns: int = 1000, delays: AlertDelays = DELAYS) -> Transition | None:
    return transition(alert, now, now_ns, fleet="F", delays=delays)


def after(alert: Alert | None, now: Finding, *, delays: AlertDelays = DELAYS) -> Alert:
    change = step(alert, now, delays=delays)
    assert change is not None
    return change.alert


def raised(severity: Severity = Severity.WARNING) -> Alert:
    return replace(after(None, finding(100, severity=severity)), alert_id=7)


def test_a_breach_raises_one_alert_with_the_times_of_its_data() -> None:
    change = step(None, finding(100))
    assert change is not None
    assert change.events == (AlertEventKind.RAISED,)
    alert = change.alert
    assert (alert.condition, alert.opened_ns, alert.last_seen_ns) == (Condition.ACTIVE, 100, 100)
    assert (alert.alert_id, alert.fleet, alert.wheelset, alert.raise_limit) == (0, "F", "W1", 0.4)


@pytest.mark.parametrize("breached", [False, None])
def test_nothing_breached_opens_nothing(breached: bool | None) -> None:  # noqa: FBT001 - a parameter of the test
    assert step(None, finding(100, breached=breached)) is None


def test_the_same_data_again_change_nothing() -> None:
    assert step(raised(), finding(100)) is None


def test_a_repeat_with_newer_data_is_counted_and_published_where_it_says_more() -> None:
    change = step(raised(), finding(200, value=0.66))
    assert change is not None
    assert change.events == (AlertEventKind.UPDATED,)
    change = step(raised(), finding(200, value=0.45))
    assert change is not None
    assert change.events == ()
    assert (change.alert.occurrence_count, change.alert.last_seen_ns, change.alert.opened_ns) == (2, 200, 100)
    assert change.alert.evidence["value"] == 0.45
    assert change.alert.version == raised().version  # the store counts it


def test_newer_data_that_say_the_same_are_counted_and_not_published() -> None:
    change = step(raised(), finding(200))
    assert change is not None
    assert change.events == ()
    assert change.alert.occurrence_count == 2


def test_the_on_delay_counts_newer_data_not_evaluations() -> None:
    delays = replace(DELAYS, on_evaluations=3)
    first = step(None, finding(100), delays=delays)
    assert first is not None
    assert (first.alert.condition, first.events) == (Condition.PENDING, ())
    assert step(first.alert, finding(100), delays=delays) is None
    second = after(first.alert, finding(200), delays=delays)
    assert second.condition is Condition.PENDING
    third = step(second, finding(300), delays=AlertDelays())  # it keeps the delays it was opened with
    assert third is not None
    assert (third.alert.condition, third.events) == (Condition.ACTIVE, (AlertEventKind.RAISED,))


def test_a_pending_alert_that_is_not_confirmed_goes_without_a_word() -> None:
    pending = after(None, finding(100), delays=replace(DELAYS, on_evaluations=2))
    assert step(pending, finding(200, breached=None)) is None
    change = step(pending, finding(200, breached=False))
    assert change is not None
    assert change.events == ()
    assert change.alert.closed_ns == 200


def test_clearing_needs_the_off_delay_of_newer_data() -> None:
    once = step(raised(), finding(200, breached=False, value=0.3))
    assert once is not None
    assert once.alert.condition is Condition.ACTIVE
    assert step(once.alert, finding(200, breached=False, value=0.3)) is None
    change = step(once.alert, finding(300, breached=False, value=0.3))
    assert change is not None
    assert change.events == (AlertEventKind.CLEARED, AlertEventKind.CLOSED)
    assert (change.alert.condition, change.alert.closed_ns) == (Condition.CLEARED, 300)
    assert change.alert.close_reason is CloseReason.CLEARED


def test_a_breach_in_between_starts_the_off_delay_again() -> None:
    once = after(raised(), finding(200, breached=False))
    again = after(once, finding(300))
    assert after(again, finding(400, breached=False)).condition is Condition.ACTIVE


def test_between_the_limits_an_alert_stays() -> None:
    alert = raised()
    for at in (200, 300, 400):
        change = step(alert, finding(at, breached=False, cleared=False, probability=0.6, value=0.39))
        assert change is not None
        alert = change.alert
    assert alert.condition is Condition.ACTIVE
    assert alert.last_seen_ns == 100


def test_silence_makes_it_unknown_and_never_cleared() -> None:
    change = step(raised(), finding(100, breached=None, probability=None))
    assert change is not None
    assert (change.alert.condition, change.events) == (Condition.UNKNOWN, (AlertEventKind.UPDATED,))
    assert change.alert.evidence["value"] == 0.43  # what raised it is kept
    assert change.alert.evidence["unknown_because"] == "no data"
    assert change.alert.probability == 0.97
    assert step(change.alert, finding(100, breached=None, probability=None)) is None
    back = step(change.alert, finding(300, value=0.44))
    assert back is not None
    assert back.alert.condition is Condition.ACTIVE


@given(st.lists(st.sampled_from([True, None]), max_size=12))
def test_no_run_of_breaches_and_silence_ever_closes(breaches: list[bool | None]) -> None:
    alert = raised()
    for i, breached in enumerate(breaches):
        change = step(alert, finding(200 + i, breached=breached))
        alert = alert if change is None else change.alert
    assert alert.closed_ns is None
    assert alert.condition is (Condition.ACTIVE if not breaches or breaches[-1] else Condition.UNKNOWN)


def test_rising_severity_ends_the_acknowledgement() -> None:
    known = acknowledge(raised(), "ann", 500).alert
    same = after(known, finding(200))
    assert same.acknowledged_by == "ann"
    worse = after(same, finding(300, severity=Severity.CRITICAL))
    assert (worse.severity, worse.acknowledged_by, worse.acknowledged_ns) == (Severity.CRITICAL, None, None)
    better = after(acknowledge(worse, "bob", 600).alert, finding(400))
    assert (better.severity, better.acknowledged_by) == (Severity.WARNING, "bob")


def test_clearing_and_time_end_the_acknowledgement() -> None:
    known = acknowledge(raised(), "ann", 500).alert
    once = after(known, finding(200, breached=False))
    cleared = step(once, finding(300, breached=False), now_ns=600)
    assert cleared is not None
    assert cleared.alert.acknowledged_by is None
    late = step(known, finding(100), now_ns=500 + 31 * DAY_NS)
    assert late is not None
    assert (late.events, late.alert.acknowledged_by) == ((AlertEventKind.UPDATED,), None)
    assert step(known, finding(100), now_ns=500 + 29 * DAY_NS) is None


def test_a_closed_alert_takes_nothing_more_than_a_reference() -> None:
    change = close(raised(), CloseReason.REPROFILED, 900)
    assert change.events == (AlertEventKind.CLOSED,)
    closed = change.alert
    assert (closed.close_reason, closed.closed_ns, closed.condition) == (CloseReason.REPROFILED, 900, Condition.ACTIVE)
    with pytest.raises(ConflictError, match="reprofiled"):
        step(closed, finding(1000))
    with pytest.raises(ConflictError):
        close(closed, CloseReason.CLEARED, 901)
    with pytest.raises(ConflictError):
        acknowledge(closed, "ann", 901)
    with pytest.raises(ConflictError):
        shelve(closed, 2000, "later", 901)
    linked = link(closed, "WO-1")
    assert linked is not None
    assert linked.alert.external_refs == ("WO-1",)


def test_a_pending_alert_cannot_be_acknowledged_and_closes_unheard() -> None:
    pending = after(None, finding(100), delays=replace(DELAYS, on_evaluations=2))
    with pytest.raises(ConflictError, match="not been raised"):
        acknowledge(pending, "ann", 1)
    assert close(pending, CloseReason.REPROFILED, 2).events == ()


def test_what_people_do_is_checked() -> None:
    alert = raised()
    change = acknowledge(alert, " ann ", 500)
    assert (change.alert.acknowledged_by, change.events) == ("ann", (AlertEventKind.ACKNOWLEDGED,))
    with pytest.raises(ConflictError, match="ann"):
        acknowledge(change.alert, "bob", 501)
    with pytest.raises(InputError, match="name"):
        acknowledge(alert, " ", 500)
    put_by = shelve(alert, 2000, "in the workshop on Monday", 1000)
    assert (put_by.alert.shelved_until_ns, put_by.events) == (2000, (AlertEventKind.SHELVED,))
    with pytest.raises(InputError, match="past"):
        shelve(alert, 1000, "x", 1000)
    with pytest.raises(InputError, match="reason"):
        shelve(alert, 2000, "", 1000)


def test_an_alert_is_brought_back_only_while_it_is_shelved() -> None:
    alert = raised()
    put_by = shelve(alert, 2000, "in the workshop on Monday", 1000).alert
    back = unshelve(put_by, 1999)
    assert (back.alert, back.events) == (alert, (AlertEventKind.UNSHELVED,))
    with pytest.raises(ConflictError, match="not shelved"):
        unshelve(put_by, 2000)  # it has come back by itself
    with pytest.raises(ConflictError, match="not shelved"):
        unshelve(alert, 1000)
    with pytest.raises(ConflictError, match="closed"):
        unshelve(close(put_by, CloseReason.REPROFILED, 1500).alert, 1600)


def test_references_are_kept_once_and_bounded() -> None:
    first = link(raised(), "WO-1")
    assert first is not None
    assert first.events == (AlertEventKind.UPDATED,)
    assert link(first.alert, " WO-1 ") is None
    with pytest.raises(InputError, match="characters"):
        link(raised(), "")
    with pytest.raises(InputError, match="characters"):
        link(raised(), "x" * 201)
    full = replace(raised(), external_refs=tuple(f"WO-{i}" for i in range(20)))
    with pytest.raises(ConflictError, match="references"):
        link(full, "WO-99")


def test_a_finding_of_another_wheelset_is_refused() -> None:
    with pytest.raises(ConflictError, match="not about"):
        step(raised(), replace(finding(200), wheelset="W2"))


def test_counting_versions_is_left_to_the_store() -> None:
    read = replace(after(None, finding(1)), alert_id=7, version=5)
    changes = [
        step(read, finding(2)),
        step(read, finding(2, breached=None)),
        step(replace(read, condition=Condition.PENDING), finding(2)),
        close(read, CloseReason.REPROFILED, 2),
        acknowledge(read, "j.smith", 2),
        shelve(read, 3, "ordered", 2),
        link(read, "WO-1"),
    ]
    assert [None if change is None else change.alert.version for change in changes] == [5] * len(changes)
