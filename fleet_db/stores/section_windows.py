"""Windows that depend on what the registry holds of a track section: they are made again where that has changed."""

from __future__ import annotations

from itertools import groupby

from sqlalchemy import Connection, or_, select

from fleet_db.rows import table_of
from fleet_db.stores.stale_spans import StaleSpanStore
from fleet_db.tables.windows import WindowRow

WINDOWS = table_of(WindowRow)
APART_NS = 86_400_000_000_000
"""Windows that are nearer to each other are made again together, with what is between them."""


def make_stale(connection: Connection, section: str, cause: str, *, elsewhere: bool) -> None:
    """Let the windows on a section be assembled again.

    A window on another registered section stays: its vehicle sent the number of that one.

    Args:
        elsewhere: Whether those on no registered section are, too: their vehicles may have sent its new number.
    """
    on_it = WINDOWS.c.track_section == section
    touched = or_(on_it, WINDOWS.c.track_section.is_(None)) if elsewhere else on_it
    statement = select(WINDOWS.c.vehicle, WINDOWS.c.start_ns, WINDOWS.c.length_ns).where(touched).distinct()
    rows = connection.execute(statement.order_by(WINDOWS.c.vehicle, WINDOWS.c.start_ns)).all()
    stale = StaleSpanStore(connection)
    for vehicle, windows in groupby(rows, key=lambda row: row.vehicle):
        spans: list[list[int]] = []
        for window in windows:
            end_ns = window.start_ns + window.length_ns
            if spans and window.start_ns - spans[-1][1] <= APART_NS:
                spans[-1][1] = max(spans[-1][1], end_ns)
            else:
                spans.append([window.start_ns, end_ns])
        for from_ns, to_ns in spans:
            stale.add(vehicle, from_ns, to_ns, cause)
