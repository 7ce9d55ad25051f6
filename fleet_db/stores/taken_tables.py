"""Bin tables that are about to be replaced or removed, kept until their roll-up is without them."""

from __future__ import annotations

from functools import cache

from sqlalchemy import Connection, Insert, Update, and_, bindparam, insert, select, update

from fleet_db.rows import table_of
from fleet_db.tables import TakenTableRow, WindowBinTableRow

TABLES, TAKEN = table_of(WindowBinTableRow), table_of(TakenTableRow)
KEY = and_(TABLES.c.wheelset == bindparam("of_wheelset"), TABLES.c.start_ns == bindparam("of_start_ns"))


def take_back(connection: Connection, wheelset: str, start_ns: int) -> None:
    """Keep the table of a window, if it was rolled up, to be taken from its roll-up; it waits to be rolled again.

    Args:
        connection: Of the transaction that replaces or removes the table.
    """
    key = {"of_wheelset": wheelset, "of_start_ns": start_ns}
    if connection.execute(_waits_again(), key).rowcount:
        connection.execute(_kept(), key)
        connection.execute(_in_none(), key)


@cache
def _waits_again() -> Update:
    statement = update(TABLES).where(KEY, TABLES.c.rolled).values(rolled=False)
    return statement.execution_options(preserve_rowcount=True)


@cache
def _kept() -> Insert:
    columns = ("wheelset", "roll_up", "start_ns", "running_km", "line", "packed")
    return insert(TAKEN).from_select(
        columns, select(*(TABLES.c[name] for name in columns)).where(KEY, TABLES.c.roll_up.is_not(None))
    )


@cache
def _in_none() -> Update:
    return update(TABLES).where(KEY).values(roll_up=None, running_km=None, line=None)
