"""Where windows were along their sections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sqlalchemy import Connection, delete, select

from estimation.values.windows import WindowKey, WindowPosition
from fleet_db.due import BATCH
from fleet_db.rows import columns_of, put_rows, table_of, value_of_row
from fleet_db.stores.window_rows import keys_given
from fleet_db.tables.track import WindowPositionRow
from fleet_db.tables.windows import WindowRow

POSITIONS, WINDOWS = table_of(WindowPositionRow), table_of(WindowRow)
OF_WINDOWS = select(POSITIONS).where(keys_given(POSITIONS))


def positions_of(connection: Connection, keys: Sequence[WindowKey]) -> Mapping[WindowKey, WindowPosition]:
    """Return by wheelset and start where those of some windows were that have been looked at."""
    found = {}
    for first in range(0, len(keys), BATCH):
        for row in connection.execute(OF_WINDOWS, {"keys": keys[first : first + BATCH]}):
            found[row.wheelset, row.start_ns] = value_of_row(WindowPosition, row)
    return found


def put_positions(
    connection: Connection, positions: Sequence[WindowPosition]
) -> Mapping[WindowKey, WindowPosition | None]:
    """Store where windows were, in the place of what was known; return that of those of which it has changed."""
    before = positions_of(connection, [(one.wheelset, one.start_ns) for one in positions])
    changed = {
        (one.wheelset, one.start_ns): one for one in positions if before.get((one.wheelset, one.start_ns)) != one
    }
    put_rows(connection, POSITIONS, [columns_of(changed[key]) for key in sorted(changed)])
    return {key: before.get(key) for key in changed}


def forget_positions(connection: Connection, keys: Sequence[WindowKey]) -> set[str | None]:
    """Forget where some windows were; return the sections that they are on."""
    sections: set[str | None] = set()
    for first in range(0, len(keys), BATCH):
        given = {"keys": keys[first : first + BATCH]}
        sections.update(connection.scalars(select(WINDOWS.c.track_section).where(keys_given(WINDOWS)), given))
        connection.execute(delete(POSITIONS).where(keys_given(POSITIONS)), given)
    return sections
