"""What rows of the worklist are made from, read for many wheelsets at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from sqlalchemy import Column, ColumnElement, Connection, Row, ScalarSelect, select

from estimation.errors import DamagedError
from estimation.values.alerts import Condition, MileageNow, OpenAlert, Severity
from estimation.values.geometry import GeometryRecord
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.runs import code_of_error, first_line
from estimation.values.trend import TREND
from estimation.values.windows import WindowState
from estimation.vehicle.vehicle_class import VehicleClass
from estimation.worklist.row import WorklistInputs
from fleet_db.on_file import VERSION
from fleet_db.registry_events import RecordKind
from fleet_db.rows import table_of
from fleet_db.stores.geometries import GeometryStore
from fleet_db.stores.registry import RegistryStore
from fleet_db.stores.registry_history import is_voided
from fleet_db.stores.trends import TrendStore
from fleet_db.stores.window_counts import refused_by_code
from fleet_db.tables.alerts import AlertRow
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
    vehicles: dict[str, VehicleRecord] = field(default_factory=dict)
    classes: dict[str, VehicleClass | None] = field(default_factory=dict)

    def read(self, serials: Sequence[str]) -> list[WorklistInputs]:
        """Return what is stored of wheelsets that are not voided, by serial; the others are left out.

        Args:
            serials: Some hundreds at most.
        """
        windows, alerts = self._windows_and_alerts(serials)
        records = self.registry.wheelsets_of(serials, voided=False)
        serials = [record.serial for record in records]
        if not serials:
            return []
        self.geometries.read_with([TREND], serials)
        geometries, trends = _readable(self.geometries.current_of, serials), _readable(self.trends.of, serials)
        found = []
        vehicles = {record.mounting.vehicle for record in records if record.mounting is not None}
        self.vehicles.update(self.registry.vehicles_of(vehicles - self.vehicles.keys()))
        damaged = [serial for serial in serials if isinstance(trends.get(serial), Reason)]
        refused = self._refused(records, {**geometries, **{serial: trends[serial] for serial in damaged}})
        for record in records:
            serial, mounting = record.serial, record.mounting
            vehicle = None if mounting is None else self.vehicles[mounting.vehicle]
            last_ns, mileage = windows[serial]
            if mileage is None and mounting is not None:
                mileage = MileageNow(mounting.wheelset_mileage_km, mounting.from_ns)
            current, trend = geometries.get(serial), trends.get(serial)
            failure = next((one for one in (current, trend) if isinstance(one, Reason)), None)
            geometry = None if failure is not None or isinstance(current, Reason) else current
            found.append(
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
        return found

    def _refused(
        self, wheelsets: Sequence[WheelsetRecord], geometries: Mapping[str, object]
    ) -> Mapping[str, Mapping[ReasonCode, int]]:
        """Return what the newest windows of wheelsets are refused for that have no geometry of their profile."""
        without = {}
        for wheelset in wheelsets:
            found = geometries.get(wheelset.serial)
            of_profile = isinstance(found, GeometryRecord) and found.baseline == len(wheelset.reprofilings)
            if not isinstance(found, GeometryRecord) or not found.geometry.windows or not of_profile:
                without[wheelset.serial] = max((one.at_ns for one in wheelset.reprofilings), default=None)
        return refused_by_code(self.connection, without)

    def _class(self, code: str) -> VehicleClass | None:
        """Return a class; None where it is not on file or damaged, which stops nobody from storing."""
        if code not in self.classes:
            try:
                found = self.registry.vehicle_class(code)
            except DamagedError:
                found = None
            self.classes[code] = None if found is None else found.vehicle_class
        return self.classes[code]

    def _windows_and_alerts(
        self, serials: Sequence[str]
    ) -> tuple[Mapping[str, tuple[int | None, MileageNow | None]], Mapping[str, Sequence[OpenAlert]]]:
        """Return the end of the newest usable window and the newest mileage that is believed, and open alerts.

        With the same statement it is asked whether the registry has changed.
        """
        rows = self.connection.execute(_WINDOWS_AND_ALERTS.where(WHEELSETS.c.serial.in_(serials))).all()
        self.registry.once.renew(rows[0].registry if rows else None)
        windows: dict[str, tuple[int | None, MileageNow | None]] = {}
        alerts: dict[str, list[OpenAlert]] = {}
        for row in rows:
            windows[row.serial] = (
                None if row.start_ns is None else row.start_ns + row.length_ns,
                None if row.read_ns is None else MileageNow(row.mileage_km, row.read_ns),
            )
            if row.alert_id is not None:
                alerts.setdefault(row.serial, []).append(_open_alert(row))
        return windows, alerts


def _open_alert(row: Row[Any]) -> OpenAlert:
    return OpenAlert(
        alert_id=row.alert_id,
        kind=row.kind,
        severity=Severity(row.severity),
        condition=Condition(row.condition),
        opened_ns=row.opened_ns,
        acknowledged=row.acknowledged_ns is not None,
        shelved_until_ns=row.shelved_until_ns,
    )


def _readable(
    read: Callable[[Sequence[str]], Mapping[str, Stored]], serials: Sequence[str]
) -> Mapping[str, Stored | Reason]:
    """Return what is stored of wheelsets, by serial; where it cannot be read, why."""
    try:
        return dict(read(serials))
    except DamagedError as error:
        if len(serials) == 1:
            return {serials[0]: Reason(code_of_error(error), first_line(error))}
        return {serial: record for one in serials for serial, record in _readable(read, [one]).items()}


def _newest(column: Column[int] | Column[float], chosen: ColumnElement[bool]) -> ScalarSelect[float]:
    """Return a column of the newest window of a wheelset that is chosen."""
    statement = select(column).where(WINDOWS.c.wheelset == WHEELSETS.c.serial, chosen)
    return statement.order_by(WINDOWS.c.start_ns.desc()).limit(1).correlate(WHEELSETS).scalar_subquery()


USABLE, BELIEVED = WINDOWS.c.state != WindowState.REFUSED.value, WINDOWS.c.implausible_code.is_(None)
_ALERT = ("alert_id", "kind", "severity", "condition", "opened_ns", "acknowledged_ns", "shelved_until_ns")
_WINDOWS_AND_ALERTS = (
    select(
        WHEELSETS.c.serial,
        _newest(WINDOWS.c.start_ns, USABLE).label("start_ns"),
        _newest(WINDOWS.c.length_ns, USABLE).label("length_ns"),
        _newest(WINDOWS.c.start_ns, BELIEVED).label("read_ns"),
        _newest(WINDOWS.c.mileage_km, BELIEVED).label("mileage_km"),
        VERSION.label("registry"),
        *(ALERTS.c[name] for name in _ALERT),
    )
    .outerjoin(ALERTS, (ALERTS.c.wheelset == WHEELSETS.c.serial) & ALERTS.c.closed_ns.is_(None))
    .order_by(ALERTS.c.alert_id)
)


def not_voided(connection: Connection, serials: Sequence[str]) -> list[str]:
    """Return the wheelsets that are on file and not voided, by serial."""
    statement = select(WHEELSETS.c.serial).where(
        WHEELSETS.c.serial.in_(serials), ~is_voided(RecordKind.WHEELSET, WHEELSETS.c.serial)
    )
    return list(connection.scalars(statement.order_by(WHEELSETS.c.serial)))
