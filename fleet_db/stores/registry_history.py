"""What was decided on records of the registry, append-only, and the versions of vehicle classes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, RowMapping, ScalarSelect, and_, case, func, insert, null, select

from estimation.errors import DamagedError, ParameterError
from estimation.values.fields import JsonValue
from estimation.vehicle.vehicle_class import ClassOnFile, VehicleClass, class_digest, class_document, class_of_document
from fleet_db.records import Decision, RecordAction, RecordKind, RegistryEvent
from fleet_db.rows import columns_of, equal, given, table_of, value_of_row
from fleet_db.subjects import RaisingStore
from fleet_db.tables.registry import RegistryEventRow, VehicleClassRow, VehicleRow

EVENTS, VEHICLES, CLASSES = table_of(RegistryEventRow), table_of(VehicleRow), table_of(VehicleClassRow)
Record = Mapping[str, Any] | RowMapping
"""A record by the columns of its table."""
_VOID_OR_NOT = (RecordAction.VOIDED.value, RecordAction.RESTORED.value)


@dataclass(frozen=True, slots=True)
class RecordKey:
    """A record of the registry: its wheelset or section, and its time where that belongs to its key."""

    kind: RecordKind
    subject: str
    at_ns: int | None = None


class RegistryHistoryStore(RaisingStore):
    """Decisions, in one transaction; what rests on a record follows each change of it, noted or not."""

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
        chosen = equal(EVENTS, kind=key.kind, subject=key.subject, action=action)
        chosen.append(EVENTS.c.at_ns.is_(None) if key.at_ns is None else EVENTS.c.at_ns == key.at_ns)
        row = self.connection.execute(select(EVENTS).where(*chosen).order_by(EVENTS.c.id.desc()).limit(1)).first()
        return None if row is None else value_of_row(RegistryEvent, row)

    def note_return(self, key: RecordKey, record: Mapping[str, JsonValue], decision: Decision) -> None:
        """Keep that a voided record is entered again; nothing where it is not voided."""
        if stands_voided(self.connection, key) is not None:
            self.note(key, RecordAction.RESTORED, record, decision)

    def _raise(self, key: RecordKey, *records: Record | None) -> None:
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
        self, subject: str | None = None, after: int | None = None, limit: int = 1000, kind: RecordKind | None = None
    ) -> Sequence[RegistryEvent]:
        """Return at most ``limit`` decisions, on one wheelset, vehicle, class or section or on all, oldest first."""
        chosen = [*equal(EVENTS, kind=kind, subject=subject), *given(after, EVENTS.c.id.__gt__)]
        statement = select(EVENTS).where(*chosen).order_by(EVENTS.c.id).limit(limit)
        return [value_of_row(RegistryEvent, row) for row in self.connection.execute(statement)]


def stands_voided(connection: Connection, key: RecordKey) -> RegistryEvent | None:
    """Return the decision by which an undated record was voided and that none has restored since."""
    chosen = (EVENTS.c.kind == key.kind.value, EVENTS.c.subject == key.subject, EVENTS.c.action.in_(_VOID_OR_NOT))
    row = connection.execute(select(EVENTS).where(*chosen).order_by(EVENTS.c.id.desc()).limit(1)).first()
    return None if row is None or row.action != RecordAction.VOIDED.value else value_of_row(RegistryEvent, row)


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


Shipped = Callable[[str], VehicleClass | None]  # the class of the package by code


def no_class(_code: str) -> VehicleClass | None:
    """Return no class: for a store without classes of the package."""
    return None


def find_class(connection: Connection, code: str, version: int | None) -> ClassOnFile | None:
    """Return a version of a registered class, None for the newest; None where there is none. Raises DamagedError."""
    statement = select(CLASSES).where(*equal(CLASSES, code=code, version=version))
    row = connection.execute(statement.order_by(CLASSES.c.version.desc()).limit(1)).first()
    return None if row is None else _on_file(row)


def newest_classes(connection: Connection, codes: Collection[str] | None = None) -> dict[str, ClassOnFile]:
    """Return the newest version of classes by code, of some or of all, without voided ones. Raises DamagedError."""
    newest = select(CLASSES.c.code, func.max(CLASSES.c.version).label("version")).group_by(CLASSES.c.code)
    of_newest = newest.where(*given(codes, CLASSES.c.code.in_)).subquery()
    statement = select(CLASSES, last_voided(RecordKind.VEHICLE_CLASS, CLASSES.c.code).label("voided")).join(
        of_newest, (of_newest.c.code == CLASSES.c.code) & (of_newest.c.version == CLASSES.c.version)
    )
    classes = {row.code: (_on_file(row), row.voided) for row in connection.execute(statement)}
    return {code: on_file for code, (on_file, voided) in classes.items() if not _is(on_file, voided)}


def taken_out(connection: Connection, newest: ClassOnFile) -> bool:
    """Return whether a class with this newest version was voided and nothing else is in force since."""
    key = RecordKey(RecordKind.VEHICLE_CLASS, newest.vehicle_class.code)
    voided = stands_voided(connection, key)
    return _is(newest, None if voided is None else voided.record)


def _is(on_file: ClassOnFile, record: Mapping[str, JsonValue] | None) -> bool:
    return record is not None and class_digest(class_of_document(record)) == on_file.digest


def store_class(connection: Connection, vehicle_class: VehicleClass, recorded_ns: int) -> ClassOnFile:
    """Store a class as the next version of its code and return that; the content of the newest changes nothing."""
    newest = find_class(connection, vehicle_class.code, None)
    if newest is not None and newest.digest == class_digest(vehicle_class):
        return newest
    stored = ClassOnFile(vehicle_class, 1 if newest is None else newest.version + 1, recorded_ns)
    values = {"code": vehicle_class.code, "version": stored.version, "recorded_ns": recorded_ns}
    connection.execute(insert(CLASSES).values(**values, document=class_document(vehicle_class)))
    return stored


def _on_file(row: Row[Any]) -> ClassOnFile:
    try:
        return ClassOnFile(class_of_document(row.document), row.version, row.recorded_ns)
    except (KeyError, TypeError, ValueError, ParameterError) as error:
        raise DamagedError(f"version {row.version} of vehicle class {row.code!r}: {error}") from error
