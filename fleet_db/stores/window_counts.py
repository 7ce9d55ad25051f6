"""Windows of a wheelset counted over time, by state and reason."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import Connection, func, select

from estimation.values.reasons import ReasonCode
from estimation.values.windows import WindowState
from fleet_db.rows import table_of
from fleet_db.tables import WindowRow

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
    placed = select(place, WINDOWS.c.state, WINDOWS.c.reason_code).where(of_wheelset).subquery()
    key = (placed.c.place, placed.c.state, placed.c.reason_code)
    rows = connection.execute(select(*key, func.count().label("windows")).group_by(*key))
    found = [
        WindowCount(
            begin + int(row.place) * stretch_ns,
            WindowState(row.state),
            None if row.reason_code is None else ReasonCode(row.reason_code),
            row.windows,
        )
        for row in rows
    ]
    return WindowCounts(stretch_ns, tuple(sorted(found, key=_order)))


def _order(one: WindowCount) -> tuple[int, str, str]:
    return one.from_ns, one.state.value, "" if one.code is None else one.code.value
