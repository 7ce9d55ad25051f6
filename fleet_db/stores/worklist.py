"""The worklist: a row a wheelset, made again in every transaction that changes what it shows.

On PostgreSQL a transaction locks the rows, as its last step, before it reads what they are made from: of two that touch
one wheelset the second waits, and then reads what the first has committed. So no change is lost.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, TypeVar

from sqlalchemy import Column, ColumnElement, Connection, ScalarSelect, Select, delete, insert, select, tuple_

from estimation.errors import DamagedError
from estimation.values.alerts import MileageNow, OpenAlert, Severity, Urgency, WorklistRow
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import WheelsetRecord
from estimation.values.runs import EVERYTHING, code_of_error, first_line
from estimation.values.trend import TREND
from estimation.values.windows import WindowState
from estimation.vehicle.vehicle_class import VehicleClass
from estimation.worklist.stored import FORM, STAGE, WorklistInputs
from fleet_db.packed_values import to_document
from fleet_db.records import RecordKind
from fleet_db.rows import batches, equal, given, insert_new, present, replace_all, table_of, value_of_row
from fleet_db.stores.geometries import GeometryStore, TrendStore
from fleet_db.stores.registry import RegistryStore
from fleet_db.stores.registry_history import is_voided
from fleet_db.stores.stage_marks import MARKS
from fleet_db.stores.window_counts import refused_by_code
from fleet_db.subjects import REGISTRY_VERSION, Subjects
from fleet_db.tables.alerts import AlertRow
from fleet_db.tables.operation import WorklistAlertRow, WorklistEntryRow
from fleet_db.tables.registry import WheelsetRow
from fleet_db.tables.windows import WindowRow

Stored = TypeVar("Stored")
ALERTS, WINDOWS, WHEELSETS = table_of(AlertRow), table_of(WindowRow), table_of(WheelsetRow)


@dataclass(frozen=True, slots=True)
class WorklistReader:
    """Reads what is stored of wheelsets, in one transaction; locks nothing."""

    connection: Connection
    registry: RegistryStore
    geometries: GeometryStore
    trends: TrendStore
    classes: dict[str, VehicleClass | None] = field(default_factory=dict)

    def read(self, serials: Sequence[str]) -> list[WorklistInputs]:
        """Return what is stored of some hundred wheelsets that are not voided, by serial; the others are left out."""
        windows, alerts = self._windows_and_alerts(serials)
        records = self.registry.wheelsets_of(serials, voided=False)
        serials = [record.serial for record in records]
        if not serials:
            return []
        self.geometries.read_with([TREND], serials)
        geometries, trends = _readable(self.geometries.current_of, serials), _readable(self.trends.of, serials)
        stored = []
        mountings = [record.mounting for record in records]
        vehicles = self.registry.vehicles_of({mounting.vehicle for mounting in mountings if mounting is not None})
        damaged = [serial for serial in serials if isinstance(trends.get(serial), Reason)]
        refused = self._refused(records, {**geometries, **{serial: trends[serial] for serial in damaged}})
        for record in records:
            serial, mounting = record.serial, record.mounting
            vehicle = None if mounting is None else vehicles[mounting.vehicle]
            last_ns, mileage = windows[serial]
            if mounting is not None and (mileage is None or mileage.at_ns < mounting.from_ns):
                mileage = MileageNow(mounting.wheelset_mileage_km, mounting.from_ns)
            current, trend = geometries.get(serial), trends.get(serial)
            failure = next((result for result in (current, trend) if isinstance(result, Reason)), None)
            geometry = None if failure is not None or isinstance(current, Reason) else current
            stored.append(
                WorklistInputs(
                    wheelset=record,
                    vehicle=vehicle,
                    vehicle_class=None if vehicle is None else self._class(vehicle.vehicle_class),
                    geometry=geometry,
                    trend=None if failure is not None or isinstance(trend, Reason) else trend,
                    last_window_ns=last_ns,
                    mileage=mileage,
                    alerts=alerts.get(serial, ()),
                    failure=failure,
                    refused=refused.get(serial, {}),
                )
            )
        return stored

    def _refused(
        self, wheelsets: Sequence[WheelsetRecord], geometries: Mapping[str, object]
    ) -> Mapping[str, Mapping[ReasonCode, int]]:
        """Count the newest refused windows, by reason, of wheelsets without a geometry of their present profile."""
        without = {}
        for wheelset in wheelsets:
            record, turned = geometries.get(wheelset.serial), wheelset.reprofilings
            if not (isinstance(record, GeometryRecord) and record.geometry.windows and record.baseline == len(turned)):
                without[wheelset.serial] = max((reprofiling.at_ns for reprofiling in turned), default=None)
        return refused_by_code(self.connection, without)

    def _class(self, code: str) -> VehicleClass | None:
        """Return a class; None where it is not on file or damaged, which stops nobody from storing."""
        if code not in self.classes:
            try:
                on_file = self.registry.vehicle_class(code)
            except DamagedError:
                on_file = None
            self.classes[code] = None if on_file is None else on_file.vehicle_class
        return self.classes[code]

    def _windows_and_alerts(
        self, serials: Sequence[str]
    ) -> tuple[Mapping[str, tuple[int | None, MileageNow | None]], Mapping[str, Sequence[OpenAlert]]]:
        """Return end of the newest usable window, mileage believed, open alerts; note which registry was read."""
        rows = self.connection.execute(_WINDOWS_AND_ALERTS.where(WHEELSETS.c.serial.in_(serials))).all()
        self.registry.once.renew(rows[0].registry if rows else None)
        windows: dict[str, tuple[int | None, MileageNow | None]] = {}
        alerts: dict[str, list[OpenAlert]] = {}
        for row in rows:
            windows[row.serial] = (
                None if row.start_ns is None else row.start_ns + row.length_ns,
                None if row.mileage_at_ns is None else MileageNow(row.mileage_km, row.mileage_at_ns),
            )
            if row.alert_id is not None:
                alert = value_of_row(OpenAlert, row, acknowledged=row.acknowledged_ns is not None)
                alerts.setdefault(row.serial, []).append(alert)
        return windows, alerts


def _readable(
    read: Callable[[Sequence[str]], Mapping[str, Stored]], serials: Sequence[str]
) -> Mapping[str, Stored | Reason]:
    """Return what is stored of wheelsets, by serial; where it cannot be read, why."""
    try:
        return dict(read(serials))
    except DamagedError as error:
        if len(serials) == 1:
            return {serials[0]: Reason(code_of_error(error), first_line(error))}
        return {serial: record for single in serials for serial, record in _readable(read, [single]).items()}


def _newest(column: Column[int] | Column[float], chosen: ColumnElement[bool]) -> ScalarSelect[float]:
    statement = select(column).where(WINDOWS.c.wheelset == WHEELSETS.c.serial, chosen)
    return statement.order_by(WINDOWS.c.start_ns.desc()).limit(1).correlate(WHEELSETS).scalar_subquery()


USABLE, BELIEVED = WINDOWS.c.state != WindowState.REFUSED.value, WINDOWS.c.implausible_code.is_(None)
_ALERT = ("alert_id", "kind", "severity", "condition", "opened_ns", "acknowledged_ns", "shelved_until_ns")
_WINDOWS_AND_ALERTS = (
    select(
        WHEELSETS.c.serial,
        _newest(WINDOWS.c.start_ns, USABLE).label("start_ns"),
        _newest(WINDOWS.c.length_ns, USABLE).label("length_ns"),
        _newest(WINDOWS.c.start_ns, BELIEVED).label("mileage_at_ns"),
        _newest(WINDOWS.c.mileage_km, BELIEVED).label("mileage_km"),
        REGISTRY_VERSION.label("registry"),
        *(ALERTS.c[name] for name in _ALERT),
    )
    .outerjoin(ALERTS, (ALERTS.c.wheelset == WHEELSETS.c.serial) & ALERTS.c.closed_ns.is_(None))
    .order_by(ALERTS.c.alert_id)
)


ENTRIES, KINDS = table_of(WorklistEntryRow), table_of(WorklistAlertRow)
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
    """Where a page ended: what orders the last row (None where that is unknown or the serial orders), its serial."""

    key: float | int | None
    serial: str


@dataclass(frozen=True, slots=True)
class WorklistEntry:
    """A stored row: its document as JSON, and its place in the order asked for."""

    document: str
    place: WorklistPlace


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
        """Return at most ``limit`` rows behind a place, ties by serial; what is not known comes last either way."""
        base = _chosen(select(ENTRIES.c.wheelset, ENTRIES.c.document), chosen)
        key = KEYS.get(order)
        if key is None:
            return self._entries(_behind(base, None, after, descending=descending).limit(limit))
        rows: list[WorklistEntry] = []
        if after is None or after.key is not None:
            with_key = base.add_columns(key.label("key")).where(key.is_not(None))
            rows += self._entries(_behind(with_key, key, after, descending=descending).limit(limit))
            after = None
        if len(rows) < limit and key.nullable:
            unknown = base.where(key.is_(None))
            rows += self._entries(_behind(unknown, None, after, descending=descending).limit(limit - len(rows)))
        return rows

    def documents(self, chosen: WorklistFilter) -> Sequence[str]:
        """Return the documents of all wheelsets that are chosen, by serial."""
        return [entry.document for entry in self.page(chosen, WorklistOrder.SERIAL, None, ALL)]

    def row(self, serial: str) -> str:
        """Return the document of one wheelset; raises NotFoundError."""
        of_wheelset = select(ENTRIES.c.document).where(ENTRIES.c.wheelset == serial)
        return str(present(self.connection.scalar(of_wheelset), "wheelset", serial))

    def refresh(self, serials: Sequence[str]) -> None:
        """Make the rows of wheelsets again, in their order: the last thing that a transaction does."""
        for some in batches(serials):
            before = self._locked(some)
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

    def _locked(self, serials: Sequence[str]) -> Mapping[str, tuple[str, str | None]]:
        """Lock the rows of wheelsets that are not voided, new ones too; return document and worst severity of each."""
        columns = (ENTRIES.c.wheelset, ENTRIES.c.document, ENTRIES.c.worst_severity)
        locking = select(*columns).where(ENTRIES.c.wheelset.in_(serials)).order_by(ENTRIES.c.wheelset).with_for_update()
        before = {wheelset: (document, severity) for wheelset, document, severity in self.connection.execute(locking)}
        missing = [serial for serial in serials if serial not in before]
        not_voided = (WHEELSETS.c.serial.in_(missing), ~is_voided(RecordKind.WHEELSET, WHEELSETS.c.serial))
        serials_added = select(WHEELSETS.c.serial).where(*not_voided).order_by(WHEELSETS.c.serial)
        added = self.connection.scalars(serials_added).all() if missing else ()
        for serial in added:
            insert_new(self.connection, ENTRIES, {**_EMPTY, "wheelset": serial})
        if added:  # a mark that is there stays: without one all rows are of this form
            insert_new(self.connection, MARKS, _OF_FORM)
        return before | dict.fromkeys(added, ("", None))

    def _store(self, rows: Sequence[WorklistRow], before: Mapping[str, tuple[str, str | None]]) -> None:
        changed, kinds = [], []
        for row in rows:
            values = _values(row)
            if before[row.wheelset.serial][0] != values["document"]:
                changed.append(values)
                of_alerts = dict.fromkeys(alert.kind for alert in row.state.alerts)
                kinds += [{"kind": kind, "wheelset": row.wheelset.serial} for kind in of_alerts]
        replace_all(self.connection, ENTRIES, changed)
        with_alerts_before = [values["wheelset"] for values in changed if before[values["wheelset"]][1] is not None]
        if with_alerts_before:
            self.connection.execute(delete(KINDS).where(KINDS.c.wheelset.in_(with_alerts_before)))
        if kinds:
            self.connection.execute(insert(KINDS), kinds)

    def _entries(self, statement: Select[Any]) -> list[WorklistEntry]:
        rows = self.connection.execute(statement).mappings().all()
        return [WorklistEntry(row["document"], WorklistPlace(row.get("key"), row["wheelset"])) for row in rows]


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
    from estimation.worklist.row import worklist_row  # noqa: PLC0415 - commands that change no row start faster

    try:
        return worklist_row(inputs)
    except Exception as error:  # noqa: BLE001 - a row that cannot be made must not stop the transaction
        _log.exception("worklist: the results of wheelset %s cannot be used", inputs.wheelset.serial)
        failure = Reason(code_of_error(error), first_line(error))
        return worklist_row(replace(inputs, geometry=None, trend=None, failure=failure))


def _chosen(statement: Select[Any], chosen: WorklistFilter) -> Select[Any]:
    wanted = {name: getattr(chosen, name) for name in ("fleet", "vehicle", "vehicle_class", "status", "urgency")}
    statement = statement.where(*equal(ENTRIES, **wanted, worst_severity=chosen.alert_severity))
    with_alert = select(KINDS.c.wheelset).where(KINDS.c.wheelset == ENTRIES.c.wheelset)
    return statement.where(*given(chosen.alert_kind, lambda kind: with_alert.where(KINDS.c.kind == kind).exists()))


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
        "urgency_key": state.urgency_key,
        "distance_key": state.distance_key,
        "conicity_key": state.conicity.value,
        "trend_key": state.slope_per_1000_km.value,
        "mileage_key": None if state.mileage is None else state.mileage.mileage_km,
        "last_data_ns": state.last_data_ns,
        "document": to_document(row),
    }
