"""Alerts and their feed."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from typing import Any, NamedTuple, TypedDict, Unpack

from sqlalchemy import ColumnElement, Connection, Select, and_, insert, or_, select, update

from estimation.errors import ConflictError
from estimation.values.alerts import Alert, AlertEvent, AlertEventKind, AlertScope, CloseReason, Condition, Severity
from estimation.values.runs import Facet, SubjectKind
from estimation.values.trend import IDENTITY, UNREGISTERED_CHANGE
from fleet_db.locks import Subject, serialise
from fleet_db.rows import equal, given, grouped, insert_of, present, table_of
from fleet_db.session import to_json
from fleet_db.subjects import ReadOnce, Subjects
from fleet_db.tables.alerts import AlertEventRow, AlertRow
from fleet_db.tables.registry import MountingRow

ALERTS, EVENTS, MOUNTINGS = table_of(AlertRow), table_of(AlertEventRow), table_of(MountingRow)
_OPEN = ALERTS.c.closed_ns.is_(None)
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


class FeedChoice(TypedDict, total=False):
    """Filters of the feed; left out or empty for all."""

    fleets: Collection[str]
    kinds: Collection[str]
    severities: Collection[str]


class EventOutline(NamedTuple):
    """What tells one event from every other; an event never changes."""

    sequence: int
    alert_id: int
    recorded_ns: int


@cache
def _outlines() -> Select[Any]:
    at_opening = (
        MOUNTINGS.c.wheelset == ALERTS.c.wheelset,
        MOUNTINGS.c.from_ns <= ALERTS.c.opened_ns,
        or_(MOUNTINGS.c.to_ns.is_(None), MOUNTINGS.c.to_ns > ALERTS.c.opened_ns),
    )
    *names, vehicle, axle = AlertOutline._fields
    # a subquery each, not a join: a mounting that the caller may not see leaves the alert in the list
    place = (
        select(MOUNTINGS.c[name]).where(*at_opening).correlate(ALERTS).scalar_subquery() for name in (vehicle, axle)
    )
    return select(*(ALERTS.c[name] for name in names), *place)


def _page_of(
    statement: Select[Any], choice: AlertChoice, after_id: int | None, limit: int, *, newest_first: bool
) -> Select[Any]:
    number = ALERTS.c.alert_id
    names = ("fleet", "wheelset", "kind", "condition", "severity", "fleet_alert_id")
    chosen = [
        *([_OPEN] if choice.open_only else []),
        *equal(ALERTS, **{name: getattr(choice, name) for name in names}),
        *given(choice.scope, _OF_SCOPE.__getitem__),
        *given(after_id, number.__lt__ if newest_first else number.__gt__),
    ]
    return statement.where(*chosen).order_by(number.desc() if newest_first else number).limit(limit)


def _feed_of(
    statement: Select[Any],
    after_sequence: int,
    fleets: Collection[str] = (),
    kinds: Collection[str] = (),
    severities: Collection[str] = (),
) -> Select[Any]:
    statement = statement.where(EVENTS.c.sequence > after_sequence, EVENTS.c.in_feed)
    for column, wanted in ((ALERTS.c.fleet, fleets), (ALERTS.c.kind, kinds)):
        if wanted:
            chosen = select(ALERTS.c.alert_id).where(column.in_(sorted(wanted)))
            statement = statement.where(EVENTS.c.alert_id.in_(chosen))
    if severities:
        earlier = EVENTS.alias()
        has_had = select(earlier.c.sequence).where(
            earlier.c.alert_id == EVENTS.c.alert_id,
            earlier.c.sequence <= EVENTS.c.sequence,
            earlier.c.alert["severity"].as_string().in_(sorted(severities)),
        )
        statement = statement.where(has_had.correlate(EVENTS).exists())
    return statement


SEVERITIES = {severity.value: severity for severity in Severity}
CONDITIONS = {condition.value: condition for condition in Condition}
RESTARTING = (IDENTITY, UNREGISTERED_CHANGE)  # kinds of alerts of changes that geometries are not merged across


@dataclass(frozen=True, slots=True)
class AlertStore:
    """Alerts and their feed; at most one open alert per (wheelset, kind), held by the database.

    Of fleet alerts at most one per (fleet, kind) is open. What happens to a member that was raised with its fleet alert
    is among its events, but not in the feed, where the fleet alert stands for it.

    In a transaction that writes, the first read of an alert takes the lock of the alerts until the end: what was
    read is still true when it is saved, and events are numbered in the order in which they become visible.
    """

    connection: Connection
    writing: bool
    subjects: Subjects
    once: ReadOnce = field(default_factory=ReadOnce)

    def all_open(self, wheelset: str | None = None) -> Sequence[Alert]:
        """Return open alerts by number, of one wheelset or of all."""
        return self._alerts(_OPEN, *equal(ALERTS, wheelset=wheelset))

    def open_of(self, wheelsets: Collection[str], beside: str) -> Sequence[Alert]:
        """Return the open alerts of some wheelsets, by number.

        Args:
            beside: Kind of alerts that :meth:`of_kind` is asked for next: they are read by the same statement.
        """
        read = self._alerts(or_(_OPEN, ALERTS.c.kind == beside), ALERTS.c.wheelset.in_(wheelsets))
        of_kind: dict[str, list[Alert]] = grouped(alert for alert in read if alert.kind == beside)
        self.once.remember(f"alerts {beside}", {serial: of_kind.get(serial) for serial in wheelsets})
        return [alert for alert in read if alert.closed_ns is None]

    def open_in_fleet(self, fleet: str) -> Sequence[Alert]:
        """Return the open alerts of a fleet and of its wheelsets, by number."""
        return self._alerts(_OPEN, ALERTS.c.fleet == fleet)

    def open_of_fleets(self) -> Sequence[Alert]:
        """Return the open alerts that stand for several of a fleet, by number."""
        return self._alerts(_OPEN, _OF_SCOPE[AlertScope.FLEET])

    def open_of_section(self, section: str, kind: str) -> Sequence[Alert]:
        """Return the open alerts of a kind about a track section, of every fleet one at most, by number."""
        return self._alerts(_OPEN, ALERTS.c.track_section == section, ALERTS.c.kind == kind)

    def members(self, fleet_alert_id: int) -> Sequence[Alert]:
        """Return the alerts that a fleet alert stands for, open and closed, by number."""
        return self._alerts(ALERTS.c.fleet_alert_id == fleet_alert_id)

    def get(self, alert_id: int) -> Alert:
        """Return one alert; raises NotFoundError."""
        return present(next(iter(self._alerts(ALERTS.c.alert_id == alert_id)), None), "alert", alert_id)

    def of_wheelset(self, wheelset: str) -> Sequence[Alert]:
        """Return every alert that there has been of a wheelset, by number."""
        return self._alerts(ALERTS.c.wheelset == wheelset)

    def wheelsets_of_kind(self, kind: str) -> frozenset[str]:
        """Return the wheelsets of which there has been an alert of a kind."""
        chosen = (ALERTS.c.kind == kind, ALERTS.c.wheelset.is_not(None))
        return frozenset(self.connection.scalars(select(ALERTS.c.wheelset).where(*chosen).distinct()))

    def of_kind(self, kind: str, wheelsets: Collection[str]) -> Sequence[Alert]:
        """Return every alert of a kind that there has been of some wheelsets, by number."""

        def read(some: Collection[str]) -> Mapping[str, Sequence[Alert]]:
            return grouped(self._alerts(ALERTS.c.kind == kind, ALERTS.c.wheelset.in_(some)))

        by_serial = self.once.of_wheelsets(f"alerts {kind}", wheelsets, read)
        return sorted((alert for alerts in by_serial.values() for alert in alerts), key=lambda alert: alert.alert_id)

    def outlines(
        self, choice: AlertChoice, after_id: int | None, limit: int, *, newest_first: bool = False
    ) -> Sequence[AlertOutline]:
        """Return at most ``limit`` alerts behind a number: of each only what tells whether it has changed."""
        rows = self.connection.execute(_page_of(_outlines(), choice, after_id, limit, newest_first=newest_first))
        return [
            AlertOutline(number, version, SEVERITIES[severity], CONDITIONS[condition], *times)
            for number, version, severity, condition, *times in rows.all()
        ]

    def some(self, alert_ids: Sequence[int]) -> Mapping[int, Alert]:
        """Return alerts by number; one that is not on file is left out."""
        return {alert.alert_id: alert for alert in self._alerts(ALERTS.c.alert_id.in_(alert_ids))}

    def feed(self, after_sequence: int, limit: int, **chosen: Unpack[FeedChoice]) -> Sequence[AlertEvent]:
        """Return at most ``limit`` events behind ``after_sequence``, in commit order; none ever appears before it.

        Without those of members that were raised with their fleet alert, which stands for them here. With severities
        only of alerts that have had one of these until then: one that was listed is followed to its end.
        """
        return self._events(_feed_of(select(EVENTS), after_sequence, **chosen).limit(limit))

    def feed_outlines(self, after_sequence: int, limit: int, **chosen: Unpack[FeedChoice]) -> Sequence[EventOutline]:
        """Return what :meth:`feed` does, of each event only what tells it from others."""
        outlines = select(*(EVENTS.c[name] for name in EventOutline._fields))
        statement = _feed_of(outlines, after_sequence, **chosen).order_by(EVENTS.c.sequence)
        rows = self.connection.execute(statement.limit(limit))
        return [EventOutline._make(row) for row in rows.all()]

    def some_events(self, sequences: Sequence[int]) -> Mapping[int, AlertEvent]:
        """Return events by number; one that is not on file is left out."""
        events = self._events(select(EVENTS).where(EVENTS.c.sequence.in_(sequences)))
        return {event.sequence: event for event in events}

    def last_in_feed(self, up_to: int | None = None) -> AlertEvent | None:
        """Return the newest event of the feed, or the newest up to a number; None where there is none."""
        listed = select(EVENTS).where(EVENTS.c.in_feed, *given(up_to, EVENTS.c.sequence.__le__))
        return next(iter(self._events(listed.order_by(EVENTS.c.sequence.desc()).limit(1))), None)

    def event(self, sequence: int) -> AlertEvent | None:
        """Return the event of a number; None where there is none."""
        return next(iter(self._events(select(EVENTS).where(EVENTS.c.sequence == sequence))), None)

    def events(self, alert_id: int) -> Sequence[AlertEvent]:
        """Return what happened to one alert, oldest first."""
        return self._events(select(EVENTS).where(EVENTS.c.alert_id == alert_id))

    def save(
        self,
        alert: Alert,
        events: Sequence[AlertEventKind],
        recorded_ns: int,
        actor: str = "treadwatch",
        note: str = "",
    ) -> Alert:
        """Store an alert with its events and return it as stored.

        A new alert (``alert_id`` 0) gets its number and version 1. A known one must carry the version that it was
        read with, and gets the next; one that is as stored already, without events, is left alone.

        Raises:
            NotFoundError: There is no alert of that number.
            ConflictError: It was changed since it was read, or another of its kind is open.
        """
        serialise(self.connection, Subject.ALERTS)
        alert = replace(alert, evidence=json.loads(to_json(dict(alert.evidence))))
        saved = self._insert(alert) if alert.alert_id == 0 else self._update(alert, changed=bool(events))
        in_feed = bool(events) and self._in_feed(saved)
        row = {"alert_id": saved.alert_id, "alert": _fields(saved), "recorded_ns": recorded_ns, "actor": actor}
        row |= {"note": note, "in_feed": in_feed}
        for kind in events:
            self.connection.execute(insert(EVENTS).values(**row, kind=kind.value))
        if saved.wheelset is not None:
            self.subjects.raised(SubjectKind.WHEELSET, saved.wheelset, Facet.ALERTS)
            if events and saved.kind in RESTARTING:  # its geometry and trend start again from the change
                self.subjects.raised(SubjectKind.WHEELSET, saved.wheelset, Facet.RESTARTS)
        return saved

    def _in_feed(self, alert: Alert) -> bool:
        """Return whether the feed lists an alert itself: it is no member, or was listed before it became one."""
        if alert.fleet_alert_id is None:
            return True
        listed = select(EVENTS.c.sequence).where(EVENTS.c.alert_id == alert.alert_id, EVENTS.c.in_feed).limit(1)
        return self.connection.scalar(listed) is not None

    def _insert(self, alert: Alert) -> Alert:
        values = _fields(replace(alert, version=1))
        del values["alert_id"]
        new = insert_of(self.connection.dialect.name, ALERTS).values(**values).on_conflict_do_nothing()
        number = self.connection.scalar(new.returning(ALERTS.c.alert_id))
        if number is None:
            self._only_open(alert)
            # the one in the way is closed by now: a repeat finds nothing in its way
            raise ConflictError(f"another alert of kind {alert.kind} was open for {_subject(alert)}", kind="alert")
        return replace(alert, alert_id=number, version=1)

    def _update(self, alert: Alert, *, changed: bool) -> Alert:
        stored = self.get(alert.alert_id)
        if stored.version != alert.version:
            reason = f"alert {alert.alert_id} is at version {stored.version}, not {alert.version}"
            raise ConflictError(reason, kind="alert", key=str(alert.alert_id))
        if stored == alert and not changed:
            return stored
        if stored.closed_ns is not None and alert.closed_ns is None:
            self._only_open(alert)
        saved = replace(alert, version=alert.version + 1)
        self.connection.execute(update(ALERTS).where(ALERTS.c.alert_id == alert.alert_id).values(**_fields(saved)))
        return saved

    def _only_open(self, alert: Alert) -> None:
        """Raise where another alert of the kind is open."""
        statement = select(ALERTS.c.alert_id).where(
            _OPEN,
            ALERTS.c.fleet == alert.fleet,
            ALERTS.c.wheelset == alert.wheelset,
            ALERTS.c.track_section == alert.track_section,
            ALERTS.c.kind == alert.kind,
            ALERTS.c.alert_id != alert.alert_id,
        )
        other = self.connection.scalar(statement)
        if other is not None:
            reason = f"alert {other} of kind {alert.kind} is already open for {_subject(alert)}"
            raise ConflictError(reason, kind="alert", key=str(other))

    def _alerts(self, *chosen: ColumnElement[bool]) -> Sequence[Alert]:
        if self.writing:
            serialise(self.connection, Subject.ALERTS)
        statement = select(ALERTS).where(*chosen).order_by(ALERTS.c.alert_id)
        return [_alert(row) for row in self.connection.execute(statement).mappings()]

    def _events(self, statement: Select[Any]) -> Sequence[AlertEvent]:
        rows = self.connection.execute(statement.order_by(EVENTS.c.sequence))
        return [
            AlertEvent(row.sequence, AlertEventKind(row.kind), _alert(row.alert), row.recorded_ns, row.actor, row.note)
            for row in rows
        ]


def _subject(alert: Alert) -> str:
    if alert.track_section is not None:
        return f"track section {alert.track_section!r}"
    return f"fleet {alert.fleet!r}" if alert.wheelset is None else f"wheelset {alert.wheelset!r}"


def _fields(alert: Alert) -> dict[str, Any]:
    enumerations = {name: getattr(alert, name).value for name in ("severity", "condition")}
    closed: dict[str, str | None] = {"close_reason": None, "close_code": None}
    if alert.close_reason is not None:
        closed = {"close_reason": alert.close_reason.sentence, "close_code": alert.close_reason.value}
    return asdict(alert) | enumerations | closed | {"external_refs": list(alert.external_refs)}


def _alert(fields: Any) -> Alert:  # noqa: ANN401 - a row or the JSON of an event, both with the fields of an alert
    values = dict(fields)
    closed = values.pop("close_code", None)
    return Alert(
        **{
            **values,
            "close_reason": None if closed is None else CloseReason(closed),
            "severity": Severity(fields["severity"]),
            "condition": Condition(fields["condition"]),
            "external_refs": tuple(fields["external_refs"]),
        }
    )
