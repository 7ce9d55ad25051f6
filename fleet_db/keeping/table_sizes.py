"""How many bytes each table and its indexes take, without reading a large database."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import (
    Column,
    Connection,
    Integer,
    LargeBinary,
    Table,
    cast,
    func,
    inspect,
    literal_column,
    select,
    text,
)
from sqlalchemy.exc import OperationalError

from fleet_db.tables.base import Base

EXACT_BYTES = 256 << 20
"""An SQLite file up to this size is read page by page (dbstat); of a larger one rows are sampled."""
SAMPLED_ROWS = 200
ROW_OVERHEAD = 10  # bytes of a row's header and number
ENTRY_OVERHEAD = 12  # bytes of an entry of an index


@dataclass(frozen=True, slots=True)
class TableSize:
    """Rows of a table, bytes of the table with what is stored beside it, bytes of its indexes."""

    rows: int
    table_bytes: int
    index_bytes: int
    estimated: bool


@dataclass(frozen=True, slots=True)
class DatabaseSize:
    """Every table of ours, and bytes that are allocated and empty."""

    tables: Mapping[str, TableSize]
    free_bytes: int


def database_size(connection: Connection, exact_bytes: int = EXACT_BYTES) -> DatabaseSize:
    """Return the size of every table.

    PostgreSQL keeps sizes and row counts itself. In SQLite the pages of a small file are counted; of a large one a
    few rows are read at even distances, and their mean is scaled to the size of the file.

    Args:
        exact_bytes: Largest SQLite file of which every page is counted.
    """
    if connection.dialect.name == "postgresql":
        return _of_postgresql(connection)
    pages, size, free = (int(connection.scalar(text(f"PRAGMA {name}")) or 0) for name in _PRAGMAS)
    if pages * size <= exact_bytes:
        found = _by_page(connection)
        if found is not None:
            return DatabaseSize(found, free * size)
    return DatabaseSize(_by_sample(connection, (pages - free) * size, size), free * size)


_PRAGMAS = ("page_count", "page_size", "freelist_count")

_SIZES = text("""
    SELECT coalesce(pg_partition_root(c.oid)::regclass, c.oid::regclass)::text AS name,
           sum(CASE WHEN c.reltuples < 0 THEN coalesce(s.n_live_tup, 0) ELSE c.reltuples END) AS rows,
           sum(pg_table_size(c.oid)) AS table_bytes, sum(pg_indexes_size(c.oid)) AS index_bytes
    FROM pg_class c JOIN pg_namespace n ON n.oid = c.relnamespace LEFT JOIN pg_stat_user_tables s ON s.relid = c.oid
    WHERE c.relkind IN ('r', 'p') AND n.nspname = current_schema() GROUP BY 1
""")


def _of_postgresql(connection: Connection) -> DatabaseSize:
    ours = Base.metadata.tables
    found = {}
    for row in connection.execute(_SIZES):
        name = row.name.rpartition(".")[2].strip('"')
        if name in ours:
            found[name] = TableSize(int(row.rows), int(row.table_bytes), int(row.index_bytes), estimated=True)
    return DatabaseSize(found, 0)


def _by_page(connection: Connection) -> dict[str, TableSize] | None:
    """Return the sizes by counting pages; None where SQLite was built without ``dbstat``."""
    try:
        rows = connection.execute(text("SELECT name, sum(pgsize) FROM dbstat WHERE aggregate = TRUE GROUP BY 1"))
    except OperationalError:
        return None
    taken = {str(name): int(size) for name, size in rows}
    found = {}
    for table in _existing(connection):
        own = connection.execute(text("SELECT name FROM sqlite_master WHERE type = 'index' AND tbl_name = :table"),
                                 {"table": table.name})  # fmt: skip
        index_bytes = sum(taken.get(str(index), 0) for (index,) in own)
        count = int(connection.scalar(select(func.count()).select_from(table)) or 0)
        found[table.name] = TableSize(count, taken.get(table.name, 0), index_bytes, estimated=False)
    return found


def _by_sample(connection: Connection, used_bytes: int, page_bytes: int) -> dict[str, TableSize]:
    """Return sizes that add up to the file: a page for each table and index, the rest by the lengths of rows."""
    raw = {table: _sampled(connection, table) for table in _existing(connection)}
    pages = {table: 1 + len(_indexes(table)) for table in raw}
    whole = sum(size.table_bytes + size.index_bytes for size in raw.values())
    scale = max(used_bytes - sum(pages.values()) * page_bytes, 0) / whole if whole else 0.0
    return {
        table.name: TableSize(
            size.rows,
            page_bytes + round(size.table_bytes * scale),
            (pages[table] - 1) * page_bytes + round(size.index_bytes * scale),
            estimated=True,
        )
        for table, size in raw.items()
    }


def _indexes(table: Table) -> list[list[Column[Any]]]:
    """Return the columns of each index, with that of the key."""
    return [list(table.primary_key.columns), *(list(index.columns) for index in table.indexes)]


def _sampled(connection: Connection, table: Table) -> TableSize:
    """Return the size of an SQLite table by the lengths of rows at even distances."""
    number = literal_column("rowid", Integer)
    first, last = (connection.scalar(select(end(number)).select_from(table)) for end in (func.min, func.max))
    if first is None or last is None:
        return TableSize(0, 0, 0, estimated=True)
    columns = list(table.columns)
    lengths = [func.coalesce(func.length(cast(column, LargeBinary)), 0) for column in columns]
    step, rows, at = max((last - first) // SAMPLED_ROWS, 1), last - first + 1, first
    found: list[tuple[int, ...]] = []
    while at <= last:
        statement = select(number, *lengths).select_from(table).where(number >= at).order_by(number).limit(1)
        here, *of_columns = connection.execute(statement).one()
        found.append(tuple(of_columns))
        at = max(at + step, here + 1)
    sums = [sum(of_column) for of_column in zip(*found, strict=True)]
    mean = {column.name: total / len(found) for column, total in zip(columns, sums, strict=True)}
    entry = sum(ENTRY_OVERHEAD + sum(mean[column.name] for column in columns) for columns in _indexes(table))
    return TableSize(rows, round(rows * (ROW_OVERHEAD + sum(mean.values()))), round(rows * entry), estimated=True)


def _existing(connection: Connection) -> list[Table]:
    there = set(inspect(connection).get_table_names())
    return [table for table in Base.metadata.sorted_tables if table.name in there]
