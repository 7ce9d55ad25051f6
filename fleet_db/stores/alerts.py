"""Alerts and their feed."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from sqlalchemy import Connection, Select, insert, select, update

from estimation.errors import ConflictError, NotFoundError
from estimation.values.alerts import Alert, AlertEvent, AlertEventKind, AlertScope, CloseReason, Condition, Severity
from estimation.values.runs import Facet, SubjectKind
from estimation.values.trend import IDENTITY, UNREGISTERED_CHANGE
from fleet_db.locks import Subject, serialise
from fleet_db.read_once import ReadOnce
from fleet_db.rows import by_wheelset
from fleet_db.session import to_json
from fleet_db.stores.alert_queries import (
    ALERTS,
    EVENTS,
    AlertChoice,
    AlertOutline,
    EventOutline,
    feed_of,
    outlines_of,
    page_of,
)
from fleet_db.subjects import Subjects

SEVERITIES = {one.value: one for one in Severity}
CONDITIONS = {one.value: one for one in Condition}
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
        statement = _open() if wheelset is None else _open().where(ALERTS.c.wheelset == wheelset)
        return self._alerts(statement.order_by(ALERTS.c.alert_id))

    def open_of(self, wheelsets: Collection[str]) -> Sequence[Alert]:
        """Return the open alerts of some wheelsets, by number."""
        return self._alerts(_open().where(ALERTS.c.wheelset.in_(wheelsets)).order_by(ALERTS.c.alert_id))

    def open_in_fleet(self, fleet: str) -> Sequence[Alert]:
        """Return the open alerts of a fleet and of its wheelsets, by number."""
        return self._alerts(_open().where(ALERTS.c.fleet == fleet).order_by(ALERTS.c.alert_id))

    def open_of_fleets(self) -> Sequence[Alert]:
        """Return the open alerts that stand for several of a fleet, by number."""
        of_fleet = (ALERTS.c.wheelset.is_(None), ALERTS.c.track_section.is_(None))
        return self._alerts(_open().where(*of_fleet).order_by(ALERTS.c.alert_id))

    def open_of_section(self, section: str, kind: str) -> Sequence[Alert]:
        """Return the open alerts of a kind about a track section, of every fleet one at most, by number."""
        of_section = (ALERTS.c.track_section == section, ALERTS.c.kind == kind)
        return self._alerts(_open().where(*of_section).order_by(ALERTS.c.alert_id))

    def members(self, fleet_alert_id: int) -> Sequence[Alert]:
        """Return the alerts that a fleet alert stands for, open and closed, by number."""
        statement = select(ALERTS).where(ALERTS.c.fleet_alert_id == fleet_alert_id)
        return self._alerts(statement.order_by(ALERTS.c.alert_id))

    def get(self, alert_id: int) -> Alert:
        """Return one alert; raises NotFoundError."""
        found = self._alerts(select(ALERTS).where(ALERTS.c.alert_id == alert_id))
        if not found:
            raise NotFoundError("alert", str(alert_id))
        return found[0]

    def page(
        self,
        *,
        fleet: str | None,
        wheelset: str | None,
        kind: str | None,
        condition: Condition | None,
        open_only: bool,
        after_id: int | None,
        limit: int,
        scope: AlertScope | None = None,
        fleet_alert_id: int | None = None,
        severity: Severity | None = None,
        newest_first: bool = False,
    ) -> Sequence[Alert]:
        """Return at most ``limit`` alerts that match every filter given, by number, from behind ``after_id`` on."""
        chosen = AlertChoice(fleet, wheelset, kind, condition, severity, scope, fleet_alert_id, open_only=open_only)
        return self._alerts(page_of(select(ALERTS), chosen, after_id, limit, newest_first=newest_first))

    def of_kind(self, kind: str, wheelsets: Collection[str]) -> Sequence[Alert]:
        """Return every alert of a kind that there has been of some wheelsets, by number."""

        def read(some: Collection[str]) -> Mapping[str, Sequence[Alert]]:
            chosen = (ALERTS.c.kind == kind, ALERTS.c.wheelset.in_(some))
            alerts = self._alerts(select(ALERTS).where(*chosen).order_by(ALERTS.c.alert_id))
            return by_wheelset(alerts, lambda alert: alert)

        found = self.once.of_wheelsets(f"alerts {kind}", wheelsets, read)
        return sorted((alert for own in found.values() for alert in own), key=lambda alert: alert.alert_id)

    def outlines(
        self, choice: AlertChoice, after_id: int | None, limit: int, *, newest_first: bool = False
    ) -> Sequence[AlertOutline]:
        """Return what :meth:`page` does, of each alert only what tells whether it has changed."""
        rows = self.connection.execute(outlines_of(choice, after_id, limit, newest_first=newest_first))
        return [
            AlertOutline(number, version, SEVERITIES[severity], CONDITIONS[condition], *times)
            for number, version, severity, condition, *times in rows.all()
        ]

    def some(self, alert_ids: Sequence[int]) -> Mapping[int, Alert]:
        """Return alerts by number; one that is not on file is left out."""
        found = self._alerts(select(ALERTS).where(ALERTS.c.alert_id.in_(alert_ids)))
        return {alert.alert_id: alert for alert in found}

    def feed(
        self,
        after_sequence: int,
        limit: int,
        *,
        fleets: Collection[str] = (),
        kinds: Collection[str] = (),
        severities: Collection[str] = (),
    ) -> Sequence[AlertEvent]:
        """Return at most ``limit`` events behind ``after_sequence``, in commit order; none ever appears before it.

        Without those of members that were raised with their fleet alert, which stands for them here. With severities
        only of alerts that have had one of these until then: one that was listed is followed to its end.
        """
        statement = feed_of(select(EVENTS), after_sequence, fleets=fleets, kinds=kinds, severities=severities)
        return self._events(statement.limit(limit))

    def feed_outlines(
        self,
        after_sequence: int,
        limit: int,
        *,
        fleets: Collection[str] = (),
        kinds: Collection[str] = (),
        severities: Collection[str] = (),
    ) -> Sequence[EventOutline]:
        """Return what :meth:`feed` does, of each event only what tells it from others."""
        statement = select(EVENTS.c.sequence, EVENTS.c.alert_id, EVENTS.c.recorded_ns)
        statement = feed_of(statement, after_sequence, fleets=fleets, kinds=kinds, severities=severities)
        rows = self.connection.execute(statement.order_by(EVENTS.c.sequence).limit(limit))
        return [EventOutline._make(row) for row in rows.all()]

    def some_events(self, sequences: Sequence[int]) -> Mapping[int, AlertEvent]:
        """Return events by number; one that is not on file is left out."""
        found = self._events(select(EVENTS).where(EVENTS.c.sequence.in_(sequences)))
        return {event.sequence: event for event in found}

    def last_in_feed(self, up_to: int | None = None) -> AlertEvent | None:
        """Return the newest event of the feed, or the newest up to a number; None where there is none."""
        statement = select(EVENTS).where(EVENTS.c.in_feed).order_by(EVENTS.c.sequence.desc()).limit(1)
        if up_to is not None:
            statement = statement.where(EVENTS.c.sequence <= up_to)
        return next(iter(self._events(statement)), None)

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
        self._only_open(alert)
        alert = replace(alert, evidence=json.loads(to_json(dict(alert.evidence))))
        saved = self._insert(alert) if alert.alert_id == 0 else self._update(alert, changed=bool(events))
        in_feed = bool(events) and self._in_feed(saved)
        rows = [
            {
                "alert_id": saved.alert_id,
                "kind": kind.value,
                "alert": _fields(saved),
                "recorded_ns": recorded_ns,
                "actor": actor,
                "note": note,
                "in_feed": in_feed,
            }
            for kind in events
        ]
        for row in rows:
            self.connection.execute(insert(EVENTS).values(**row))
        if saved.wheelset is not None:
            self.subjects.raised(SubjectKind.WHEELSET, saved.wheelset, Facet.ALERTS)
        if events and saved.kind in RESTARTING and saved.wheelset is not None:
            # its geometry and trend start again from the change
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
        statement = insert(ALERTS).values(**values).returning(ALERTS.c.alert_id)
        return replace(alert, alert_id=self.connection.execute(statement).scalar_one(), version=1)

    def _update(self, alert: Alert, *, changed: bool) -> Alert:
        stored = self.get(alert.alert_id)
        if stored.version != alert.version:
            raise ConflictError(
                f"alert {alert.alert_id} is at version {stored.version}, not {alert.version}",
                kind="alert",
                key=str(alert.alert_id),
            )
        if stored == alert and not changed:
            return stored
        saved = replace(alert, version=alert.version + 1)
        self.connection.execute(update(ALERTS).where(ALERTS.c.alert_id == alert.alert_id).values(**_fields(saved)))
        return saved

    def _only_open(self, alert: Alert) -> None:
        if alert.closed_ns is not None:
            return
        statement = select(ALERTS.c.alert_id).where(
            ALERTS.c.closed_ns.is_(None),
            ALERTS.c.fleet == alert.fleet,
            ALERTS.c.wheelset == alert.wheelset,
            ALERTS.c.track_section == alert.track_section,
            ALERTS.c.kind == alert.kind,
            ALERTS.c.alert_id != alert.alert_id,
        )
        other = self.connection.scalar(statement)
        if other is not None:
            raise ConflictError(
                f"alert {other} of kind {alert.kind} is already open for {_subject(alert)}",
                kind="alert",
                key=str(other),
            )

    def _alerts(self, statement: Select[Any]) -> Sequence[Alert]:
        if self.writing:
            serialise(self.connection, Subject.ALERTS)
        return [_alert(row) for row in self.connection.execute(statement).mappings()]

    def _events(self, statement: Select[Any]) -> Sequence[AlertEvent]:
        rows = self.connection.execute(statement.order_by(EVENTS.c.sequence))
        return [
            AlertEvent(row.sequence, AlertEventKind(row.kind), _alert(row.alert), row.recorded_ns, row.actor, row.note)
            for row in rows
        ]


def _open() -> Select[Any]:
    return select(ALERTS).where(ALERTS.c.closed_ns.is_(None))


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
