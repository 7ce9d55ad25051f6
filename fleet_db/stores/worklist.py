"""The worklist: a row a wheelset, made again in every transaction that changes what it shows.

On PostgreSQL a transaction locks the rows before it reads what they are made from, and does so last: of two that touch
one wheelset the second waits, and then reads what the first has committed. Nothing is so ever lost or out of date.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import replace as replaced
from enum import StrEnum
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, delete, exists, insert, select, tuple_

from estimation.errors import NotFoundError
from estimation.values.alerts import Severity, Urgency, WorklistRow
from estimation.values.quantities import Status
from estimation.values.reasons import Reason
from estimation.values.runs import EVERYTHING, code_of_error, first_line
from estimation.worklist.row import FORM, STAGE, WorklistInputs, distance_key, urgency_key, worklist_row
from fleet_db.packed_values import to_document
from fleet_db.rows import insert_new, replace_all, table_of
from fleet_db.stores.stage_marks import MARKS
from fleet_db.stores.worklist_inputs import WorklistReader, not_voided
from fleet_db.subjects import Subjects
from fleet_db.tables.registry import WheelsetRow
from fleet_db.tables.results import WorklistAlertRow, WorklistEntryRow

ENTRIES, KINDS, WHEELSETS = table_of(WorklistEntryRow), table_of(WorklistAlertRow), table_of(WheelsetRow)
AT_ONCE = 500
ALL = 2**31 - 1
_log = logging.getLogger(__name__)


class WorklistOrder(StrEnum):
    """What the worklist can be ordered by."""

    SERIAL = "serial"
    URGENCY = "urgency"
    DISTANCE_TO_LIMIT = "distance_to_limit"
    CONICITY = "conicity"
    TREND = "trend"
    MILEAGE = "mileage"
    LAST_DATA = "last_data"


KEYS = {
    WorklistOrder.URGENCY: ENTRIES.c.urgency_key,
    WorklistOrder.DISTANCE_TO_LIMIT: ENTRIES.c.distance_key,
    WorklistOrder.CONICITY: ENTRIES.c.conicity_key,
    WorklistOrder.TREND: ENTRIES.c.trend_key,
    WorklistOrder.MILEAGE: ENTRIES.c.mileage_key,
    WorklistOrder.LAST_DATA: ENTRIES.c.last_data_ns,
}


@dataclass(frozen=True, slots=True)
class WorklistFilter:
    """Which wheelsets; None is all."""

    fleet: str | None = None
    vehicle: str | None = None
    vehicle_class: str | None = None
    status: Status | None = None
    urgency: Urgency | None = None
    alert_kind: str | None = None
    alert_severity: Severity | None = None  # of the worst open alert


@dataclass(frozen=True, slots=True)
class WorklistPlace:
    """Where a page ended: what orders the last row (None where that is unknown), and its serial."""

    key: float | int | None
    serial: str


@dataclass(frozen=True, slots=True)
class WorklistEntry:
    """A stored row: its document as JSON, and its place in the order asked for."""

    document: str
    place: WorklistPlace


@dataclass(frozen=True, slots=True)
class _Before:
    """What a row said."""

    document: str
    with_alerts: bool


@dataclass(frozen=True, slots=True)
class WorklistStore:
    """Rows of the worklist, in one transaction."""

    connection: Connection
    subjects: Subjects
    reader: WorklistReader

    def page(
        self,
        chosen: WorklistFilter,
        order: WorklistOrder,
        after: WorklistPlace | None,
        limit: int,
        *,
        descending: bool = False,
    ) -> Sequence[WorklistEntry]:
        """Return at most ``limit`` rows behind a place; what is not known comes last in either direction.

        Args:
            order: What they are ordered by; ties by serial, in the same direction.
            after: Place of the last row of the page before.
            limit: How many rows at most.
        """
        base = _chosen(select(ENTRIES.c.wheelset, ENTRIES.c.document), chosen)
        key = KEYS.get(order)
        if key is None:
            return self._entries(_behind(base, None, after, descending=descending).limit(limit))
        rows: list[WorklistEntry] = []
        if after is None or after.key is not None:
            known = base.add_columns(key.label("key")).where(key.is_not(None))
            rows += self._entries(_behind(known, key, after, descending=descending).limit(limit))
            after = None
        if len(rows) < limit and key.nullable:
            unknown = base.where(key.is_(None))
            rows += self._entries(_behind(unknown, None, after, descending=descending).limit(limit - len(rows)))
        return rows

    def documents(self, chosen: WorklistFilter) -> Sequence[str]:
        """Return the documents of all wheelsets that are chosen, by serial."""
        return [entry.document for entry in self.page(chosen, WorklistOrder.SERIAL, None, ALL)]

    def row(self, serial: str) -> str:
        """Return the document of one wheelset.

        Raises:
            NotFoundError: There is none of that serial.
        """
        statement = select(ENTRIES.c.wheelset, ENTRIES.c.document).where(ENTRIES.c.wheelset == serial)
        found = self._entries(statement)
        if not found:
            raise NotFoundError("wheelset", serial)
        return found[0].document

    def refresh(self, serials: Sequence[str]) -> None:
        """Make the rows of wheelsets again; to be the last thing that a transaction does.

        Args:
            serials: In their order, so that no two transactions wait for each other in a circle.
        """
        for part in _parts(serials):
            before = self._locked(part)
            rows = [_row(inputs) for inputs in self.reader.read(sorted(before))]
            self._store(rows, before)
            gone = sorted(before.keys() - {row.wheelset.serial for row in rows})
            if gone:
                self.connection.execute(delete(KINDS).where(KINDS.c.wheelset.in_(gone)))
                self.connection.execute(delete(ENTRIES).where(ENTRIES.c.wheelset.in_(gone)))

    def refresh_all(self) -> None:
        """Make all rows again when this transaction ends."""
        for serial in self.connection.scalars(select(WHEELSETS.c.serial)):
            self.subjects.show(serial)

    def _locked(self, serials: Sequence[str]) -> Mapping[str, _Before]:
        """Lock the rows of wheelsets and return what they say; a row that is missing is added."""
        columns = (ENTRIES.c.wheelset, ENTRIES.c.document, ENTRIES.c.worst_severity)
        locking = select(*columns).where(ENTRIES.c.wheelset.in_(serials)).order_by(ENTRIES.c.wheelset).with_for_update()
        before = {
            row.wheelset: _Before(row.document, with_alerts=row.worst_severity is not None)
            for row in self.connection.execute(locking)
        }
        missing = [serial for serial in serials if serial not in before]
        added = not_voided(self.connection, missing) if missing else ()
        for serial in added:
            insert_new(self.connection, ENTRIES, {**_EMPTY, "wheelset": serial})
        if added:  # the first rows are of this form
            insert_new(self.connection, MARKS, _OF_FORM)
        return before | dict.fromkeys(added, _Before("", with_alerts=False))

    def _store(self, rows: Sequence[WorklistRow], before: Mapping[str, _Before]) -> None:
        """Store rows whose entries are there, with the kinds of their alerts, where they are others now."""
        changed, kinds = [], []
        for row in rows:
            values = _values(row)
            if before[row.wheelset.serial].document != values["document"]:
                changed.append(values)
                alerts = dict.fromkeys(one.kind for one in row.state.alerts)
                kinds += [{"kind": kind, "wheelset": row.wheelset.serial} for kind in alerts]
        if changed:
            replace_all(self.connection, ENTRIES, changed)
        had = [one["wheelset"] for one in changed if before[one["wheelset"]].with_alerts]
        if had:
            self.connection.execute(delete(KINDS).where(KINDS.c.wheelset.in_(had)))
        if kinds:
            self.connection.execute(insert(KINDS), kinds)

    def _entries(self, statement: Select[Any]) -> list[WorklistEntry]:
        rows = self.connection.execute(statement).all()
        return [WorklistEntry(row.document, WorklistPlace(_key(row), row.wheelset)) for row in rows]


_EMPTY = {
    "fleet": "",
    "status": Status.UNESTIMATED.value,
    "urgency": Urgency.UNKNOWN.value,
    "urgency_key": 0.0,
    "document": "",
}

_OF_FORM = {"stage": STAGE, "subject": EVERYTHING, "seen": 0, "common": str(FORM), "made_from": "", "again_ns": None}


def _row(inputs: WorklistInputs) -> WorklistRow:
    """Return the row of a wheelset; one whose results the program fails at says so."""
    try:
        return worklist_row(inputs)
    except Exception as error:  # noqa: BLE001 - the transaction stores what it is there for, whatever the row says
        _log.exception("worklist: the results of wheelset %s cannot be used", inputs.wheelset.serial)
        failure = Reason(code_of_error(error), first_line(error))
        return worklist_row(replaced(inputs, geometry=None, trend=None, failure=failure))


def _chosen(statement: Select[Any], chosen: WorklistFilter) -> Select[Any]:
    wanted = {
        "fleet": chosen.fleet,
        "vehicle": chosen.vehicle,
        "vehicle_class": chosen.vehicle_class,
        "status": chosen.status,
        "urgency": chosen.urgency,
        "worst_severity": chosen.alert_severity,
    }
    for name, value in wanted.items():
        if value is not None:
            statement = statement.where(ENTRIES.c[name] == str(value))
    if chosen.alert_kind is not None:
        statement = statement.where(
            exists().where(KINDS.c.kind == chosen.alert_kind, KINDS.c.wheelset == ENTRIES.c.wheelset)
        )
    return statement


def _behind(
    statement: Select[Any], key: ColumnElement[Any] | None, after: WorklistPlace | None, *, descending: bool
) -> Select[Any]:
    """Return the statement in its order, from behind a place on."""
    columns = [ENTRIES.c.wheelset] if key is None else [key, ENTRIES.c.wheelset]
    if after is not None:
        ours = tuple_(*columns)
        place = tuple_(after.serial) if key is None else tuple_(after.key, after.serial)
        statement = statement.where(ours < place if descending else ours > place)
    return statement.order_by(*(column.desc() if descending else column for column in columns))


def _key(row: Row[Any]) -> float | int | None:
    found: float | int | None = row._mapping.get("key")  # noqa: SLF001 - SQLAlchemy's public name for the columns
    return found


def _values(row: WorklistRow) -> dict[str, Any]:
    state, mounting = row.state, row.wheelset.mounting
    return {
        "wheelset": row.wheelset.serial,
        "fleet": row.wheelset.fleet,
        "vehicle": None if mounting is None else mounting.vehicle,
        "vehicle_class": row.vehicle_class,
        "status": state.status.value,
        "urgency": state.urgency.value,
        "worst_severity": state.alerts[0].severity.value if state.alerts else None,
        "urgency_key": urgency_key(state),
        "distance_key": distance_key(state),
        "conicity_key": state.conicity.value,
        "trend_key": state.slope_per_1000_km.value,
        "mileage_key": None if state.mileage is None else state.mileage.mileage_km,
        "last_data_ns": state.last_data_ns,
        "document": to_document(row),
    }


def _parts(serials: Sequence[str]) -> Iterator[Sequence[str]]:
    return (serials[first : first + AT_ONCE] for first in range(0, len(serials), AT_ONCE))
