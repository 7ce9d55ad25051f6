"""Step: what is found of the wheelsets of a fleet is raised, each for itself or too many of a kind as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.alerts.fleet_alerts import in_flood, opened, refreshed
from estimation.alerts.rules.book import RuleBook
from estimation.storage import UnitOfWork
from estimation.values.alerts import Alert, AlertEventKind, AlertScope, Condition, Transition


@dataclass(frozen=True, slots=True)
class _Standing:
    """The open alerts of a fleet before anything is raised."""

    of_fleet: dict[str, Alert]
    alone: Sequence[Alert]  # raised, and no members


def raise_in_fleet(
    unit: UnitOfWork, fleet: str, found: Sequence[Transition], book: RuleBook, now_ns: int
) -> list[AlertEventKind]:
    """Store the alerts that a run has found, and bring the fleet alerts up to their members.

    Args:
        unit: A transaction that writes; all of this belongs in one.
        found: What raises an alert of one of its wheelsets; not stored yet.
        book: Rules, of which those of the fleet are taken.

    Returns:
        list of AlertEventKind: The events recorded, those of members included.
    """
    version, book = book.version, book.of(fleet, None)
    standing = _standing(unit, fleet)
    joining = _joining(unit, standing, [change.alert for change in found], book)
    fleet_alerts = dict(standing.of_fleet)
    for kind, members in joining.items():
        if kind not in fleet_alerts:
            new = replace(opened(fleet, kind, members, book), rules_version=version)
            fleet_alerts[kind] = unit.alerts.save(new, (), now_ns)
    joined = {(alert.wheelset, kind) for kind, members in joining.items() for alert in members}
    announced = [alert for alert in standing.alone if (alert.wheelset, alert.kind) in joined]
    events: list[AlertEventKind] = []
    for change in [*(Transition(alert, (AlertEventKind.UPDATED,)) for alert in announced), *found]:
        alert = change.alert
        if (alert.wheelset, alert.kind) in joined:
            alert = replace(alert, fleet_alert_id=fleet_alerts[alert.kind].alert_id)
        unit.alerts.save(alert, change.events, now_ns)
        events += change.events
    for kind, fleet_alert in fleet_alerts.items():
        events += _refresh(unit, fleet_alert, now_ns, new=kind not in standing.of_fleet)
    return events


def _standing(unit: UnitOfWork, fleet: str) -> _Standing:
    stored = unit.alerts.open_in_fleet(fleet)
    alone = [
        alert
        for alert in stored
        if alert.wheelset is not None and alert.fleet_alert_id is None and alert.condition is not Condition.PENDING
    ]
    of_fleet = {alert.kind: alert for alert in stored if alert.scope is AlertScope.FLEET}
    return _Standing(of_fleet, alone)


def _joining(unit: UnitOfWork, standing: _Standing, found: Sequence[Alert], book: RuleBook) -> dict[str, list[Alert]]:
    """Return by kind what becomes a member; the members that an open fleet alert has already count as well."""
    joining = {}
    for kind in (rule.kind for rule in book.rules):
        fleet_alert = standing.of_fleet.get(kind)
        members = [] if fleet_alert is None else unit.alerts.members(fleet_alert.alert_id)
        free = [alert for alert in (*standing.alone, *found) if alert.kind == kind]
        flooding = in_flood([alert.opened_ns for alert in (*free, *members)], book.alarm_flood)
        if any(flooding[: len(free)]):
            joining[kind] = [alert for alert, joins in zip(free, flooding, strict=False) if joins]
    return joining


def _refresh(unit: UnitOfWork, fleet_alert: Alert, now_ns: int, *, new: bool) -> Sequence[AlertEventKind]:
    change = refreshed(fleet_alert, unit.alerts.members(fleet_alert.alert_id), now_ns)
    if change is None:
        return ()
    events = (AlertEventKind.RAISED,) if new else change.events
    unit.alerts.save(change.alert, events, now_ns)
    return events
