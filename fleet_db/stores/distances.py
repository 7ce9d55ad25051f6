"""Distances on file beside a record of the registry: mileages of wheelsets, and where windows measured them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import ColumnElement, Connection, Select, and_, exists, select

from estimation.values.registry import Mounting
from fleet_db.rows import table_of, value_of_row
from fleet_db.tables import MeasuredProfilesRow, MountingRow, ReprofilingRow, StaleSpanRow, WindowRow

MOUNTINGS, REPROFILINGS, MEASURED = table_of(MountingRow), table_of(ReprofilingRow), table_of(MeasuredProfilesRow)
WINDOWS, SPANS = table_of(WindowRow), table_of(StaleSpanRow)
AT_ONCE = 500  # keys in one statement


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
    mountings: defaultdict[str, list[Mounting]] = defaultdict(list)
    for one in mountings_where(connection, MOUNTINGS.c.wheelset, serials):
        mountings[one.wheelset].append(one)
    turned = _dated(
        connection, select(REPROFILINGS.c.wheelset, REPROFILINGS.c.at_ns, REPROFILINGS.c.mileage_km), serials
    )
    measured = _dated(connection, select(MEASURED.c.wheelset, MEASURED.c.at_ns, MEASURED.c.mileage_km), serials)
    return {
        serial: LifeOnFile(
            tuple(sorted(mountings[serial], key=lambda one: one.from_ns)),
            tuple(sorted(turned.get(serial, ()))),
            tuple(sorted(measured.get(serial, ()))),
        )
        for serial in serials
    }


def mountings_where(connection: Connection, column: ColumnElement[str], keys: Collection[str]) -> list[Mounting]:
    """Return the mountings of some wheelsets, or on some vehicles, by that column."""
    found = []
    for some in _parts(keys):
        statement = select(MOUNTINGS).where(column.in_(some)).order_by(MOUNTINGS.c.from_ns)
        found += [value_of_row(Mounting, row) for row in connection.execute(statement)]
    return found


def any_windows(connection: Connection) -> bool:
    """Return whether there is any window at all."""
    return bool(connection.scalar(select(exists().where(WINDOWS.c.wheelset.is_not(None)))))


def windows_beside(connection: Connection, wheelset: str, at_ns: int) -> list[WindowDistance]:
    """Return the last window of a wheelset that starts at or before a time and the first that starts after it.

    Left out are windows whose mileage is not believed, and those that are to be assembled again.

    Args:
        at_ns: ns UTC on the vehicle's clock.
    """
    stale = exists().where(
        and_(
            SPANS.c.vehicle == WINDOWS.c.vehicle,
            SPANS.c.from_ns < WINDOWS.c.start_ns + WINDOWS.c.length_ns,
            SPANS.c.to_ns > WINDOWS.c.start_ns,
        )
    )
    believed = select(WINDOWS.c.wheelset, WINDOWS.c.start_ns, WINDOWS.c.mileage_km).where(
        WINDOWS.c.wheelset == wheelset, WINDOWS.c.implausible_code.is_(None), ~stale
    )
    before = believed.where(WINDOWS.c.start_ns <= at_ns).order_by(WINDOWS.c.start_ns.desc()).limit(1)
    after = believed.where(WINDOWS.c.start_ns > at_ns).order_by(WINDOWS.c.start_ns).limit(1)
    return [
        WindowDistance(row.wheelset, row.start_ns, row.mileage_km)
        for statement in (before, after)
        for row in connection.execute(statement)
    ]


def _dated(
    connection: Connection, statement: Select[tuple[str, int, float]], serials: Collection[str]
) -> Mapping[str, Sequence[tuple[int, float]]]:
    found: defaultdict[str, list[tuple[int, float]]] = defaultdict(list)
    for some in _parts(serials):
        column = statement.selected_columns[0]
        for row in connection.execute(statement.where(column.in_(some))):
            found[row.wheelset].append((row.at_ns, row.mileage_km))
    return found


def _parts(keys: Collection[str]) -> Iterator[list[str]]:
    ordered = sorted(keys)
    for begin in range(0, len(ordered), AT_ONCE):
        yield ordered[begin : begin + AT_ONCE]
