"""What was decided on records of the registry, append-only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Connection, RowMapping, ScalarSelect, and_, case, func, insert, null, select

from estimation.values.fields import JsonValue
from fleet_db.registry_events import Decision, RecordAction, RecordKind, RegistryEvent
from fleet_db.rows import columns_of, table_of, value_of_row
from fleet_db.subjects import Subjects
from fleet_db.tables.registry import RegistryEventRow, VehicleRow

EVENTS, VEHICLES = table_of(RegistryEventRow), table_of(VehicleRow)
Record = Mapping[str, Any] | RowMapping
"""A record by the columns of its table."""
_VOID_OR_NOT = (RecordAction.VOIDED.value, RecordAction.RESTORED.value)


@dataclass(frozen=True, slots=True)
class RecordKey:
    """A record of the registry: its wheelset or section, and its time where that belongs to its key."""

    kind: RecordKind
    subject: str
    at_ns: int | None = None


@dataclass(frozen=True, slots=True)
class RegistryHistoryStore:
    """Decisions, in one transaction; what rests on a record follows each change of it, noted or not."""

    connection: Connection
    subjects: Subjects

    def note(
        self,
        key: RecordKey,
        action: RecordAction,
        record: Mapping[str, JsonValue],
        decision: Decision,
        after: Mapping[str, JsonValue] | None = None,
    ) -> None:
        """Append a decision on a record: what it was before, and what it is afterwards where it is on file then."""
        self._raise(key, record, after)
        records = {"record": dict(record), "after": null() if after is None else dict(after)}
        values = {**columns_of(key), "action": action.value, **records, **columns_of(decision)}
        self.connection.execute(insert(EVENTS).values(**values))

    def note_change(self, key: RecordKey, was: Record | None, now: Record | None, decision: Decision) -> None:
        """Keep what a record was before it was changed and is since; that it is new where somebody has entered it.

        What a file brings in the first place, and nobody has put his name to, is in the file.
        """
        if was is None and not decision.actor:
            self._raise(key, now)
            return
        action = RecordAction.ENTERED if was is None else RecordAction.CHANGED
        before = {} if was is None else {str(name): value for name, value in was.items()}
        self.note(key, action, before, decision, None if now is None else dict(now))

    def latest(self, key: RecordKey, action: RecordAction | None = None) -> RegistryEvent | None:
        """Return the last decision on a record, or the last of one action; None where there is none."""
        chosen = [EVENTS.c.kind == key.kind.value, EVENTS.c.subject == key.subject]
        chosen.append(EVENTS.c.at_ns.is_(None) if key.at_ns is None else EVENTS.c.at_ns == key.at_ns)
        if action is not None:
            chosen.append(EVENTS.c.action == action.value)
        row = self.connection.execute(select(EVENTS).where(*chosen).order_by(EVENTS.c.id.desc()).limit(1)).first()
        return None if row is None else value_of_row(RegistryEvent, row)

    def note_return(self, key: RecordKey, record: Mapping[str, JsonValue], decision: Decision) -> None:
        """Keep that a voided record is entered again; nothing where it is not voided."""
        if stands_voided(self.connection, key) is not None:
            self.note(key, RecordAction.RESTORED, record, decision)

    def _raise(self, key: RecordKey, *records: Record | None) -> None:
        """Let what rests on a record follow."""
        self.subjects.registry()
        if key.kind is RecordKind.SENSOR_CHANGE or key.kind is RecordKind.VEHICLE:
            self.subjects.vehicle_on_file(key.subject)
        elif key.kind is RecordKind.VEHICLE_CLASS:
            of_class = select(VEHICLES.c.code).where(VEHICLES.c.vehicle_class == key.subject)
            for vehicle in self.connection.scalars(of_class).all():
                self.subjects.vehicle_on_file(vehicle)
        elif key.kind is RecordKind.SECTION:
            self.subjects.section_on_file(key.subject)
        else:
            self.subjects.wheelset_on_file(key.subject)
        if key.kind is RecordKind.MOUNTING:  # the wheelsets beside it have another beside them
            for vehicle in {str(record["vehicle"]) for record in records if record}:
                self.subjects.vehicle_on_file(vehicle)

    def list(
        self,
        subject: str | None = None,
        after: int | None = None,
        limit: int = 1000,
        kind: RecordKind | None = None,
    ) -> Sequence[RegistryEvent]:
        """Return at most ``limit`` decisions, on one wheelset, vehicle, class or section or on all, oldest first."""
        statement = select(EVENTS).order_by(EVENTS.c.id).limit(limit)
        if kind is not None:
            statement = statement.where(EVENTS.c.kind == kind.value)
        if subject is not None:
            statement = statement.where(EVENTS.c.subject == subject)
        if after is not None:
            statement = statement.where(EVENTS.c.id > after)
        return [value_of_row(RegistryEvent, row) for row in self.connection.execute(statement)]


def stands_voided(connection: Connection, key: RecordKey) -> RegistryEvent | None:
    """Return the decision by which an undated record was voided and that none has restored since."""
    chosen = (EVENTS.c.kind == key.kind.value, EVENTS.c.subject == key.subject, EVENTS.c.action.in_(_VOID_OR_NOT))
    row = connection.execute(select(EVENTS).where(*chosen).order_by(EVENTS.c.id.desc()).limit(1)).first()
    found = None if row is None else value_of_row(RegistryEvent, row)
    return found if found is not None and found.action is RecordAction.VOIDED else None


def last_voided(kind: RecordKind, subject: ColumnElement[str]) -> ScalarSelect[Mapping[str, JsonValue]]:
    """Return the record that the last decision on an undated one has voided; null where it has restored one."""
    record = case((EVENTS.c.action == RecordAction.VOIDED.value, EVENTS.c.record), else_=null())
    chosen = (EVENTS.c.kind == kind.value, EVENTS.c.subject == subject, EVENTS.c.action.in_(_VOID_OR_NOT))
    return select(record).where(*chosen).order_by(EVENTS.c.id.desc()).limit(1).scalar_subquery()


def is_voided(kind: RecordKind, subject: ColumnElement[str]) -> ColumnElement[bool]:
    """Return whether the last decision on an undated record voided it."""
    decided = and_(EVENTS.c.kind == kind.value, EVENTS.c.action.in_(_VOID_OR_NOT))
    last = select(func.max(EVENTS.c.id).label("id")).where(decided).group_by(EVENTS.c.subject).subquery()
    voided = select(EVENTS.c.subject).join(last, EVENTS.c.id == last.c.id)
    return subject.in_(voided.where(EVENTS.c.action == RecordAction.VOIDED.value))
