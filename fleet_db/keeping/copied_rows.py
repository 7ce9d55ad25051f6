"""Rows of all tables from one database into another, of any kind."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from sqlalchemy import Column, Connection, Integer, Table, bindparam, delete, func, insert, select, text, update

from fleet_db.tables import Base

BATCH = 2000


def row_counts(connection: Connection) -> dict[str, int]:
    """Return the number of rows of every table."""
    return {
        table.name: int(connection.execute(select(func.count()).select_from(table)).scalar_one())
        for table in Base.metadata.sorted_tables
    }


def copy_rows(source: Connection, target: Connection) -> dict[str, int]:
    """Make every table hold the rows of another database; return their numbers by table.

    Args:
        target: Of a writing transaction; its tables are those of this version. Rows that are there are deleted first.
    """
    for table in reversed(Base.metadata.sorted_tables):
        target.execute(delete(table))
    counts = {table.name: _copy_table(source, target, table) for table in Base.metadata.sorted_tables}
    if target.dialect.name == "postgresql":
        for table in Base.metadata.sorted_tables:
            _continue_numbers(target, table)
    return counts


def _copy_table(source: Connection, target: Connection, table: Table) -> int:
    """Copy one table; references of its rows to each other are filled in when all rows are there."""
    own = [column for column in table.columns if any(key.column.table is table for key in column.foreign_keys)]
    count = 0
    later: list[dict[str, Any]] = []
    for batch in _batches(source, table):
        count += len(batch)
        later += [_reference(table, own, row) for row in batch if any(row[column.name] is not None for column in own)]
        target.execute(insert(table), [row | {column.name: None for column in own} for row in batch])
    if later:
        key = [column == _parameter(column) for column in table.primary_key]
        target.execute(update(table).where(*key), later)
    return count


def _batches(source: Connection, table: Table) -> Iterator[list[dict[str, Any]]]:
    found = source.execution_options(stream_results=True, yield_per=BATCH).execute(
        select(table).order_by(*table.primary_key)
    )
    for rows in found.mappings().partitions():
        yield [dict(row) for row in rows]


def _reference(table: Table, own: list[Column[Any]], row: Mapping[str, Any]) -> dict[str, Any]:
    return {f"key_{column.name}": row[column.name] for column in table.primary_key} | {
        column.name: row[column.name] for column in own
    }


def _parameter(column: Column[Any]) -> Any:  # noqa: ANN401 - SQLAlchemy's own expression
    return bindparam(f"key_{column.name}", type_=column.type)


def _continue_numbers(target: Connection, table: Table) -> None:
    """Let PostgreSQL number new rows after those that were copied."""
    keys = list(table.primary_key)
    if len(keys) != 1 or not isinstance(keys[0].type, Integer):
        return
    name, key = table.name, keys[0].name
    sequence = target.scalar(text("SELECT pg_get_serial_sequence(:name, :key)"), {"name": name, "key": key})
    largest = target.scalar(select(func.max(keys[0])))
    if sequence is not None and largest is not None:
        target.execute(
            text("SELECT setval(CAST(:sequence AS regclass), :last)"), {"sequence": sequence, "last": largest}
        )
