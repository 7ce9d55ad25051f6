"""Versions of vehicle classes: a changed class is a new version, the old one stays for provenance."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

from sqlalchemy import Connection, Row, Select, func, insert, select

from estimation.errors import DamagedError, ParameterError
from estimation.values.fields import JsonValue
from estimation.values.registry import VehicleRecord
from estimation.vehicle.vehicle_class import ClassOnFile, VehicleClass, class_digest, class_document, class_of_document
from fleet_db.registry_events import RecordKind
from fleet_db.rows import table_of, value_of_row
from fleet_db.stores.registry_history import RecordKey, last_voided, stands_voided
from fleet_db.tables.registry import VehicleClassRow, VehicleRow

CLASSES, VEHICLES = table_of(VehicleClassRow), table_of(VehicleRow)
Shipped = Callable[[str], VehicleClass | None]  # the class of the package by code


def no_class(_code: str) -> VehicleClass | None:
    """Return no class: for a store without classes of the package."""
    return None


def find_class(connection: Connection, code: str, version: int | None) -> ClassOnFile | None:
    """Return a version of a registered class, None for the newest; None where there is none. Raises DamagedError."""
    statement = select(CLASSES).where(CLASSES.c.code == code)
    if version is not None:
        statement = statement.where(CLASSES.c.version == version)
    row = connection.execute(statement.order_by(CLASSES.c.version.desc()).limit(1)).first()
    return None if row is None else _on_file(row)


def newest_classes(connection: Connection, codes: Collection[str] | None = None) -> dict[str, ClassOnFile]:
    """Return the newest version of classes by code, of some or of all, without voided ones. Raises DamagedError."""
    chosen = _newest() if codes is None else _newest().where(CLASSES.c.code.in_(codes))
    found = {row.code: _in_force(row) for row in connection.execute(chosen)}
    return {code: on_file for code, on_file in found.items() if on_file is not None}


def classes_of_vehicles(
    connection: Connection, codes: Collection[str]
) -> dict[str, tuple[VehicleRecord, ClassOnFile | None]]:
    """Return vehicles with the newest version of their class as :func:`newest_classes` does, by code."""
    newest, found = _newest().subquery(), dict[str, ClassOnFile | None]()
    names = ("version", "document", "recorded_ns", "voided")
    columns = (newest.c.code.label("class_code"), *(newest.c[name] for name in names))
    joined = select(VEHICLES, *columns).outerjoin_from(VEHICLES, newest, newest.c.code == VEHICLES.c.vehicle_class)
    vehicles = {}
    for row in connection.execute(joined.where(VEHICLES.c.code.in_(codes)).order_by(VEHICLES.c.code)):
        vehicle = value_of_row(VehicleRecord, row)
        if vehicle.vehicle_class not in found:
            found[vehicle.vehicle_class] = None if row.class_code is None else _in_force(row)
        vehicles[vehicle.code] = (vehicle, found[vehicle.vehicle_class])
    return vehicles


def _newest() -> Select[Any]:
    newer = CLASSES.alias("newer")
    last = select(func.max(newer.c.version)).where(newer.c.code == CLASSES.c.code).scalar_subquery()
    voided = last_voided(RecordKind.VEHICLE_CLASS, CLASSES.c.code).label("voided")
    return select(CLASSES, voided).where(CLASSES.c.version == last)


def _in_force(row: Row[Any]) -> ClassOnFile | None:
    on_file = _on_file(row)
    return None if _is(on_file, row.voided) else on_file


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
    values = {
        "code": vehicle_class.code,
        "version": stored.version,
        "document": class_document(vehicle_class),
        "recorded_ns": recorded_ns,
    }
    connection.execute(insert(CLASSES).values(**values))
    return stored


def _on_file(row: Row[Any]) -> ClassOnFile:
    try:
        return ClassOnFile(class_of_document(row.document), row.version, row.recorded_ns)
    except (KeyError, TypeError, ValueError, ParameterError) as error:
        code = getattr(row, "class_code", row.code)
        raise DamagedError(f"version {row.version} of vehicle class {code!r}: {error}") from error
