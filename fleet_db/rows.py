"""Few statements that every store needs, over plain tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sqlalchemy import ColumnElement, Connection, Table, and_, insert, select, update
from sqlalchemy.dialects import postgresql, sqlite

from fleet_db.models import Base


def table_of(row: type[Base]) -> Table:
    """Return the table behind a mapped class."""
    table = row.__table__
    assert isinstance(table, Table)
    return table


def key_is(table: Table, values: Mapping[str, Any]) -> ColumnElement[bool]:
    """Return the condition that the primary key of ``table`` is the one in ``values``."""
    return and_(*(column == values[column.name] for column in table.primary_key))


def upsert(connection: Connection, table: Table, values: Mapping[str, Any]) -> bool:
    """Make the row with the primary key of ``values`` hold ``values``; return whether anything changed."""
    found = connection.execute(select(table).where(key_is(table, values))).mappings().first()
    if found is None:
        connection.execute(insert(table).values(**values))
        return True
    if all(found[name] == value for name, value in values.items()):
        return False
    connection.execute(update(table).where(key_is(table, values)).values(**values))
    return True


def insert_new(connection: Connection, table: Table, values: Mapping[str, Any]) -> bool:
    """Insert ``values`` unless the primary key is there already; return whether it was new."""
    if connection.dialect.name == "postgresql":
        result = connection.execute(postgresql.insert(table).values(**values).on_conflict_do_nothing())
    else:
        result = connection.execute(sqlite.insert(table).values(**values).on_conflict_do_nothing())
    return result.rowcount > 0


def null_if_nan(value: float | None) -> float | None:
    """Return None for NaN: a plain column never holds it."""
    return None if value is None or math.isnan(value) else float(value)


def nan_if_null(value: float | None) -> float:
    """Return NaN for None."""
    return math.nan if value is None else value
