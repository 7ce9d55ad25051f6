"""Bin tables on PostgreSQL as one table and as partitions by month: what a purge and the queries of a wheelset cost.

Both have the same rows: ``WHEELSETS`` over ``MONTHS`` months, with random bytes in place of a packed table.
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable, Iterator
from typing import Any

import psycopg
from psycopg import sql

from bench.report import BenchRow
from tests.postgres_server import SAFE, stoppable_server

WHEELSETS, MONTHS, A_MONTH, KILOBYTES = 60, 12, 40, 8
MONTH_NS = 30 * 86_400_000_000_000
ROUNDS = 200
MS = 1e3
COLUMNS = (
    "wheelset text NOT NULL, start_ns bigint NOT NULL, roll_up bigint, packed bytea NOT NULL,"
    " PRIMARY KEY (wheelset, start_ns)"
)
QUERIES = {
    "one window": "SELECT packed FROM {table} WHERE wheelset = %(wheelset)s AND start_ns = %(start_ns)s",
    "newest window of a wheelset": (
        "SELECT start_ns FROM {table} WHERE wheelset = %(wheelset)s ORDER BY start_ns DESC LIMIT 1"
    ),
    "windows of a roll-up": "SELECT start_ns FROM {table} WHERE wheelset = %(wheelset)s AND roll_up = %(roll_up)s",
}
Connection = psycopg.Connection[tuple[Any, ...]]


def rows() -> Iterator[BenchRow]:
    """Yield the cost of a purge of one month, and of each query, of both."""
    with stoppable_server(SAFE) as server, psycopg.connect(server.url, autocommit=True) as connection:
        _fill(connection)
        for name, text in QUERIES.items():
            one, parts = (_query(connection, text, table) for table in ("one", "parts"))
            yield BenchRow(f"{name}: one table, partitions", f"{one:.3f}, {parts:.3f} ms", "", met=True)
        for table, purges in (("one", (_delete_roll_ups, _vacuum)), ("parts", (_drop,))):
            for purge in purges:
                seconds, written = _spent(connection, purge)
                shown = f"{seconds:.2f} s, {written / 1e6:.1f} MB of log"
                yield BenchRow(f"a month of {WHEELSETS * A_MONTH:,} tables, {table}: {purge.__name__[1:]}", shown, "",
                               met=True)  # fmt: skip
        before = _size(connection, "one")
        _refill(connection)
        after = _size(connection, "one")
        yield BenchRow("one table after the same number of rows came again", f"{after / before:.3f} times its size", "",
                       met=True)  # fmt: skip


def _fill(connection: Connection) -> None:
    connection.execute(sql.SQL("CREATE TABLE one (" + COLUMNS + ")"))
    connection.execute(sql.SQL("CREATE TABLE parts (" + COLUMNS + ") PARTITION BY RANGE (start_ns)"))
    for month in range(MONTHS):
        first, last = month * MONTH_NS, (month + 1) * MONTH_NS
        name = sql.Identifier(f"parts_{month}")
        connection.execute(
            sql.SQL("CREATE TABLE {} PARTITION OF parts FOR VALUES FROM ({}) TO ({})").format(name, first, last)
        )
    for table in ("one", "parts"):
        connection.execute(sql.SQL("CREATE INDEX ON {} (roll_up, start_ns)").format(sql.Identifier(table)))
        for month in range(MONTHS):
            _put(connection, table, month)
        connection.execute(sql.SQL("VACUUM ANALYZE {}").format(sql.Identifier(table)))


def _put(connection: Connection, table: str, month: int) -> None:
    """Put the windows of a month; a roll-up is a month of a wheelset here."""
    connection.execute(
        sql.SQL(
            "INSERT INTO {} SELECT 'WS-' || w, {}::bigint + n * {}::bigint, w * 1000 + {},"
            " (SELECT decode(string_agg(md5(random()::text), ''), 'hex') FROM generate_series(1, {} + 0 * n))"
            " FROM generate_series(1, {}) w, generate_series(0, {}) n"
        ).format(
            sql.Identifier(table), month * MONTH_NS, MONTH_NS // A_MONTH, month, KILOBYTES * 64, WHEELSETS, A_MONTH - 1
        )
    )


def _query(connection: Connection, text: str, table: str) -> float:
    """Return the median of planning and execution of a prepared query, ms."""
    statement = sql.SQL("EXPLAIN (ANALYZE, FORMAT JSON) " + text).format(table=sql.Identifier(table))
    found = []
    for number in range(ROUNDS):
        wheelset, month, n = number % WHEELSETS + 1, number % MONTHS, number % A_MONTH
        values = {
            "wheelset": f"WS-{wheelset}",
            "start_ns": month * MONTH_NS + n * (MONTH_NS // A_MONTH),
            "roll_up": wheelset * 1000 + month,
        }
        row = connection.execute(statement, values).fetchone()
        assert row is not None
        plan = json.loads(row[0])[0] if isinstance(row[0], str) else row[0][0]
        found.append(plan["Planning Time"] + plan["Execution Time"])
    return statistics.median(found)


def _spent(connection: Connection, work: Callable[[Connection], None]) -> tuple[float, float]:
    """Return the seconds that something takes, and the bytes that it writes to the log."""
    before, clock = _written(connection), time.perf_counter()
    work(connection)
    return time.perf_counter() - clock, _written(connection) - before


def _written(connection: Connection) -> float:
    row = connection.execute("SELECT pg_current_wal_insert_lsn() - '0/0'::pg_lsn").fetchone()
    assert row is not None
    return float(row[0])


def _delete_roll_ups(connection: Connection) -> None:
    """Delete the tables of the first month, one roll-up a transaction, as the purge does."""
    for wheelset in range(1, WHEELSETS + 1):
        connection.execute("DELETE FROM one WHERE roll_up = %s", [wheelset * 1000])


def _vacuum(connection: Connection) -> None:
    connection.execute("VACUUM one")


def _drop(connection: Connection) -> None:
    connection.execute("DROP TABLE parts_0")


def _refill(connection: Connection) -> None:
    _put(connection, "one", MONTHS)


def _size(connection: Connection, table: str) -> float:
    row = connection.execute("SELECT pg_total_relation_size(%s)", [table]).fetchone()
    assert row is not None
    return float(row[0])
