"""Measured profiles of wheelsets."""

from __future__ import annotations

import base64
from collections.abc import Collection, Sequence
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, func, select

from estimation.contact.profiles import MeasuredProfiles
from fleet_db.packed_values import pack_wheel_pair, unpack_wheel_pair
from fleet_db.rows import table_of, upsert
from fleet_db.tables import MeasuredProfilesRow, WheelsetRow

MEASURED, WHEELSETS = table_of(MeasuredProfilesRow), table_of(WheelsetRow)


def measured_profiles_of(connection: Connection, wheelset: str) -> Sequence[MeasuredProfiles]:
    """Return every measurement of a wheelset, oldest first."""
    statement = select(MEASURED).where(MEASURED.c.wheelset == wheelset).order_by(MEASURED.c.at_ns)
    return [_to_measured(row) for row in connection.execute(statement)]


def newest_measurement_of(connection: Connection, wheelsets: Collection[str]) -> dict[str, tuple[int, float]]:
    """Return time (ns UTC) and mileage (km) of the newest measurement of each wheelset that has one, by serial."""
    statement = select(MEASURED.c.wheelset, MEASURED.c.at_ns, MEASURED.c.mileage_km)
    statement = statement.where(MEASURED.c.wheelset.in_(wheelsets)).order_by(MEASURED.c.at_ns)
    return {wheelset: (int(at_ns), float(mileage)) for wheelset, at_ns, mileage in connection.execute(statement)}


def newest_measurements(
    connection: Connection, fleet: str | None, from_ns: int | None, to_ns: int | None, limit: int
) -> tuple[int, list[tuple[str, int]]]:
    """Return how many measurements there are in ``[from_ns, to_ns)``, and wheelset and time of the newest ``limit``."""
    wanted: list[ColumnElement[bool]] = []
    if fleet is not None:
        wanted.append(MEASURED.c.wheelset.in_(select(WHEELSETS.c.serial).where(WHEELSETS.c.fleet == fleet)))
    if from_ns is not None:
        wanted.append(MEASURED.c.at_ns >= from_ns)
    if to_ns is not None:
        wanted.append(MEASURED.c.at_ns < to_ns)
    total = connection.scalar(select(func.count()).select_from(MEASURED).where(*wanted)) or 0
    newest = select(MEASURED.c.wheelset, MEASURED.c.at_ns).where(*wanted)
    newest = newest.order_by(MEASURED.c.at_ns.desc(), MEASURED.c.wheelset).limit(limit)
    return total, [(row.wheelset, row.at_ns) for row in connection.execute(newest)]


def store_measured_profiles(connection: Connection, record: MeasuredProfiles) -> bool:
    """Store a measurement of a wheelset that exists, or change the one of the same time; return whether it changed."""
    row = {"wheelset": record.wheelset, "at_ns": record.at_ns, "mileage_km": record.mileage_km, "std_m": record.std}
    return upsert(connection, MEASURED, row | {"packed": pack_wheel_pair(record.left, record.right)})


def stored_measurement(connection: Connection, wheelset: str, at_ns: int) -> dict[str, Any] | None:
    """Return the row of a measurement as JSON can hold it, its profiles in base64; None where there is none."""
    same = (MEASURED.c.wheelset == wheelset, MEASURED.c.at_ns == at_ns)
    row = connection.execute(select(MEASURED).where(*same)).mappings().first()
    return None if row is None else dict(row) | {"packed": base64.b64encode(row["packed"]).decode("ascii")}


def _to_measured(row: Row[Any]) -> MeasuredProfiles:
    where = f"profiles of wheelset {row.wheelset!r} measured at {row.at_ns}"
    left, right = unpack_wheel_pair(row.packed, where=where)
    return MeasuredProfiles(row.wheelset, row.at_ns, row.mileage_km, left, right, row.std_m)
