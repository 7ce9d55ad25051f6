"""Engines from a URL, and their errors as ours: SQLite as one careful writer, PostgreSQL through psycopg 3.

SQLite: the driver's own transaction handling is off, every transaction begins explicitly, and a transaction that will
write begins IMMEDIATE, so that two writers wait for each other instead of failing half-way.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import orjson
import sqlalchemy
from sqlalchemy import URL, Connection, Dialect, Engine, event
from sqlalchemy.exc import (
    ArgumentError,
    DBAPIError,
    IntegrityError,
    InvalidatePoolError,
    SQLAlchemyError,
    StatementError,
)
from sqlalchemy.pool import ConnectionPoolEntry

from estimation.errors import ConflictError, ParameterError, StorageError


@dataclass(frozen=True, slots=True)
class ServerLimits:
    """How long a database server may take."""

    connect_s: int = 5  # to accept a connection; the driver takes at least 2 s
    silence_s: float = 10.0  # to say anything about a statement, before it is asked whether it is there
    statement_s: float | None = None  # for one statement; None without a limit

    def options(self) -> dict[str, int]:
        """Return the driver's options: also for a peer whose kernel has gone without a word."""
        return {
            "connect_timeout": self.connect_s,
            "keepalives_idle": max(1, round(self.silence_s)),
            "keepalives_interval": max(1, round(self.silence_s / 2)),
            "keepalives_count": 3,
            "tcp_user_timeout": round(2000 * self.silence_s),  # ms
        }


RETRY_S = 1.0
"""After a failure nobody tries to connect for this long, in seconds."""


@dataclass(slots=True)
class Reachability:
    """Whether the last attempt to connect failed, when, and with which message."""

    clock: Callable[[], float] = time.monotonic
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _failure: tuple[float, str] | None = None
    _trying: bool = False

    def refusal(self) -> str | None:
        """Return why not to try now; None to the caller that may, who then reports what came of it."""
        with self._lock:
            if self._failure is None:
                return None
            failed_at_s, message = self._failure
            if self._trying or self.clock() - failed_at_s < RETRY_S:
                return message
            self._trying = True
            return None

    def succeeded(self) -> None:
        """Let everyone try from now on."""
        with self._lock:
            self._failure, self._trying = None, False

    def failed(self, message: str) -> None:
        """Let nobody try for a while."""
        with self._lock:
            self._failure, self._trying = (self.clock(), message), False


def guard_connecting(engine: Engine, open_connection: Callable[..., Any]) -> None:
    """Let the attempts of this engine to connect go through one :class:`Reachability`.

    The message of an attempt that failed is passed on without the password.
    """
    reachability = Reachability()

    def connect(dialect: Dialect, _entry: ConnectionPoolEntry, positional: list[Any], named: dict[str, Any]) -> Any:  # noqa: ANN401 - the driver's own type
        failure = dialect.loaded_dbapi.OperationalError
        refusal = reachability.refusal()
        if refusal is not None:
            raise failure(refusal)
        try:
            connection = open_connection(*positional, **named)
        except dialect.loaded_dbapi.Error as error:
            message = str(error)
            if named.get("password"):
                message = message.replace(str(named["password"]), "***")
            reachability.failed(message)
            raise failure(message) from None
        except BaseException:
            reachability.failed("the attempt to connect was broken off")
            raise
        reachability.succeeded()
        return connection

    event.listen(engine, "do_connect", connect)


BUSY_TIMEOUT_MS = 30_000
BEGIN_OPTION = "sqlite_begin"
IMMEDIATE = {BEGIN_OPTION: "BEGIN IMMEDIATE"}
SNAPSHOT = {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}
POOL_TIMEOUT_S = 10.0
"""How long a thread waits for one of the connections of its process, in seconds."""
IDLE_S = 1.0
"""A connection silent for so long is asked whether it is alive before it is used, in seconds."""
POSTGRESQL = ("postgresql", "postgresql+psycopg")
UNLIMITED = ServerLimits()
SQLITE = ("sqlite", "sqlite+pysqlite")

to_json = partial(json.dumps, allow_nan=False, ensure_ascii=False, separators=(",", ":"))


def database_engine(url: str, limits: ServerLimits = UNLIMITED) -> Engine:
    """Return an engine; nothing is connected yet.

    Args:
        url: ``sqlite:////absolute/path/treadwatch.sqlite3`` or ``postgresql://user@host/database``.
        limits: Of a server; without those of a deployment a statement may take as long as it takes.

    Raises:
        ParameterError: Another database, no valid URL, a relative path or ``:memory:``.
    """
    try:
        parsed = sqlalchemy.make_url(url)
    except (ArgumentError, ValueError):  # without its cause: that repeats parts of the URL
        raise ParameterError("is no database URL", field="database_url") from None
    if parsed.drivername in SQLITE:
        return _sqlite_engine(parsed)
    if parsed.drivername in POSTGRESQL:
        return _postgresql_engine(parsed, limits)
    raise ParameterError(f"names {parsed.drivername!r}; known are sqlite and postgresql", field="database_url")


def read_only_engine(file: Path) -> Engine:
    """Return an engine on an SQLite file that nobody writes to, such as that of a backup; it changes no byte of it.

    Args:
        file: The database file, without a log beside it.
    """
    return sqlalchemy.create_engine(f"sqlite+pysqlite:///{file.resolve().as_uri()}?mode=ro&immutable=1&uri=true")


def sqlite_file(engine: Engine) -> Path | None:
    """Return the database file of an SQLite engine, None on PostgreSQL."""
    return Path(str(engine.url.database)) if engine.dialect.name == "sqlite" else None


def _sqlite_engine(url: URL) -> Engine:
    name = url.database or ""
    if not Path(name).is_absolute():
        reason = f"names the SQLite file {name or ':memory:'!r}; an absolute path is needed (sqlite:////...)"
        raise ParameterError(reason, field="database_url")
    engine = sqlalchemy.create_engine(
        url.set(drivername="sqlite+pysqlite", query={}),
        connect_args={"timeout": BUSY_TIMEOUT_MS / 1000},
        json_serializer=to_json,
        json_deserializer=orjson.loads,
    )
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def reading_engine(engine: Engine) -> Engine:
    """Return the engine of reading transactions on the same database: on SQLite one whose connections cannot write."""
    if engine.dialect.name != "sqlite":
        return engine
    reading = _sqlite_engine(engine.url)
    event.listen(reading, "connect", lambda connection, _: connection.execute("PRAGMA query_only = ON").close())
    return reading


def _prepare_sqlite(connection: Any, _entry: ConnectionPoolEntry) -> None:  # noqa: ANN401 - the driver's own type
    connection.isolation_level = None
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout = {BUSY_TIMEOUT_MS}")
    cursor.execute("PRAGMA journal_mode = WAL")
    cursor.execute("PRAGMA synchronous = FULL")
    cursor.execute("PRAGMA foreign_keys = ON")
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    connection.exec_driver_sql(connection.get_execution_options().get(BEGIN_OPTION, "BEGIN"))


def _postgresql_engine(url: URL, limits: ServerLimits) -> Engine:
    if "@" in f"{url.host}{url.database}":  # the rest of a password, which messages about host and name would repeat
        raise ParameterError("has an @ in its password: write it as %40", field="database_url")
    # the driver takes memory that a deployment on SQLite does not have to spend
    from fleet_db.watched_connection import EndedPipelineCursor, WatchedConnection  # noqa: PLC0415

    engine = sqlalchemy.create_engine(
        url.set(drivername="postgresql+psycopg"),
        pool_size=10,
        pool_timeout=POOL_TIMEOUT_S,
        connect_args={**limits.options(), "cursor_factory": EndedPipelineCursor},
        json_serializer=to_json,
        json_deserializer=orjson.loads,
    )
    guard_connecting(engine, partial(WatchedConnection.open, limits.silence_s, limits.statement_s))
    event.listen(engine, "checkout", partial(_check_idle, engine.dialect))
    event.listen(engine, "connect", partial(_prepare_postgresql, limits))
    return engine


def _check_idle(dialect: Dialect, connection: Any, _entry: ConnectionPoolEntry, _proxy: object) -> None:  # noqa: ANN401 - the driver's own type
    """Ask a connection that has been idle whether it is alive; with a dead one go all that were opened before.

    Not one that answered a moment ago: the question would double what a small request costs.
    """
    if time.monotonic() - connection.answered_s < IDLE_S:
        return
    try:
        dialect.do_ping(connection)
    except dialect.loaded_dbapi.Error:
        raise InvalidatePoolError from None


def _prepare_postgresql(limits: ServerLimits, connection: Any, _entry: ConnectionPoolEntry) -> None:  # noqa: ANN401 - the driver's own type
    """Let no server acknowledge a commit that it may still lose when it crashes, or work on what nobody waits for."""
    with connection.cursor() as cursor:
        cursor.execute(
            "SELECT set_config('synchronous_commit', 'on', false) WHERE current_setting('synchronous_commit') = 'off'"
        )
        if limits.statement_s is not None:
            cursor.execute("SELECT set_config('statement_timeout', %s, false)", [str(round(1000 * limits.statement_s))])
    connection.commit()


@contextmanager
def dropped_on_failure(connection: Connection) -> Iterator[None]:
    """Keep a connection out of the pool where the transaction fails.

    On SQLite a statement that is not read to its end keeps its snapshot for as long as the traceback lives.
    """
    try:
        yield
    except BaseException:
        if connection.dialect.name == "sqlite":
            connection.invalidate()
        raise


def snapshot(connection: Connection) -> AbstractContextManager[object]:
    """Return the reading transaction of a connection: it sees one snapshot."""
    if connection.dialect.name == "sqlite":
        return connection.begin()
    # committed: the driver forgets with a rollback what the server has prepared, and nothing was written
    return connection.execution_options(**SNAPSHOT).begin()


@contextmanager
def translate_errors() -> Iterator[None]:
    """Turn errors of SQLAlchemy and of the drivers into ours.

    Raises:
        ConflictError: A constraint of the database refused it.
        ParameterError: A value that JSON cannot hold (NaN, infinity, an object).
        StorageError: Everything else: unreachable, locked, full.
    """
    try:
        yield
    except IntegrityError as error:
        raise ConflictError(f"the database refused it: {_first_line(error.orig)}") from error
    except DBAPIError as error:
        raise StorageError(f"the database failed: {_first_line(error.orig)}") from error
    except StatementError as error:
        if isinstance(error.orig, ValueError | TypeError):
            raise ParameterError(f"cannot be stored: {_first_line(error.orig)}") from error
        raise StorageError(f"the database failed: {_first_line(error.orig)}") from error
    except SQLAlchemyError as error:
        raise StorageError(f"the database failed: {_first_line(error)}") from error


def _first_line(error: BaseException | None) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
