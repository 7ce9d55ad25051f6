"""Windows counted by state and reason, and what waits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    Select,
    Subquery,
    bindparam,
    case,
    false,
    func,
    select,
    true,
    union_all,
)

from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import WindowState
from fleet_db.due import IS_PENDING, PLACED
from fleet_db.records import ChunkState
from fleet_db.rows import stored_reason, table_of, value_of_row
from fleet_db.tables.recordings import ChunkRow
from fleet_db.tables.results import WorklistEntryRow
from fleet_db.tables.windows import WindowRow

WINDOWS = table_of(WindowRow)
DAY_NS = 86_400 * 10**9


@dataclass(frozen=True, slots=True)
class WindowCount:
    """Windows that begin in one stretch of time, with one state and reason."""

    from_ns: int  # begin of the stretch
    state: WindowState
    code: ReasonCode | None  # why they are refused, or wait
    windows: int


@dataclass(frozen=True, slots=True)
class WindowCounts:
    """Windows of one wheelset over all stretches of time that have any, the oldest first."""

    stretch_ns: int
    counts: tuple[WindowCount, ...]


def window_counts(connection: Connection, wheelset: str, most: int) -> WindowCounts:
    """Return windows by state and reason in at most ``most`` stretches of whole days."""
    of_wheelset = WINDOWS.c.wheelset == wheelset
    first, last = connection.execute(
        select(func.min(WINDOWS.c.start_ns), func.max(WINDOWS.c.start_ns)).where(of_wheelset)
    ).one()
    if first is None:
        return WindowCounts(DAY_NS, ())
    begin = first // DAY_NS * DAY_NS
    stretch_ns = DAY_NS * (1 + (last - begin) // (most * DAY_NS))
    place = ((WINDOWS.c.start_ns - begin) // stretch_ns).label("place")
    placed = select(place, WINDOWS.c.state, WINDOWS.c.reason_code.label("code")).where(of_wheelset).subquery()
    key = (placed.c.place, placed.c.state, placed.c.code)
    rows = connection.execute(select(*key, func.count().label("windows")).group_by(*key))
    found = [value_of_row(WindowCount, row, from_ns=begin + int(row.place) * stretch_ns) for row in rows]
    found.sort(key=lambda one: (one.from_ns, one.state.value, "" if one.code is None else one.code.value))
    return WindowCounts(stretch_ns, tuple(found))


COUNTED = 1000
"""Windows that are counted, the newest: 17 hours of running."""

EVER_NS = -(2**63)
SERIALS_AT_ONCE = 50


@dataclass(frozen=True, slots=True)
class CountedWindows:
    """Windows of one wheelset that have the same state, reason code, section and vehicle.

    Attributes:
        first_ns, newest_start_ns, newest_end_ns: Begin of the oldest, begin and end of the newest, ns UTC on the
            vehicle's clock.
    """

    state: WindowState
    reason: Reason | None  # as it is stored of the newest; None where none is
    section: str | None
    vehicle: str
    placed: bool  # whether their place on the section is found; False of those that do not wait
    windows: int
    first_ns: int
    newest_start_ns: int
    newest_end_ns: int


def newest_by_reason(
    connection: Connection, wheelset: str, since_ns: int | None = None, most: int = COUNTED
) -> Sequence[CountedWindows]:
    """Return windows by state and reason code of the ``most`` newest since a time, the most frequent first."""
    given = {"serial": wheelset, "since_ns": EVER_NS if since_ns is None else since_ns, "most": most}
    rows = connection.execute(_grouped(), given).all()
    starts = [row.newest_start_ns for row in rows if row.reason_code is not None]
    found = connection.execute(_reasons(), {"serial": wheelset, "starts": starts}) if starts else ()
    stored = {row.start_ns: stored_reason(row) for row in found}
    counted = [_counted(row, reason=stored.get(row.newest_start_ns)) for row in rows]
    return sorted(counted, key=lambda one: (-one.windows, -one.newest_end_ns, one.state.value))


def pending_by_place(
    connection: Connection, *, vehicles: Sequence[str] | None = None, wheelset: str | None = None
) -> Sequence[CountedWindows]:
    """Return the windows that wait, however many, by vehicle, section, and whether their place is found."""
    chosen = [IS_PENDING]
    if vehicles is not None:
        chosen.append(WINDOWS.c.vehicle.in_(vehicles))
    if wheelset is not None:
        chosen.append(WINDOWS.c.wheelset == wheelset)
    placed = case((PLACED, true()), else_=false()).label("placed")
    names = ("vehicle", "track_section", "start_ns")
    end = (WINDOWS.c.start_ns + WINDOWS.c.length_ns).label("end_ns")
    waiting = select(*(WINDOWS.c[name] for name in names), end, placed)
    one = waiting.where(*chosen).subquery()
    key = (one.c.vehicle, one.c.track_section, one.c.placed)
    rows = connection.execute(select(*key, *_sums(one)).group_by(*key))
    return [_counted(row, state=WindowState.PENDING, reason=None) for row in rows]


def _counted(row: Row[Any], **given: object) -> CountedWindows:
    return value_of_row(CountedWindows, row, section=row.track_section, placed=bool(row.placed), **given)


def refused_by_code(connection: Connection, since_ns: Mapping[str, int | None]) -> dict[str, dict[ReasonCode, int]]:
    """Return how many of the newest windows of wheelsets are refused, by serial and code, the most frequent first.

    Args:
        since_ns: By serial; None is ever.
    """
    found: dict[str, dict[ReasonCode, int]] = {serial: {} for serial in since_ns}
    given = list(since_ns.items())
    for first in range(0, len(given), SERIALS_AT_ONCE):
        newest = union_all(*(_newest_refused(*one) for one in given[first : first + SERIALS_AT_ONCE])).subquery()
        counted = select(newest.c.wheelset, newest.c.reason_code, func.count().label("windows"))
        refused = counted.where(newest.c.state == WindowState.REFUSED.value, newest.c.reason_code.is_not(None))
        for row in connection.execute(refused.group_by(newest.c.wheelset, newest.c.reason_code)):
            found[row.wheelset][ReasonCode(row.reason_code)] = row.windows
    return {
        serial: dict(sorted(counts.items(), key=lambda item: (-item[1], item[0].value)))
        for serial, counts in found.items()
    }


def _newest_refused(serial: str, since_ns: int | None) -> Select[Any]:
    of_key = (WINDOWS.c.wheelset == serial, WINDOWS.c.start_ns >= (EVER_NS if since_ns is None else since_ns))
    newest = select(WINDOWS.c.wheelset, WINDOWS.c.state, WINDOWS.c.reason_code).where(*of_key)
    limited = newest.order_by(WINDOWS.c.start_ns.desc()).limit(COUNTED).subquery()
    return select(limited)


@cache
def _grouped() -> Select[Any]:
    of_key = (WINDOWS.c.wheelset == bindparam("serial"), WINDOWS.c.start_ns >= bindparam("since_ns"))
    waits = WINDOWS.c.state == WindowState.PENDING.value
    names = ("state", "reason_code", "track_section", "vehicle", "start_ns")
    end = (WINDOWS.c.start_ns + WINDOWS.c.length_ns).label("end_ns")
    placed = case((waits, PLACED), else_=false()).label("placed")
    newest = select(*(WINDOWS.c[name] for name in names), end, placed).where(*of_key)
    one = newest.order_by(WINDOWS.c.start_ns.desc()).limit(bindparam("most")).subquery()
    key = (one.c.state, one.c.reason_code, one.c.track_section, one.c.vehicle, one.c.placed)
    return select(*key, *_sums(one)).group_by(*key)


def _sums(one: Subquery) -> tuple[ColumnElement[Any], ...]:
    """Return what is counted of the windows of a group."""
    return (
        func.count().label("windows"),
        func.min(one.c.start_ns).label("first_ns"),
        func.max(one.c.start_ns).label("newest_start_ns"),
        func.max(one.c.end_ns).label("newest_end_ns"),
    )


@cache
def _reasons() -> Select[Any]:
    starts = WINDOWS.c.start_ns.in_(bindparam("starts", expanding=True))
    columns = (WINDOWS.c.start_ns, WINDOWS.c.reason, WINDOWS.c.reason_code)
    return select(*columns).where(WINDOWS.c.wheelset == bindparam("serial"), starts)


CHUNKS, ENTRIES = table_of(ChunkRow), table_of(WorklistEntryRow)


@dataclass(frozen=True, slots=True)
class Backlog:
    """What waits.

    Attributes:
        oldest_recording_ns, oldest_window_ns: Since when, ns of our clock, the oldest recording waits to be decoded
            and the oldest window to be estimated; None where none does.
        last_data: Fleet, and newest data on the vehicle's clock, of each vehicle with a mounted wheelset; None without
            data.
    """

    recordings: Mapping[ChunkState, int]  # how many there are, by state
    oldest_recording_ns: int | None
    oldest_window_ns: int | None
    last_data: tuple[tuple[str, int | None], ...]


def backlog_of(connection: Connection) -> Backlog:
    """Return what waits now."""
    states = connection.execute(select(CHUNKS.c.state, func.count()).group_by(CHUNKS.c.state))
    stored = select(func.min(CHUNKS.c.received_ns)).where(CHUNKS.c.state == ChunkState.STORED.value)
    pending = select(func.min(WINDOWS.c.recorded_ns)).where(WINDOWS.c.state == WindowState.PENDING.value)
    newest = (
        select(ENTRIES.c.fleet, func.max(ENTRIES.c.last_data_ns))
        .where(ENTRIES.c.vehicle.is_not(None))
        .group_by(ENTRIES.c.fleet, ENTRIES.c.vehicle)
    )
    return Backlog(
        recordings={ChunkState(state): int(count) for state, count in states},
        oldest_recording_ns=connection.scalar(stored),
        oldest_window_ns=connection.scalar(pending),
        last_data=tuple((fleet, at_ns) for fleet, at_ns in connection.execute(newest)),
    )
