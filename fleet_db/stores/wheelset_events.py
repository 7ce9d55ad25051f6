"""What happens to wheelsets: mountings, visits to the lathe, measurements of profiles; and to sensors beside them."""

from __future__ import annotations

import base64
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Table, and_, delete, exists, func, or_, select

from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import ConflictError, ParameterError
from estimation.values.reasons import utc_text
from estimation.values.registry import Mounting, Reprofiling, SensorChange
from fleet_db.locks import Subject, serialise
from fleet_db.packed_values import pack_wheel_pair, unpack_wheel_pair
from fleet_db.records import Decision, RecordKind
from fleet_db.rows import batches, columns_of, given, grouped, row_of, table_of, upsert, value_of_row
from fleet_db.stores.registry_history import RecordKey, RegistryHistoryStore
from fleet_db.subjects import RaisingStore
from fleet_db.tables.recordings import StaleSpanRow
from fleet_db.tables.registry import MeasuredProfilesRow, MountingRow, ReprofilingRow, SensorChangeRow, WheelsetRow
from fleet_db.tables.windows import WindowRow

MOUNTINGS, REPROFILINGS = table_of(MountingRow), table_of(ReprofilingRow)
MEASURED, WHEELSETS = table_of(MeasuredProfilesRow), table_of(WheelsetRow)


class MountedTwiceError(ConflictError):
    """A wheelset would be in two places at one time, or an axle would have two wheelsets; ``other`` is on file."""

    def __init__(self, record: Mounting, other: Mounting) -> None:
        self.other = other
        reason = f"{_where(record)}: overlaps {_where(other)}"
        super().__init__(reason, kind="mounting", key=record.wheelset)


def _where(mounting: Mounting) -> str:
    place = f"wheelset {mounting.wheelset!r} at axle {mounting.axle} of {mounting.vehicle!r}"
    end = "" if mounting.to_ns is None else f" to {utc_text(mounting.to_ns)}"
    return f"{place} from {utc_text(mounting.from_ns)}{end}"


def mounting_on_file(connection: Connection, record: Mounting) -> Mounting | None:
    """Return the mounting of the same wheelset and start; None where there is none."""
    row = row_of(connection, MOUNTINGS, record.wheelset, record.from_ns)
    return None if row is None else value_of_row(Mounting, row)


def changed_spans(before: Mounting | None, after: Mounting | None) -> list[tuple[str, int, int | None]]:
    """Return ``(vehicle, from, to)`` of the time in which a mounting says something else; None: there is none."""
    if before is not None and after is not None and replace(before, to_ns=after.to_ns) == after:
        ends = [end for end in (before.to_ns, after.to_ns) if end is not None]
        if not ends or before.to_ns == after.to_ns:
            return []
        return [(after.vehicle, min(ends), max(ends) if len(ends) == 2 else None)]  # noqa: PLR2004 - both end
    there = [mounting for mounting in (before, after) if mounting is not None]
    return list(dict.fromkeys((mounting.vehicle, mounting.from_ns, mounting.to_ns) for mounting in there))


def add_mounting(connection: Connection, record: Mounting, axles: int) -> bool:
    """Store a mounting on a vehicle of so many axles; return whether anything changed. Raises MountedTwiceError."""
    if not 1 <= record.axle <= axles:
        raise ParameterError(f"vehicle {record.vehicle!r} has axles 1 to {axles}, not {record.axle}", field="axle")
    if record.to_ns is not None and record.to_ns <= record.from_ns:
        raise ParameterError(f"ends at {record.to_ns}, not after its start at {record.from_ns}", field="to_ns")
    other = _overlapping(connection, record)
    if other is not None:
        raise MountedTwiceError(record, other)
    return upsert(connection, MOUNTINGS, asdict(record))


def _overlapping(connection: Connection, record: Mounting) -> Mounting | None:
    table = MOUNTINGS.c
    same_key = and_(table.wheelset == record.wheelset, table.from_ns == record.from_ns)
    same_axle = and_(table.vehicle == record.vehicle, table.axle == record.axle)
    statement = select(MOUNTINGS).where(
        ~same_key,
        or_(table.wheelset == record.wheelset, same_axle),
        or_(table.to_ns.is_(None), table.to_ns > record.from_ns),
        *given(record.to_ns, table.from_ns.__lt__),
    )
    row = connection.execute(statement.order_by(table.from_ns)).first()
    return None if row is None else value_of_row(Mounting, row)


def reprofilings_of(connection: Connection, serials: Sequence[str]) -> dict[str, list[Reprofiling]]:
    """Return the visits of some wheelsets to the lathe by serial, oldest first."""
    statement = select(REPROFILINGS).where(REPROFILINGS.c.wheelset.in_(serials)).order_by(REPROFILINGS.c.at_ns)
    return grouped(connection.execute(statement), lambda row: Reprofiling(*row))


def newest_measurements(
    connection: Connection, fleet: str | None, from_ns: int | None, to_ns: int | None, limit: int
) -> tuple[int, list[tuple[str, int]]]:
    """Return how many measurements there are in ``[from_ns, to_ns)``, and wheelset and time of the newest ``limit``."""
    wanted = [*given(from_ns, MEASURED.c.at_ns.__ge__), *given(to_ns, MEASURED.c.at_ns.__lt__)]
    of_fleet = select(WHEELSETS.c.serial)
    wanted += given(fleet, lambda code: MEASURED.c.wheelset.in_(of_fleet.where(WHEELSETS.c.fleet == code)))
    total = connection.scalar(select(func.count()).select_from(MEASURED).where(*wanted)) or 0
    newest = select(MEASURED.c.wheelset, MEASURED.c.at_ns).where(*wanted)
    newest = newest.order_by(MEASURED.c.at_ns.desc(), MEASURED.c.wheelset).limit(limit)
    return total, [(row.wheelset, row.at_ns) for row in connection.execute(newest)]


def measured_of(row: Row[Any]) -> MeasuredProfiles:
    """Return the measurement of a row; raises DamagedError."""
    left, right = unpack_wheel_pair(row.packed, where=f"profiles of wheelset {row.wheelset!r} measured at {row.at_ns}")
    return MeasuredProfiles(row.wheelset, row.at_ns, row.mileage_km, left, right, row.std_m)


def store_measured_profiles(connection: Connection, record: MeasuredProfiles) -> bool:
    """Store a measurement of a wheelset that exists, or change the one of the same time; return whether it changed."""
    row = {"wheelset": record.wheelset, "at_ns": record.at_ns, "mileage_km": record.mileage_km, "std_m": record.std}
    return upsert(connection, MEASURED, row | {"packed": pack_wheel_pair(record.left, record.right)})


def stored_measurement(connection: Connection, wheelset: str, at_ns: int) -> dict[str, Any] | None:
    """Return the row of a measurement as JSON can hold it, its profiles in base64; None where there is none."""
    row = row_of(connection, MEASURED, wheelset, at_ns)
    return None if row is None else row | {"packed": base64.b64encode(row["packed"]).decode("ascii")}


WINDOWS, SPANS = table_of(WindowRow), table_of(StaleSpanRow)


@dataclass(frozen=True, slots=True)
class LifeOnFile:
    """What is on file of one wheelset's life, oldest first; reprofilings and measurements as ``(at_ns, km)``."""

    mountings: tuple[Mounting, ...] = ()
    reprofilings: tuple[tuple[int, float], ...] = ()
    measurements: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True, slots=True)
class WindowDistance:
    """The mileage of a wheelset at the start of a window."""

    wheelset: str
    start_ns: int
    mileage_km: float


def lives_on_file(connection: Connection, serials: Collection[str]) -> dict[str, LifeOnFile]:
    """Return the lives of some wheelsets."""
    mountings: dict[str, list[Mounting]] = grouped(mountings_where(connection, MOUNTINGS.c.wheelset, serials))
    turned, measured = (_dated(connection, table, serials) for table in (REPROFILINGS, MEASURED))
    return {
        serial: LifeOnFile(
            tuple(mountings.get(serial, ())), tuple(turned.get(serial, ())), tuple(measured.get(serial, ()))
        )
        for serial in serials
    }


def mountings_where(connection: Connection, column: ColumnElement[str], keys: Collection[str]) -> list[Mounting]:
    """Return the mountings of some wheelsets, or on some vehicles, by that column."""
    statement = select(MOUNTINGS).order_by(MOUNTINGS.c.from_ns)
    rows = (connection.execute(statement.where(column.in_(some))) for some in batches(sorted(keys)))
    return [value_of_row(Mounting, row) for row in chain.from_iterable(rows)]


def any_windows(connection: Connection) -> bool:
    """Return whether there is any window at all."""
    return bool(connection.scalar(select(exists().where(WINDOWS.c.wheelset.is_not(None)))))


def windows_beside(connection: Connection, wheelset: str, at_ns: int) -> list[WindowDistance]:
    """Return the last window of a wheelset that starts at or before a time and the first that starts after it.

    Left out are windows whose mileage is not believed, and those that are to be assembled again.
    """
    stale = exists().where(
        SPANS.c.vehicle == WINDOWS.c.vehicle,
        SPANS.c.from_ns < WINDOWS.c.start_ns + WINDOWS.c.length_ns,
        SPANS.c.to_ns > WINDOWS.c.start_ns,
    )
    believed = select(WINDOWS.c.wheelset, WINDOWS.c.start_ns, WINDOWS.c.mileage_km).where(
        WINDOWS.c.wheelset == wheelset, WINDOWS.c.implausible_code.is_(None), ~stale
    )
    before = believed.where(WINDOWS.c.start_ns <= at_ns).order_by(WINDOWS.c.start_ns.desc()).limit(1)
    after = believed.where(WINDOWS.c.start_ns > at_ns).order_by(WINDOWS.c.start_ns).limit(1)
    return [WindowDistance(*row) for statement in (before, after) for row in connection.execute(statement)]


def _dated(connection: Connection, table: Table, serials: Collection[str]) -> dict[str, list[tuple[int, float]]]:
    """Return time and mileage of what a table holds of wheelsets, oldest first."""
    statement = select(table.c.wheelset, table.c.at_ns, table.c.mileage_km).order_by(table.c.at_ns)
    rows = (connection.execute(statement.where(table.c.wheelset.in_(some))) for some in batches(sorted(serials)))
    return grouped(chain.from_iterable(rows), lambda row: (row.at_ns, row.mileage_km))


CHANGES = table_of(SensorChangeRow)


class SensorChangeStore(RaisingStore):
    """When the sensors of an axle were exchanged or calibrated."""

    def list(self, vehicle: str) -> Sequence[SensorChange]:
        """Return what was done to the sensors of a vehicle, oldest first."""
        statement = select(CHANGES).where(CHANGES.c.vehicle == vehicle).order_by(CHANGES.c.at_ns)
        return [value_of_row(SensorChange, row) for row in self.connection.execute(statement)]

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
