"""Which alerts and events of alerts are asked for, and what of them tells whether they have changed."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

from sqlalchemy import Select, and_, or_, select

from estimation.values.alerts import AlertScope, Condition, Severity
from fleet_db.rows import table_of
from fleet_db.tables.alerts import AlertEventRow, AlertRow
from fleet_db.tables.registry import MountingRow

ALERTS, EVENTS, MOUNTINGS = table_of(AlertRow), table_of(AlertEventRow), table_of(MountingRow)


_OF_SCOPE = {
    AlertScope.WHEELSET: ALERTS.c.wheelset.is_not(None),
    AlertScope.TRACK_SECTION: ALERTS.c.track_section.is_not(None),
    AlertScope.FLEET: and_(ALERTS.c.wheelset.is_(None), ALERTS.c.track_section.is_(None)),
}


@dataclass(frozen=True, slots=True)
class AlertChoice:
    """Filters of a list of alerts; None and False for all."""

    fleet: str | None = None
    wheelset: str | None = None
    kind: str | None = None
    condition: Condition | None = None
    severity: Severity | None = None
    scope: AlertScope | None = None
    fleet_alert_id: int | None = None
    open_only: bool = False


class AlertOutline(NamedTuple):  # made by the hundred at every reading of a list: a tuple is made in C
    """What of an alert orders a list, says how it is shown, and changes whenever the alert does; and its place.

    Vehicle and axle are those that its wheelset ran under when it was opened; None for an alert of a fleet, and where
    no mounting of that time is on file.
    """

    alert_id: int
    version: int
    severity: Severity
    condition: Condition
    last_seen_ns: int
    closed_ns: int | None
    acknowledged_ns: int | None
    shelved_until_ns: int | None
    vehicle: str | None
    axle: int | None


class EventOutline(NamedTuple):
    """What tells one event from every other; an event never changes."""

    sequence: int
    alert_id: int
    recorded_ns: int


def outlines_of(choice: AlertChoice, after_id: int | None, limit: int, *, newest_first: bool) -> Select[Any]:
    """Return a statement with the columns of an ``AlertOutline``."""
    return page_of(_outlines(), choice, after_id, limit, newest_first=newest_first)


@cache
def _outlines() -> Select[Any]:
    """Return what all lists of outlines begin with."""
    at_opening = (
        MOUNTINGS.c.wheelset == ALERTS.c.wheelset,
        MOUNTINGS.c.from_ns <= ALERTS.c.opened_ns,
        or_(MOUNTINGS.c.to_ns.is_(None), MOUNTINGS.c.to_ns > ALERTS.c.opened_ns),
    )
    *own, vehicle, axle = AlertOutline._fields
    # a subquery each, not a join: a mounting that the caller may not see leaves the alert in the list
    place = (
        select(MOUNTINGS.c[name]).where(*at_opening).correlate(ALERTS).scalar_subquery() for name in (vehicle, axle)
    )
    return select(*(ALERTS.c[name] for name in own), *place)


def page_of(
    statement: Select[Any], choice: AlertChoice, after_id: int | None, limit: int, *, newest_first: bool
) -> Select[Any]:
    """Return a statement narrowed to the alerts behind a number."""
    number = ALERTS.c.alert_id
    if choice.open_only:
        statement = statement.where(ALERTS.c.closed_ns.is_(None))
    for name in ("fleet", "wheelset", "kind", "condition", "severity"):
        wanted = getattr(choice, name)
        if wanted is not None:
            statement = statement.where(ALERTS.c[name] == str(wanted))
    if choice.fleet_alert_id is not None:
        statement = statement.where(ALERTS.c.fleet_alert_id == choice.fleet_alert_id)
    if choice.scope is not None:
        statement = statement.where(_OF_SCOPE[choice.scope])
    if after_id is not None:
        statement = statement.where(number < after_id if newest_first else number > after_id)
    return statement.order_by(number.desc() if newest_first else number).limit(limit)


def feed_of(
    statement: Select[Any],
    after_sequence: int,
    *,
    fleets: Collection[str],
    kinds: Collection[str],
    severities: Collection[str],
) -> Select[Any]:
    """Return a statement narrowed to what the feed lists behind a number."""
    statement = statement.where(EVENTS.c.sequence > after_sequence, EVENTS.c.in_feed)
    for column, wanted in ((ALERTS.c.fleet, fleets), (ALERTS.c.kind, kinds)):
        if wanted:
            of_them = select(ALERTS.c.alert_id).where(column.in_(sorted(wanted)))
            statement = statement.where(EVENTS.c.alert_id.in_(of_them))
    if severities:
        earlier = EVENTS.alias()
        has_had = select(earlier.c.sequence).where(
            earlier.c.alert_id == EVENTS.c.alert_id,
            earlier.c.sequence <= EVENTS.c.sequence,
            earlier.c.alert["severity"].as_string().in_(sorted(severities)),
        )
        statement = statement.where(has_had.correlate(EVENTS).exists())
    return statement
