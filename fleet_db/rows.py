"""The statements that every store needs, over plain tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from enum import Enum
from functools import cache
from typing import Any, TypeVar, cast, get_args, get_origin

from sqlalchemy import (
    ColumnElement,
    Connection,
    Insert,
    Row,
    Select,
    Table,
    Tuple,
    Update,
    and_,
    bindparam,
    delete,
    or_,
    select,
    tuple_,
    update,
)
from sqlalchemy.dialects import postgresql, sqlite

from estimation.errors import NotFoundError
from estimation.values.reasons import Reason, ReasonCode
from fleet_db.fields import Members, hints_of
from fleet_db.tables import Base

V = TypeVar("V")


def table_of(row: type[Base]) -> Table:
    """Return the table that a class describes."""
    return row.table


@cache
def key_given(table: Table) -> ColumnElement[bool]:
    """Return the condition that the primary key of ``table`` is in the parameters ``key_<column>``."""
    return and_(*(column == bindparam(f"key_{column.name}", type_=column.type) for column in table.primary_key))


def key_of(table: Table, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters for ``key_given``."""
    return {f"key_{column.name}": values[column.name] for column in table.primary_key}


def row_of(connection: Connection, table: Table, *key: object) -> dict[str, Any] | None:
    """Return the row with a primary key, whose columns are in the order of the table; None where there is none."""
    row = connection.execute(_by_key(table), _given(table, key)).mappings().first()
    return None if row is None else {str(name): value for name, value in row.items()}


def delete_row(connection: Connection, table: Table, *key: object) -> None:
    """Delete the row with a primary key, whose columns are in the order of the table."""
    connection.execute(delete(table).where(key_given(table)), _given(table, key))


def _given(table: Table, key: Sequence[object]) -> dict[str, object]:
    return dict(zip((f"key_{column.name}" for column in table.primary_key), key, strict=True))


def upsert(connection: Connection, table: Table, values: Mapping[str, Any]) -> bool:
    """Make the row with the primary key of ``values`` hold ``values``; return whether anything changed."""
    key = key_of(table, values)
    stored = connection.execute(_by_key(table), key).mappings().first()
    if stored is None and insert_new(connection, table, values):
        return True
    if stored is None:  # another transaction has stored it since the look-up
        stored = connection.execute(_by_key(table), key).mappings().one()
    if all(stored[name] == value for name, value in values.items()):
        return False
    replace(connection, table, values)
    return True


def replace(connection: Connection, table: Table, values: Mapping[str, Any]) -> None:
    """Change the row with the primary key of ``values`` to hold ``values``."""
    connection.execute(_update(table, tuple(values)), {**values, **key_of(table, values)})


def replace_all(connection: Connection, table: Table, rows: Sequence[Mapping[str, Any]]) -> None:
    """Change the rows with the primary keys of several values, all of the same columns, to hold them."""
    if rows:
        connection.execute(_update(table, tuple(rows[0])), [{**row, **key_of(table, row)} for row in rows])


def put_rows(connection: Connection, table: Table, rows: Sequence[Mapping[str, Any]]) -> None:
    """Store rows, all of the same columns, each in the place of the one with its primary key; in order of the keys."""
    if rows:
        connection.execute(_put(table, tuple(rows[0]), connection.dialect.name), list(rows))


def insert_new(connection: Connection, table: Table, values: Mapping[str, Any]) -> bool:
    """Insert ``values`` unless the primary key is there already; return whether it was new."""
    return connection.execute(_insert_new(table, connection.dialect.name), values).rowcount > 0


def insert_all_new(connection: Connection, table: Table, rows: Sequence[Mapping[str, Any]]) -> int:
    """Insert those of several values, all of the same columns, that have a new primary key; return how many."""
    return connection.execute(_insert_new(table, connection.dialect.name), list(rows)).rowcount if rows else 0


def equal(table: Table, **values: object) -> list[ColumnElement[bool]]:
    """Return the conditions that columns hold values; those of None are left out."""
    plain = {name: value.value if isinstance(value, Enum) else value for name, value in values.items()}
    return [table.c[name] == value for name, value in plain.items() if value is not None]


def given(value: V | None, condition: Callable[[V], ColumnElement[bool]]) -> list[ColumnElement[bool]]:
    """Return a condition on a value, if it is not None."""
    return [] if value is None else [condition(value)]


def on_sections(column: ColumnElement[str | None], sections: Collection[str]) -> ColumnElement[bool]:
    """Return the condition that a column names one of some sections; the empty text stands for null."""
    named = column.in_(sorted(set(sections) - {""}))
    return or_(named, column.is_(None)) if "" in sections else named


def present(value: V | None, kind: str, key: object) -> V:
    """Return what was found of a kind under a key; NotFoundError: nothing was."""
    if value is None:
        raise NotFoundError(kind, str(key))
    return value


def batches(items: Sequence[V], size: int = 500) -> Iterator[Sequence[V]]:
    """Yield the items of a sequence, in their order, so many at once as a statement takes."""
    for first in range(0, len(items), size):
        yield items[first : first + size]


def grouped(rows: Iterable[Any], value: Callable[[Any], V] | None = None, by: str = "wheelset") -> dict[str, list[V]]:
    """Return rows, or a value of each, by one of their columns, in their order."""
    values: dict[str, list[V]] = {}
    for row in rows:
        values.setdefault(getattr(row, by), []).append(row if value is None else value(row))
    return values


def window_key(table: Any) -> Tuple:  # noqa: ANN401 - a table with the key of windows, here and below
    """Return wheelset and start of a row as one, to be compared with keys of windows."""
    return tuple_(table.c.wheelset, table.c.start_ns)


def keys_given(table: Any) -> ColumnElement[bool]:  # noqa: ANN401
    """Return the condition that wheelset and start of a row are among the parameters ``keys``."""
    return window_key(table).in_(bindparam("keys", expanding=True))


def same_window(first: Any, second: Any, *columns: str) -> ColumnElement[bool]:  # noqa: ANN401
    """Return the condition that rows of two tables are of one window, and have other columns in common."""
    return and_(*(first.c[name] == second.c[name] for name in ("wheelset", "start_ns", *columns)))


def null_if_nan(value: float | None) -> float | None:
    """Return None for NaN: a plain column never holds it."""
    return None if value is None or math.isnan(value) else float(value)


def nan_if_null(value: float | None) -> float:
    """Return NaN for None."""
    return math.nan if value is None else value


@cache
def _by_key(table: Table) -> Select[Any]:
    return select(table).where(key_given(table))


def insert_of(dialect: str, table: Table) -> Any:  # noqa: ANN401 - no class is of both
    """Return the INSERT that can say what is done where its row is there."""
    return (postgresql if dialect == "postgresql" else sqlite).insert(table)


@cache
def _insert_new(table: Table, dialect: str) -> Insert:
    new: Insert = insert_of(dialect, table).on_conflict_do_nothing(index_elements=list(table.primary_key))
    return new.execution_options(preserve_rowcount=True)


@cache
def _put(table: Table, names: tuple[str, ...], dialect: str) -> Insert:
    key = [column.name for column in table.primary_key]
    new = insert_of(dialect, table).values({name: bindparam(name, type_=table.c[name].type) for name in names})
    changed = {name: new.excluded[name] for name in names if name not in key}
    stored: Insert = new.on_conflict_do_update(index_elements=key, set_=changed)
    return stored


@cache
def _update(table: Table, names: tuple[str, ...]) -> Update:
    return update(table).where(key_given(table)).values({name: bindparam(name) for name in names})


def value_of_row(kind: type[V], row: Row[Any] | Mapping[str, Any], **given: object) -> V:
    """Return the value of a class whose fields are columns of a row; ``given`` are those that are none."""
    columns = row._mapping if isinstance(row, Row) else row  # noqa: SLF001 - SQLAlchemy's public accessor
    values = dict(given)
    for name, read in _column_readers(cast("Hashable", kind)).items():
        if name in given or name not in columns:
            continue
        if read is stored_reason:
            code = columns["reason_code"]
            values[name] = None if code is None else Reason(ReasonCode(code), columns["reason"])
        else:
            values[name] = columns[name] if read is None else read(columns[name])
    return kind(**values)


def columns_of(value: object, *without: str) -> dict[str, Any]:
    """Return the fields of a value as columns: what JSON has no type for as lists, a reason as text and code."""
    columns: dict[str, Any] = {}
    for name, read in _column_readers(cast("Hashable", type(value))).items():
        item = getattr(value, name)
        if name in without:
            continue
        if read is stored_reason:
            columns |= reason_columns(item)
        elif isinstance(item, Enum):
            columns[name] = item.value
        elif isinstance(item, frozenset):
            columns[name] = sorted(item)
        elif isinstance(item, tuple):
            columns[name] = list(item)
        else:
            columns[name] = dict(item) if isinstance(item, Mapping) else item
    return columns


@cache
def _column_readers(kind: Hashable) -> Mapping[str, Callable[[Any], Any] | None]:
    """Return what makes the fields of a class of their columns; None where they are the same."""
    return {name: _column_reader(hint) for name, hint in hints_of(kind).items()}


def _column_reader(hint: Any) -> Callable[[Any], Any] | None:  # noqa: ANN401 - a type as it is declared
    parts = get_args(hint)
    declared = next((part for part in parts if part is not type(None)), hint) if type(None) in parts else hint
    plain = get_origin(declared) or declared
    if plain is Reason:
        return stored_reason
    if not isinstance(plain, type) or not issubclass(plain, Enum | tuple | frozenset):
        return None
    read = Members(plain).__getitem__ if issubclass(plain, Enum) else plain
    return lambda stored: None if stored is None else read(stored)


def reason_columns(reason: Reason | None) -> dict[str, str | None]:
    """Return the values of the columns ``reason`` (empty where there is none) and ``reason_code`` (then null)."""
    if reason is None:
        return {"reason": "", "reason_code": None}
    return {"reason": reason.text, "reason_code": reason.code.value}


def stored_reason(row: Any) -> Reason | None:  # noqa: ANN401 - a row of any table with both columns
    """Return the reason of a row by its columns ``reason`` and ``reason_code``; None where it has none."""
    return None if row.reason_code is None else Reason(ReasonCode(row.reason_code), row.reason)
