"""Versions of vehicle classes: a changed class is a new version, the old one stays for provenance."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

from sqlalchemy import Connection, Row, func, insert, select

from estimation.errors import DamagedError, ParameterError
from estimation.values.fields import JsonValue
from estimation.vehicle.vehicle_class import ClassOnFile, VehicleClass, class_digest, class_document, class_of_document
from fleet_db.registry_events import RecordKind
from fleet_db.rows import table_of
from fleet_db.stores.registry_history import RecordKey, last_voided, stands_voided
from fleet_db.tables.registry import VehicleClassRow

CLASSES = table_of(VehicleClassRow)
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
    newest = select(CLASSES.c.code, func.max(CLASSES.c.version).label("version")).group_by(CLASSES.c.code)
    if codes is not None:
        newest = newest.where(CLASSES.c.code.in_(codes))
    of_newest = newest.subquery()
    statement = select(CLASSES, last_voided(RecordKind.VEHICLE_CLASS, CLASSES.c.code).label("voided")).join(
        of_newest, (of_newest.c.code == CLASSES.c.code) & (of_newest.c.version == CLASSES.c.version)
    )
    found = {row.code: (_on_file(row), row.voided) for row in connection.execute(statement)}
    return {code: on_file for code, (on_file, voided) in found.items() if not _is(on_file, voided)}


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
        raise DamagedError(f"version {row.version} of vehicle class {row.code!r}: {error}") from error
