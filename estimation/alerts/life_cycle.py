"""What happens to an alert: pure functions from (alert, fact) to the alert afterwards and the events to record.

Life of an alert. A breach opens it (``pending`` until the on-delay is over, then ``active`` and raised). The same again
updates it. Data from which nothing follows any more make it ``unknown``. Beyond the clear limit, for the off-delay, it
is cleared and with that closed. A reprofiling or an exchange closes it with its reason. A closed alert never changes; a
later breach opens a new one.

Times of an alert are those of the data that moved it, so that the same data give the same alerts whenever they are
evaluated; the time of recording is on the events. ``version`` is left to the store, which counts it: what comes out
carries the version that went in. The delays as they were when it was raised, and how far they have been counted, stand
under ``delays`` in its evidence.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

from estimation.alerts.decision import DELAYS, PUBLISHED, differs, published_of, snapshot
from estimation.alerts.rules.rule import AlertDelays
from estimation.errors import ConflictError, InputError
from estimation.values.alerts import Alert, AlertEventKind, CloseReason, Condition, Finding, Severity, Transition
from estimation.values.fields import JsonValue, Served
from estimation.values.units import DAY_NS

RUN_FROM = "run_from_km"  # among them: mileage of the first of the findings on end that are counted
SEVERITY_RANK = {severity: rank for rank, severity in enumerate(Severity)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Delays:
    """The delays of the rule as they were when the alert was raised, and how far they have been counted."""

    on_evaluations: Annotated[int, Served("Evaluations on end before it is raised.")]
    off_evaluations: Annotated[int, Served("Evaluations on end before it is cleared.")]
    on_delay_km: Annotated[
        float | None, Served("Distance of findings on end before it is raised; null where evaluations are counted.")
    ]
    off_delay_km: Annotated[
        float | None, Served("Distance of findings on end before it is cleared; null where evaluations are counted.")
    ]
    acknowledgement_days: Annotated[float, Served("After which an acknowledgement ends by itself.")]
    clear_seen: Annotated[int, Served("Evaluations on end beyond the clear limit so far.")]
    counted_ns: Annotated[int, Served("Time of the newest data that were counted.")]


def transition(
    open_alert: Alert | None,
    finding: Finding,
    now_ns: int,
    *,
    fleet: str,
    delays: AlertDelays | None = None,
    rules_version: str | None = None,
) -> Transition | None:
    """Return what a finding does to the open alert of its wheelset and kind; None where nothing changes, as a repeat.

    A new alert keeps ``delays``. ``events`` is empty where only counters or a pending alert changed.
    """
    if open_alert is None:
        opens = finding.breached if finding.stands is None else finding.stands
        if not opens:
            return None
        opened_now = _opened(finding, fleet, delays or AlertDelays())
        return replace(opened_now, alert=replace(opened_now.alert, rules_version=rules_version))
    must_be_open(open_alert)
    if (open_alert.wheelset, open_alert.kind) != (finding.wheelset, finding.kind):
        raise ConflictError("the finding is not about this alert", kind="alert", key=str(open_alert.alert_id))
    if open_alert.condition is Condition.PENDING:
        return _pending(open_alert, finding)
    return _raised(without_stale_acknowledgement(open_alert, now_ns), open_alert, finding)


def _opened(finding: Finding, fleet: str, delays: AlertDelays) -> Transition:
    in_km = delays.on_delay_km > 0.0
    # where it stands, its delays have run in vehicle time
    at_once = finding.stands is True or (delays.on_evaluations <= 1 and not in_km)
    counters: dict[str, JsonValue] = {
        "on_evaluations": delays.on_evaluations,
        "off_evaluations": delays.off_evaluations,
        "acknowledgement_days": delays.acknowledgement_days,
        "clear_seen": 0,
        "counted_ns": finding.measured_ns,
    }
    if in_km or delays.off_delay_km > 0.0:
        counters |= {"on_delay_km": delays.on_delay_km or None, "off_delay_km": delays.off_delay_km or None}
        counters[RUN_FROM] = finding.mileage_km
    condition = Condition.UNKNOWN if finding.breached is None else Condition.ACTIVE
    alert = Alert(
        alert_id=0,
        fleet=fleet,
        wheelset=finding.wheelset,
        kind=finding.kind,
        severity=finding.severity,
        condition=condition if at_once else Condition.PENDING,
        opened_ns=finding.measured_ns if finding.since_ns is None else finding.since_ns,
        last_seen_ns=finding.measured_ns,
        occurrence_count=1,
        probability=finding.probability,
        evidence={**finding.evidence, DELAYS: counters},
        action=finding.action,
        raise_limit=finding.raise_limit,
        clear_limit=finding.clear_limit,
    )
    return Transition(alert, (AlertEventKind.RAISED,) if at_once else ())


def _pending(alert: Alert, finding: Finding) -> Transition | None:
    if finding.breached is None or not _is_news(alert, finding):
        return None
    if not (finding.breached if finding.stands is None else finding.stands):
        return _changed(alert, _ended(alert, finding, CloseReason.NOT_CONFIRMED), ())
    seen = _seen_again(alert, finding)
    if finding.stands is None and not _run_over(seen, finding, seen.occurrence_count, "on"):
        return _changed(alert, seen, ())
    return _changed(alert, replace(seen, condition=Condition.ACTIVE), (AlertEventKind.RAISED,))


def _raised(alert: Alert, stored: Alert, finding: Finding) -> Transition | None:
    if finding.stands is False:
        return _cleared(stored, _refreshed(alert, finding), finding)
    if finding.breached is None:  # keep the numbers that raised it, with the reason why they are no longer known
        why = {name: finding.evidence.get(name) for name in ("unknown_because", "unknown_because_code")}
        after = replace(alert, condition=Condition.UNKNOWN, evidence={**alert.evidence, **why})
        if finding.stands is not None:  # of the newest data that decide
            after = replace(after, severity=finding.severity, action=finding.action)
    elif finding.breached:
        after = _seen_again(alert, finding) if _is_news(alert, finding) else _refreshed(alert, finding)
        after = replace(_counted(after, finding, clear_seen=0), condition=Condition.ACTIVE)
    elif finding.cleared and finding.stands is None:
        seen = _delay(alert, "clear_seen") + _is_news(alert, finding)
        after = _counted(_refreshed(alert, finding), finding, clear_seen=seen)
        if _run_over(after, finding, seen, "off"):
            return _cleared(stored, after, finding)
        after = replace(after, condition=Condition.ACTIVE)
    else:  # between the limits: still true, not seen again
        after = replace(_counted(_refreshed(alert, finding), finding, clear_seen=0), condition=Condition.ACTIVE)
    return updated(stored, after)


def _cleared(stored: Alert, alert: Alert, finding: Finding) -> Transition | None:
    after = _ended(alert, finding, CloseReason.CLEARED)
    return _changed(stored, after, (AlertEventKind.CLEARED, AlertEventKind.CLOSED))


def _ended(alert: Alert, finding: Finding, reason: CloseReason) -> Alert:
    at_ns, cleared = finding.measured_ns, Condition.CLEARED
    after = replace(alert, condition=cleared, cleared_ns=at_ns, closed_ns=at_ns, close_reason=reason)
    return replace(after, acknowledged_by=None, acknowledged_ns=None)


def _seen_again(alert: Alert, finding: Finding) -> Alert:
    after = _counted(_refreshed(alert, finding), finding, clear_seen=0)
    last_ns = max(alert.last_seen_ns, finding.measured_ns)
    return replace(after, last_seen_ns=last_ns, occurrence_count=alert.occurrence_count + 1)


def _refreshed(alert: Alert, finding: Finding) -> Alert:
    after = replace(
        alert,
        severity=finding.severity,
        probability=finding.probability,
        evidence={**finding.evidence, DELAYS: alert.evidence.get(DELAYS)},
        action=finding.action,
        raise_limit=finding.raise_limit,
        clear_limit=finding.clear_limit,
    )
    if SEVERITY_RANK[finding.severity] > SEVERITY_RANK[alert.severity]:
        return replace(after, acknowledged_by=None, acknowledged_ns=None)
    return after


def without_stale_acknowledgement(alert: Alert, now_ns: int) -> Alert:
    """Return the alert without an acknowledgement that has run out."""
    ends_ns = acknowledgement_ends_ns(alert)
    if ends_ns is not None and now_ns > ends_ns:
        return replace(alert, acknowledged_by=None, acknowledged_ns=None)
    return alert


def acknowledgement_ends_ns(alert: Alert) -> int | None:
    """Return when the acknowledgement of an alert runs out, ns UTC; None where it has none."""
    if alert.acknowledged_ns is None:
        return None
    days = _number(_counters(alert).get("acknowledgement_days"), AlertDelays().acknowledgement_days)
    return alert.acknowledged_ns + round(days * DAY_NS)


def updated(before: Alert, after: Alert) -> Transition | None:
    """Return the change, with an event only where a reader of the feed decides otherwise; None where there is none."""
    if before == after:
        return None
    published = published_of(before)
    news = differs(published, before, after)
    counters = {**_counters(after), PUBLISHED: snapshot(after) if news else dict(published)}
    noted = replace(after, evidence={**after.evidence, DELAYS: counters})
    return Transition(noted, (AlertEventKind.UPDATED,) if news else ())


def _changed(before: Alert, after: Alert, events: tuple[AlertEventKind, ...]) -> Transition | None:
    return None if before == after else Transition(after, events)


def _is_news(alert: Alert, finding: Finding) -> bool:
    return _counters(alert).get("counted_ns") != finding.measured_ns


def _counters(alert: Alert) -> Mapping[str, JsonValue]:
    counters = alert.evidence.get(DELAYS)
    return counters if isinstance(counters, dict) else {}


def _counted(alert: Alert, finding: Finding, *, clear_seen: int) -> Alert:
    counters = {**_counters(alert), "clear_seen": clear_seen, "counted_ns": finding.measured_ns}
    if clear_seen == 1 and RUN_FROM in counters:
        counters[RUN_FROM] = finding.mileage_km
    return replace(alert, evidence={**alert.evidence, DELAYS: counters})


def _run_over(alert: Alert, finding: Finding, seen: int, which: str) -> bool:
    km = _number(_counters(alert).get(f"{which}_delay_km"), 0.0)
    if km <= 0.0:
        return seen >= _delay(alert, f"{which}_evaluations")
    begin = _counters(alert).get(RUN_FROM)
    return isinstance(begin, (int, float)) and finding.mileage_km is not None and finding.mileage_km - begin >= km


def _delay(alert: Alert, name: str) -> int:
    return int(_number(_counters(alert).get(name), 0.0 if name == "clear_seen" else 1.0))


def _number(value: JsonValue, default: float) -> float:
    return float(value) if isinstance(value, (int, float)) else default


def close(alert: Alert, reason: CloseReason, at_ns: int) -> Transition:
    """Close an alert for a reason outside the data, such as a reprofiling or an exchange."""
    # The condition stays as it was: what was true then is on record. A pending alert goes without an event.
    must_be_open(alert)
    after = replace(alert, closed_ns=at_ns, close_reason=reason)
    return Transition(after, () if alert.condition is Condition.PENDING else (AlertEventKind.CLOSED,))


def must_be_open(alert: Alert) -> None:
    """Refuse an alert that is closed."""
    if alert.closed_ns is not None:
        why = alert.close_reason.sentence if alert.close_reason else "no reason given"
        raise conflict(alert, f"the alert is closed ({why})")


def conflict(alert: Alert, reason: str) -> ConflictError:
    """Return the error that an alert is in another state than is asked for."""
    return ConflictError(reason, kind="alert", key=str(alert.alert_id))


def section_transition(
    open_alert: Alert | None,
    finding: Finding,
    now_ns: int,
    *,
    fleet: str,
    track_section: str,
    delays: AlertDelays,
    rules_version: str,
) -> Transition | None:
    """Return what a finding does to the open alert of a section and kind; None where nothing changes."""
    nameless = None if open_alert is None else replace(open_alert, wheelset="")
    change = transition(nameless, finding, now_ns, fleet=fleet, delays=delays, rules_version=rules_version)
    if change is None:
        return None
    return replace(change, alert=replace(change.alert, wheelset=None, track_section=track_section))


MOST_REFERENCES = 20
REFERENCE_LENGTH = 200


def acknowledge(alert: Alert, by: str, now_ns: int) -> Transition:
    """Record that somebody has seen the alert."""
    _must_be_raised(alert)
    if not by.strip():
        raise InputError("an acknowledgement needs a name", field="by")
    if alert.acknowledged_by is not None:
        raise conflict(alert, f"already acknowledged by {alert.acknowledged_by}")
    after = replace(alert, acknowledged_by=by.strip(), acknowledged_ns=now_ns)
    return Transition(after, (AlertEventKind.ACKNOWLEDGED,))


def shelve(alert: Alert, until_ns: int, reason: str, now_ns: int) -> Transition:
    """Hide the alert until a time; its life cycle goes on, and it returns by itself."""
    _must_be_raised(alert)
    if until_ns <= now_ns:
        raise InputError("the end of shelving is in the past", field="until")
    if not reason.strip():
        raise InputError("shelving needs a reason", field="reason")
    after = replace(alert, shelved_until_ns=until_ns, shelved_reason=reason.strip())
    return Transition(after, (AlertEventKind.SHELVED,))


def unshelve(alert: Alert, now_ns: int) -> Transition:
    """Bring a shelved alert back before its time."""
    must_be_open(alert)
    if alert.shelved_until_ns is None or alert.shelved_until_ns <= now_ns:
        raise conflict(alert, "the alert is not shelved")
    after = replace(alert, shelved_until_ns=None, shelved_reason=None)
    return Transition(after, (AlertEventKind.UNSHELVED,))


def link(alert: Alert, ref: str) -> Transition | None:
    """Note the reference of another system, such as a work order; None where it is noted already."""
    # closed alerts take references too: the work order often comes after
    wanted = ref.strip()
    if not 0 < len(wanted) <= REFERENCE_LENGTH:
        raise InputError(f"a reference has 1 to {REFERENCE_LENGTH} characters", field="external_refs")
    if wanted in alert.external_refs:
        return None
    if len(alert.external_refs) >= MOST_REFERENCES:
        raise conflict(alert, f"the alert has {MOST_REFERENCES} references already")
    after = replace(alert, external_refs=(*alert.external_refs, wanted))
    return Transition(after, (AlertEventKind.UPDATED,))


def _must_be_raised(alert: Alert) -> None:
    must_be_open(alert)
    if alert.condition is Condition.PENDING:
        raise conflict(alert, "the alert has not been raised yet")
