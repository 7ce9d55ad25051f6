"""Sensors that were exchanged or calibrated, one record a vehicle and time."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import Connection, delete, func, select

from estimation.errors import ConflictError, ParameterError
from estimation.values.reasons import utc_text
from estimation.values.registry import SensorChange, SensorWork
from fleet_db.locks import Subject, serialise
from fleet_db.registry_events import Decision, RecordKind
from fleet_db.rows import columns_of, table_of, upsert
from fleet_db.stores.registry_history import RecordKey, RegistryHistoryStore
from fleet_db.subjects import Subjects
from fleet_db.tables.registry import SensorChangeRow

CHANGES = table_of(SensorChangeRow)


@dataclass(frozen=True, slots=True)
class SensorChangeStore:
    """When the sensors of an axle were exchanged or calibrated."""

    connection: Connection
    subjects: Subjects

    def list(self, vehicle: str) -> Sequence[SensorChange]:
        """Return what was done to the sensors of a vehicle, oldest first."""
        statement = select(CHANGES).where(CHANGES.c.vehicle == vehicle).order_by(CHANGES.c.at_ns)
        return [sensor_change_of(row) for row in self.connection.execute(statement).mappings()]

    def newest(self, vehicles: Collection[str]) -> Mapping[tuple[str, int], int]:
        """Return by vehicle and axle when something was done last to the sensors, ns UTC."""
        axle = (CHANGES.c.vehicle, CHANGES.c.axle)
        statement = select(*axle, func.max(CHANGES.c.at_ns)).where(CHANGES.c.vehicle.in_(vehicles)).group_by(*axle)
        return {(vehicle, axle): at_ns for vehicle, axle, at_ns in self.connection.execute(statement)}

    def add(self, record: SensorChange, axles: int, decision: Decision) -> bool:
        """Add a record, or change the one of that vehicle, axle and time; ConflictError: another axle has one then."""
        serialise(self.connection, Subject.REGISTRY)
        if not 1 <= record.axle <= axles:
            raise ParameterError(f"vehicle {record.vehicle!r} has axles 1 to {axles}, not {record.axle}", field="axle")
        was = self.stored(record.vehicle, record.at_ns)
        if was is not None and was["axle"] != record.axle:
            place = f"axle {was['axle']} of vehicle {record.vehicle!r}"
            reason = f"{place} has one of {utc_text(record.at_ns)}; give another time"
            raise ConflictError(reason, kind="sensor change", key=record.vehicle)
        values = columns_of(record)
        if not upsert(self.connection, CHANGES, values):
            return False
        key = RecordKey(RecordKind.SENSOR_CHANGE, record.vehicle, record.at_ns)
        RegistryHistoryStore(self.connection, self.subjects).note_change(key, was, values, decision)
        return True

    def remove(self, vehicle: str, at_ns: int) -> None:
        """Remove the record of a vehicle and time, if there is one."""
        self.connection.execute(delete(CHANGES).where(CHANGES.c.vehicle == vehicle, CHANGES.c.at_ns == at_ns))

    def stored(self, vehicle: str, at_ns: int) -> dict[str, Any] | None:
        """Return the row of a vehicle and time; None where there is none."""
        statement = select(CHANGES).where(CHANGES.c.vehicle == vehicle, CHANGES.c.at_ns == at_ns)
        row = self.connection.execute(statement).mappings().first()
        return None if row is None else dict(row)


def sensor_change_of(values: Mapping[Any, Any]) -> SensorChange:
    """Return the value of a row, or of what the history keeps of one."""
    record = SensorChange(**{str(name): value for name, value in values.items()})
    return replace(record, work=SensorWork(record.work))
