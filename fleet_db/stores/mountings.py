"""Mountings: which wheelset ran at which axle of which vehicle, and when."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, replace
from typing import Any

from sqlalchemy import Connection, Row, and_, delete, or_, select

from estimation.errors import ConflictError, ParameterError
from estimation.values.reasons import utc_text
from estimation.values.registry import Mounting
from fleet_db.rows import table_of, upsert
from fleet_db.tables import MountingRow

MOUNTINGS = table_of(MountingRow)


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


def mounting_at(connection: Connection, vehicle: str, axle: int, at_ns: int) -> Mounting | None:
    """Return the mounting at an axle that covers ``at_ns``.

    Args:
        axle: From 1.
        at_ns: ns UTC on the vehicle's clock.
    """
    statement = select(MOUNTINGS).where(
        MOUNTINGS.c.vehicle == vehicle,
        MOUNTINGS.c.axle == axle,
        MOUNTINGS.c.from_ns <= at_ns,
        or_(MOUNTINGS.c.to_ns.is_(None), MOUNTINGS.c.to_ns > at_ns),
    )
    row = connection.execute(statement).first()
    return None if row is None else to_mounting(row)


def mountings_on(connection: Connection, vehicle: str, from_ns: int, to_ns: int) -> Sequence[Mounting]:
    """Return every mounting on a vehicle that covers some of ``[from_ns, to_ns)``, by axle and start.

    Args:
        from_ns, to_ns: Interval of the vehicle's clock, ns UTC, its end excluded.
    """
    statement = (
        select(MOUNTINGS)
        .where(MOUNTINGS.c.vehicle == vehicle, MOUNTINGS.c.from_ns < to_ns)
        .where(or_(MOUNTINGS.c.to_ns.is_(None), MOUNTINGS.c.to_ns > from_ns))
        .order_by(MOUNTINGS.c.axle, MOUNTINGS.c.from_ns)
    )
    return [to_mounting(row) for row in connection.execute(statement)]


def mountings_of(connection: Connection, wheelsets: Collection[str]) -> dict[str, list[Mounting]]:
    """Return every mounting of some wheelsets by serial, oldest first; one without a mounting is left out."""
    statement = select(MOUNTINGS).where(MOUNTINGS.c.wheelset.in_(wheelsets)).order_by(MOUNTINGS.c.from_ns)
    found: dict[str, list[Mounting]] = {}
    for row in connection.execute(statement):
        found.setdefault(row.wheelset, []).append(to_mounting(row))
    return found


def mounting_on_file(connection: Connection, record: Mounting) -> Mounting | None:
    """Return the mounting of the same wheelset and start; None where there is none."""
    key = and_(MOUNTINGS.c.wheelset == record.wheelset, MOUNTINGS.c.from_ns == record.from_ns)
    found = connection.execute(select(MOUNTINGS).where(key)).first()
    return None if found is None else to_mounting(found)


def delete_mounting(connection: Connection, record: Mounting) -> None:
    """Remove the mounting of the same wheelset and start."""
    key = and_(MOUNTINGS.c.wheelset == record.wheelset, MOUNTINGS.c.from_ns == record.from_ns)
    connection.execute(delete(MOUNTINGS).where(key))


def changed_spans(before: Mounting | None, after: Mounting | None) -> list[tuple[str, int, int | None]]:
    """Return ``(vehicle, from, to)`` of the time in which a mounting says something else than before.

    Args:
        before, after: The mounting of one wheelset and start; None where there is none.
    """
    if before is not None and after is not None and replace(before, to_ns=after.to_ns) == after:
        ends = [end for end in (before.to_ns, after.to_ns) if end is not None]
        if not ends or before.to_ns == after.to_ns:
            return []
        return [(after.vehicle, min(ends), max(ends) if len(ends) == 2 else None)]  # noqa: PLR2004 - both end
    known = [one for one in (before, after) if one is not None]
    return list(dict.fromkeys((one.vehicle, one.from_ns, one.to_ns) for one in known))


def add_mounting(connection: Connection, record: Mounting, axles: int) -> bool:
    """Store a mounting on a vehicle of so many axles; return whether anything changed.

    Raises:
        ParameterError: The vehicle has no such axle, or the mounting ends before it starts.
        MountedTwiceError: It overlaps another of the same wheelset or of the same axle.
    """
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
    )
    if record.to_ns is not None:
        statement = statement.where(table.from_ns < record.to_ns)
    row = connection.execute(statement.order_by(table.from_ns)).first()
    return None if row is None else to_mounting(row)


def to_mounting(row: Row[Any]) -> Mounting:
    """Return the value of a row."""
    return Mounting(**row._mapping)  # noqa: SLF001 - SQLAlchemy's public accessor
