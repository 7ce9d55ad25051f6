"""Locks between processes: one writer on SQLite, one assembler of a vehicle; and leases, which end with time.

On PostgreSQL they are advisory locks: ordered commits, and what is one transaction at a time anyway on SQLite. What one
process does as long as it lives (it sends to webhooks, keeps files, decodes a vehicle) it holds a lock file for beside
an embedded database, and an advisory lock of a session of its own on PostgreSQL.
"""

from __future__ import annotations

import fcntl
import logging
import os
import threading
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from pathlib import Path

from sqlalchemy import Connection, Engine, text
from sqlalchemy.exc import SQLAlchemyError

from estimation.errors import BusyError, ConflictError, StorageError
from fleet_db.session import sqlite_file, translate_errors

POLL_S = 0.002
NAME_LENGTH = 60  # PostgreSQL keeps 63 bytes of an application name
NAMESPACE = 0x7472_6561  # "trea": ours among the advisory locks of a database
VEHICLES = 0x7472_7668  # "trvh": those of the assemblers, one number a vehicle


class Subject(IntEnum):
    """What an advisory lock guards."""

    REGISTRY = 2
    ALERTS = 3
    GEOMETRIES = 4
    TRACKS = 5
    MIGRATION = 6
    SETTINGS = 7
    WEBHOOKS = 8
    KEEPING = 9
    UNCLAIMED = 10


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
    """
    if connection.dialect.name == "postgresql":
        number = zlib.crc32(vehicle.encode()) - (1 << 31)  # the key is a signed integer of 32 bits
        connection.execute(
            text("SELECT pg_advisory_xact_lock(:vehicles, :number)"), {"vehicles": VEHICLES, "number": number}
        )


@contextmanager
def single_writer(path: Path, timeout_s: float) -> Iterator[None]:
    """Hold the lock file of the writing transactions of all threads and processes; BusyError: held for too long."""
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
def locked_file(path: Path) -> Iterator[bool]:
    """Try to lock a file, for as long as the context lasts or the process lives; yield whether it was free."""
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        yield _locked(handle)
    finally:
        os.close(handle)


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


def _locked(handle: int) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
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
    """Prolong a lease until the block ends; ``prolong`` returns whether it was still there."""
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


@dataclass(slots=True)
class Claims:
    """What is claimed of a stage under a lease and not free yet."""

    stage: str
    keys: set[str]


@dataclass(frozen=True, slots=True)
class UnendedLease:
    """Claims under a lease that nobody works on any more."""

    number: int  # of the lease
    stage: str  # of the work
    begun_ns: Mapping[str, int]  # when work on each key was begun under it, by the clock of the claims
    alone: bool = True  # whether it is the lease of these claims alone, and ends with them


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
            self._left = [lease for lease in self._left if lease not in leases]


DECODING = 0x7472_6463  # "trdc": ours among the advisory locks of a database, one number a vehicle
FILES = 64
"""Lock files for decoding beside an embedded database; vehicles that share one wait for each other."""

TryVehicle = Callable[[str], AbstractContextManager[bool]]
"""Tries to lock a vehicle for as long as the context lasts; yields whether it is locked."""


@contextmanager
def sending_alone(engine: Engine, holder: str) -> Iterator[Callable[[], bool] | None]:
    """Hold the lock of the one sender of a database; yield what tells if it is held, None where another one sends."""
    file = sqlite_file(engine)
    if file is not None:
        with locked_file(file.with_name(f"{file.name}.webhooks-lock")) as locked:
            yield (lambda: True) if locked else None
        return
    with translate_errors(), postgresql_session(engine, holder) as session:
        yield (lambda: _answers(session)) if _try(session, NAMESPACE, Subject.WEBHOOKS) else None


@contextmanager
def keeping_alone(engine: Engine) -> Iterator[None]:
    """Hold the lock of those who copy or delete files of a database; ConflictError: another process holds it."""
    busy = ConflictError("a backup, restore or purge of this database is running", kind="keeping", key="lock")
    file = sqlite_file(engine)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        with locked_file(file.with_name(f"{file.name}.keeping-lock")) as locked:
            if not locked:
                raise busy
            yield
        return
    with translate_errors(), postgresql_session(engine, "keeping") as session:
        if not _try(session, NAMESPACE, Subject.KEEPING):
            raise busy
        yield


@contextmanager
def decoding_locks(engine: Engine, holder: str) -> Iterator[TryVehicle]:
    """Yield what locks a vehicle: decoding it twice would give the same, this only saves the work."""
    file = sqlite_file(engine)
    if file is not None:
        yield lambda vehicle: locked_file(
            file.with_name(f"{file.name}.decoding-{zlib.crc32(vehicle.encode()) % FILES:02d}")
        )
        return
    with translate_errors(), postgresql_session(engine, holder) as session:
        yield partial(_advisory_lock, session)


def _try(session: Connection, namespace: int, number: int) -> bool:
    names = {"namespace": namespace, "number": int(number)}
    return bool(session.scalar(text("SELECT pg_try_advisory_lock(:namespace, :number)"), names))


def _answers(session: Connection) -> bool:
    """Return whether a session is alive: its locks are held for as long."""
    try:
        session.execute(text("SELECT 1"))
    except SQLAlchemyError:
        return False
    return True


@contextmanager
def _advisory_lock(session: Connection, vehicle: str) -> Iterator[bool]:
    number = zlib.crc32(vehicle.encode()) - (1 << 31)
    locked = _try(session, DECODING, number)
    try:
        yield locked
    finally:
        if locked:
            names = {"namespace": DECODING, "number": number}
            session.execute(text("SELECT pg_advisory_unlock(:namespace, :number)"), names)
