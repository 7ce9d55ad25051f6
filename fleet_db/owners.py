"""Processes that run jobs: each has a row with a token, and holds a lock with that number for as long as it lives.

Who is alive is asked of the locks, never of a clock: the system lets a lock go when its process dies, and PostgreSQL
when the session ends. A row is removed by its own process at the end, or by whoever finds its lock free. Transactions
of a process that owns runs look for its row before they commit: without it nothing is committed.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import Connection, Engine, delete, insert, select, text

from estimation.errors import ClaimLostError
from estimation.values.runs import JobTrigger
from fleet_db.locks import locked_file
from fleet_db.rows import table_of
from fleet_db.tables import JobOwnerRow

OWNERS = table_of(JobOwnerRow)
LOCKS = 0x7472_6F77  # "trow": those of owners among the advisory locks of a database
NUMBERS = 1 << 31  # the key of an advisory lock is a signed integer of 32 bits

LIVING_SQL = """
SELECT objid FROM pg_locks
WHERE locktype = 'advisory' AND granted AND objsubid = 2 AND classid = CAST(:locks AS bigint)
  AND database = (SELECT oid FROM pg_database WHERE datname = current_database())
"""


def living(connection: Connection, tokens: Collection[int]) -> frozenset[int]:
    """Return which of these owners are alive."""
    if not tokens:
        return frozenset()
    if connection.dialect.name == "postgresql":
        held = {int(number) for number in connection.execute(text(LIVING_SQL), {"locks": LOCKS}).scalars()}
        return frozenset(token for token in tokens if token % NUMBERS in held)
    return frozenset(token for token in tokens if _is_locked(lock_file(connection.engine, token)))


def remove_dead(connection: Connection) -> frozenset[int]:
    """Remove the owners that are gone and return those that are alive."""
    tokens = connection.execute(select(OWNERS.c.token)).scalars().all()
    alive = living(connection, tokens)
    for token in set(tokens) - alive:
        remove(connection, token)
    return alive


def remove(connection: Connection, token: int) -> None:
    """Remove an owner: from here on it can commit nothing. Waits for what it is committing."""
    connection.execute(delete(OWNERS).where(OWNERS.c.token == token))
    if connection.dialect.name == "sqlite":
        lock_file(connection.engine, token).unlink(missing_ok=True)


def add(connection: Connection, kind: JobTrigger, holder: str, now_ns: int) -> int:
    """Add an owner and return its token; a scheduler takes over from the one before, whose lock it holds by now.

    Args:
        now_ns: Our time, ns UTC.
    """
    if kind is JobTrigger.SCHEDULE:
        for token in connection.execute(select(OWNERS.c.token).where(OWNERS.c.kind == kind.value)).scalars().all():
            remove(connection, token)
    statement = insert(OWNERS).values(kind=kind.value, holder=holder, since_ns=now_ns)
    return int(connection.execute(statement.returning(OWNERS.c.token)).scalar_one())


def check_claim(connection: Connection, token: int, holder: str) -> None:
    """Raise unless the owner still has its row; nobody removes it before this transaction ends.

    Raises:
        ClaimLostError: It has none.
    """
    statement = select(OWNERS.c.token).where(OWNERS.c.token == token).with_for_update(read=True)
    if connection.execute(statement).first() is None:
        raise ClaimLostError(holder)


def has_claim(connection: Connection, token: int) -> bool:
    """Return whether the owner still has its row."""
    return connection.execute(select(OWNERS.c.token).where(OWNERS.c.token == token)).first() is not None


def lock_file(engine: Engine, token: int) -> Path:
    """Return the file that an owner locks, beside an SQLite database."""
    file = Path(str(engine.url.database))
    return file.with_name(f"{file.name}.owner-{token}")


@contextmanager
def file_owner_lock(path: Path) -> Iterator[None]:
    """Hold the lock file of an owner."""
    with locked_file(path) as locked:
        assert locked  # a token is used once
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def lock_owner(session: Connection, token: int) -> None:
    """Take the lock of an owner, for as long as the session lasts."""
    session.execute(text("SELECT pg_advisory_lock(:locks, :number)"), {"locks": LOCKS, "number": token % NUMBERS})


def _is_locked(path: Path) -> bool:
    if not path.exists():
        return False
    try:
        with locked_file(path, os.O_RDONLY, shared=True) as locked:
            return not locked
    except FileNotFoundError:
        return False
