"""Where windows were along their sections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from sqlalchemy import Connection, Row, Select, select

from estimation.values.windows import WindowKey, WindowPosition
from fleet_db.rows import stored_reason, table_of
from fleet_db.stores.window_marks import BATCH, keys_given
from fleet_db.tables import WindowPositionRow

POSITIONS = table_of(WindowPositionRow)


def positions_of(connection: Connection, keys: Sequence[WindowKey]) -> Mapping[WindowKey, WindowPosition]:
    """Return by wheelset and start where those of some windows were that have been looked at."""
    found = {}
    for first in range(0, len(keys), BATCH):
        for row in connection.execute(_positions(), {"keys": keys[first : first + BATCH]}):
            found[row.wheelset, row.start_ns] = _position(row)
    return found


@cache
def _positions() -> Select[Any]:
    return select(POSITIONS).where(keys_given(POSITIONS))


def _position(row: Row[Any]) -> WindowPosition:
    fields = dict(row._mapping)  # noqa: SLF001 - SQLAlchemy's public name for the columns of a row
    del fields["reason_code"]
    return WindowPosition(**(fields | {"reason": stored_reason(row)}))
