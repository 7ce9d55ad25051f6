"""Fleet alerts: many new alerts of one kind in one fleet become one that stands for them. Pure functions.

A fleet alert contains nothing that its members do not contain. It is as severe as the worst open member, unknown where
all of them are, closed when the last of them closes. Its evidence counts them and names a few: there may be thousands,
and every event carries it. Its times are those of its members, thus of the data. ``version`` is left to the store.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

from estimation.alerts.life_cycle import DELAYS, SEVERITY_RANK, updated, without_stale_acknowledgement
from estimation.alerts.rules.book import AlarmFloodRule, RuleBook
from estimation.alerts.rules.rule import Evidence
from estimation.errors import InputError
from estimation.values.alerts import Alert, AlertEventKind, CloseReason, Condition, Transition
from estimation.values.fields import JsonValue, Served

HOUR_NS = 3_600_000_000_000
MOST_NAMED = 5  # wheelsets in the evidence


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetAlertEvidence(Evidence):
    """Evidence of a fleet alert of any kind: how many alerts it stands for. They themselves are under `members`."""

    more_than: Annotated[int, Served("How many alerts a flood has more than.")]
    within_hours: Annotated[float, Served("Span of opening times that counts as a flood.")]
    member_count: Annotated[int, Served("How many alerts it stands for, open and closed.")] = 0
    open_member_count: Annotated[int, Served("How many of them are open.")] = 0
    wheelsets: Annotated[
        tuple[str, ...],
        Served(f"At most {MOST_NAMED} wheelsets of its members, open ones first, then the most severe."),
    ] = ()


def in_flood(opened_ns: Sequence[int], rule: AlarmFloodRule) -> list[bool]:
    """Return of each alert whether some span of ``within_hours`` (both ends included) holds it and too many others."""
    order = sorted(range(len(opened_ns)), key=lambda i: opened_ns[i])
    within_ns = round(rule.within_hours * HOUR_NS)
    flooding = [False] * len(opened_ns)
    first = 0
    for last, i in enumerate(order):
        while opened_ns[i] - opened_ns[order[first]] > within_ns:
            first += 1
        if last - first + 1 > rule.more_than:
            for member in order[first : last + 1]:
                flooding[member] = True
    return flooding


def opened(fleet: str, kind: str, members: Sequence[Alert], book: RuleBook) -> Alert:
    """Return the fleet alert that members-to-be call for, to be stored before them so that they can name it.

    It counts them only once they are stored, see :func:`refreshed`; to be raised after that.
    """
    if not members:
        raise InputError("a fleet alert needs members", field="members")
    worst = _worst(members)
    return Alert(
        alert_id=0,
        fleet=fleet,
        wheelset=None,
        kind=kind,
        severity=worst.severity,
        condition=_condition(members),
        opened_ns=min(member.opened_ns for member in members),
        last_seen_ns=max(member.last_seen_ns for member in members),
        occurrence_count=len(members),
        probability=None,
        evidence={
            **FleetAlertEvidence(
                more_than=book.alarm_flood.more_than, within_hours=book.alarm_flood.within_hours
            ).stored(),
            DELAYS: {"acknowledgement_days": book.delays_of(kind).acknowledgement_days},
        },
        action=worst.action,
        raise_limit=None,
        clear_limit=None,
    )


def refreshed(alert: Alert, members: Sequence[Alert], now_ns: int) -> Transition | None:
    """Return what its members, as they are now, make of an open fleet alert; None where nothing has changed."""
    after = replace(
        without_stale_acknowledgement(alert, now_ns),
        last_seen_ns=max(alert.last_seen_ns, *(member.last_seen_ns for member in members)),
        occurrence_count=len(members),
        evidence={**alert.evidence, **_counted(members)},
    )
    still_open = [member for member in members if member.closed_ns is None]
    if not still_open:
        return _closed(after, members)
    worst = _worst(still_open)
    if SEVERITY_RANK[worst.severity] > SEVERITY_RANK[alert.severity]:
        after = replace(after, acknowledged_by=None, acknowledged_ns=None)
    after = replace(after, severity=worst.severity, action=worst.action, condition=_condition(still_open))
    return updated(alert, after)


def _closed(alert: Alert, members: Sequence[Alert]) -> Transition:
    closed_ns = max(member.closed_ns or member.last_seen_ns for member in members)
    after = replace(alert, closed_ns=closed_ns, close_reason=CloseReason.MEMBERS_CLOSED)
    if any(member.condition is not Condition.CLEARED for member in members):
        return Transition(after, (AlertEventKind.CLOSED,))
    after = replace(
        after, condition=Condition.CLEARED, cleared_ns=closed_ns, acknowledged_by=None, acknowledged_ns=None
    )
    return Transition(after, (AlertEventKind.CLEARED, AlertEventKind.CLOSED))


def _worst(members: Sequence[Alert]) -> Alert:
    return max(members, key=lambda member: SEVERITY_RANK[member.severity])  # the first of equals


def _condition(members: Sequence[Alert]) -> Condition:
    unknown = all(member.condition is Condition.UNKNOWN for member in members)
    return Condition.UNKNOWN if unknown else Condition.ACTIVE


def _counted(members: Sequence[Alert]) -> dict[str, JsonValue]:
    """Return how many there are, and some of them: the same whatever the order in which they were stored."""
    ordered = sorted(
        members,
        key=lambda one: (one.closed_ns is not None, -SEVERITY_RANK[one.severity], one.opened_ns, one.wheelset or ""),
    )
    return {
        "member_count": len(members),
        "open_member_count": sum(member.closed_ns is None for member in members),
        "wheelsets": [member.wheelset for member in ordered[:MOST_NAMED]],
    }
