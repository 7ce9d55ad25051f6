"""Locks between processes: one writer on SQLite, one scheduler on either database, one assembler of a vehicle.

On PostgreSQL they are advisory locks: ordered commits, and what is one transaction at a time anyway on SQLite.
"""

from __future__ import annotations

import fcntl
import logging
import os
import threading
import time
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path

from sqlalchemy import Connection, Engine, delete, insert, select, text
from sqlalchemy.exc import SQLAlchemyError

from estimation.errors import AlreadyRunningError, BusyError, ClaimLostError, StorageError
from estimation.values.runs import JobTrigger
from fleet_db.rows import table_of
from fleet_db.tables import JobOwnerRow

POLL_S = 0.002
NAME_LENGTH = 60  # PostgreSQL keeps 63 bytes of an application name
NAMESPACE = 0x7472_6561  # "trea": ours among the advisory locks of a database
VEHICLES = 0x7472_7668  # "trvh": those of the assemblers, one number a vehicle


class Subject(IntEnum):
    """What an advisory lock guards."""

    SCHEDULER = 1
    REGISTRY = 2
    ALERTS = 3
    GEOMETRIES = 4
    TRACKS = 5
    MIGRATION = 6
    SETTINGS = 7
    WEBHOOKS = 8
    KEEPING = 9


def serialise(connection: Connection, subject: Subject) -> None:
    """Let no other transaction into ``subject`` until this one has ended.

    On PostgreSQL a transaction-level advisory lock, released after the commit is visible: numbers drawn under it are
    in commit order. On SQLite a writing transaction is alone anyway.
    """
    if connection.dialect.name == "postgresql":
        connection.execute(
            text("SELECT pg_advisory_xact_lock(:namespace, :subject)"),
            {"namespace": NAMESPACE, "subject": int(subject)},
        )


def serialise_vehicle(connection: Connection, vehicle: str) -> None:
    """Let no other transaction assemble windows of a vehicle until this one has ended; taken before any other lock.

    On PostgreSQL statements after it see what the transaction that had it before has committed. Two vehicles whose
    codes have one checksum wait for each other, which costs time and nothing else. On SQLite a writing transaction is
    alone anyway.

    Args:
        vehicle: Code of the vehicle, registered or not.
    """
    if connection.dialect.name == "postgresql":
        number = zlib.crc32(vehicle.encode()) - (1 << 31)  # the key is a signed integer of 32 bits
        connection.execute(
            text("SELECT pg_advisory_xact_lock(:vehicles, :number)"), {"vehicles": VEHICLES, "number": number}
        )


@contextmanager
def single_writer(path: Path, timeout_s: float) -> Iterator[None]:
    """Hold the lock file ``path``: the writing transactions of all threads and processes, one after the other.

    Raises:
        BusyError: Another writer held it for longer than ``timeout_s``.
    """
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        until = time.monotonic() + timeout_s
        while not _locked(handle):
            if time.monotonic() > until:
                raise BusyError(f"another writer has held the database for {timeout_s:g} s ({path.name})")
            time.sleep(POLL_S)
        yield
    finally:
        os.close(handle)


@contextmanager
def locked_file(path: Path, flags: int = os.O_RDWR | os.O_CREAT, *, shared: bool = False) -> Iterator[bool]:
    """Try to lock a file, for as long as the context lasts or the process lives; yield whether it was free.

    Args:
        path: Created where it does not exist, unless ``flags`` say otherwise.
        flags: Of ``os.open``.
        shared: Whether others may hold it shared at the same time.
    """
    handle = os.open(path, flags | os.O_CLOEXEC, 0o644)
    try:
        yield _locked(handle, fcntl.LOCK_SH if shared else fcntl.LOCK_EX)
    finally:
        os.close(handle)


@contextmanager
def file_scheduler_lock(path: Path, holder: str) -> Iterator[None]:
    """Hold the lock file ``path``, with ``holder`` written inside; the system lets it go when the process dies.

    Raises:
        AlreadyRunningError: Another process holds it; names the holder.
    """
    with locked_file(path) as locked:
        if not locked:
            raise AlreadyRunningError(path.read_text(errors="replace").strip() or "not yet named")
        path.write_text(holder)  # the same file: its lock is on the inode
        yield
        path.write_text("")


@contextmanager
def postgresql_session(engine: Engine, holder: str) -> Iterator[Connection]:
    """Yield a connection of its own, which carries ``holder`` as its name; locks taken on it end with it."""
    connection = engine.connect().execution_options(isolation_level="AUTOCOMMIT")
    try:
        name = holder.encode()[:NAME_LENGTH].decode(errors="ignore")
        connection.execute(text("SELECT set_config('application_name', :name, false)"), {"name": name})
        yield connection
    finally:
        with suppress(SQLAlchemyError):  # a server that lost the connection has let them go
            connection.execute(text("SELECT pg_advisory_unlock_all()"))  # here, not when it notices the end
        connection.invalidate()  # the session ends with its locks, and its name never gets back into the pool
        connection.close()


def lock_scheduler(session: Connection) -> None:
    """Take the lock of the one scheduler of this database, for as long as the session lasts.

    Raises:
        AlreadyRunningError: Another session holds it; names who.
    """
    names = {"namespace": NAMESPACE, "subject": int(Subject.SCHEDULER)}
    if not session.scalar(text("SELECT pg_try_advisory_lock(:namespace, :subject)"), names):
        raise AlreadyRunningError(session.scalar(text(HOLDER_SQL), names) or "just ended")


HOLDER_SQL = """
SELECT activity.application_name
FROM pg_locks AS locks JOIN pg_stat_activity AS activity USING (pid)
WHERE locks.locktype = 'advisory' AND locks.granted AND locks.objsubid = 2
  AND locks.classid = CAST(:namespace AS bigint) AND locks.objid = CAST(:subject AS bigint)
  AND locks.database = (SELECT oid FROM pg_database WHERE datname = current_database())
"""


def _locked(handle: int, kind: int = fcntl.LOCK_EX) -> bool:
    try:
        fcntl.flock(handle, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


PROLONGED_A_LEASE = 4
"""How often a lease is prolonged during its length."""


@dataclass(frozen=True, slots=True)
class Lease:
    """The lease under which a process stores results."""

    number: int
    holder: str
    length_s: float


_log = logging.getLogger(__name__)


@contextmanager
def prolonged(prolong: Callable[[], bool], length_s: float) -> Iterator[None]:
    """Prolong a lease until the block ends.

    Args:
        prolong: Prolongs it, in a transaction of its own; returns whether it was still there.
        length_s: Of the lease, s.
    """
    over = threading.Event()
    thread = threading.Thread(target=_prolong, args=(prolong, length_s, over), name="lease", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _prolong(prolong: Callable[[], bool], length_s: float, over: threading.Event) -> None:
    while not over.wait(length_s / PROLONGED_A_LEASE):
        try:
            if not prolong():
                return  # what is committed next finds that out
        except StorageError as error:
            _log.warning("a lease could not be prolonged: %s", error)


@dataclass(frozen=True, slots=True)
class UnendedLease:
    """A lease that nobody works under any more.

    Attributes:
        number: Of the lease.
        stage: Of the work.
        begun_ns: When work on each key was begun under it, ns by the clock of the claims.
    """

    number: int
    stage: str
    begun_ns: Mapping[str, int]


@dataclass(slots=True)
class UnendedLeases:
    """Those of one process; its threads may add and end them."""

    _lock: threading.Lock = field(default_factory=threading.Lock)
    _left: list[UnendedLease] = field(default_factory=list)

    def add(self, lease: UnendedLease) -> None:
        """Keep a lease that could not be ended."""
        with self._lock:
            self._left.append(lease)

    def left(self) -> Sequence[UnendedLease]:
        """Return those that are to be ended."""
        with self._lock:
            return tuple(self._left)

    def ended(self, leases: Sequence[UnendedLease]) -> None:
        """Forget those that have been ended."""
        with self._lock:
            self._left = [one for one in self._left if one not in leases]


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
