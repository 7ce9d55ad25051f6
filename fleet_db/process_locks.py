"""What one process does at a time, as long as it lives: it sends to webhooks, keeps files, or decodes a vehicle.

The locks are files beside an embedded database, and advisory locks of a session of their own on PostgreSQL.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path

from sqlalchemy import Connection, Engine, text
from sqlalchemy.exc import SQLAlchemyError

from estimation.errors import ConflictError
from fleet_db.locks import NAMESPACE, Subject, locked_file, postgresql_session
from fleet_db.session import sqlite_file, translate_errors
from fleet_db.storage import SqlStorage

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
def decoding_locks(storage: SqlStorage, holder: str) -> Iterator[TryVehicle]:
    """Yield what locks a vehicle: decoding it twice would give the same, this only saves the work."""
    file = sqlite_file(storage.engine)
    if file is not None:
        yield partial(_file_lock, file)
        return
    with translate_errors(), postgresql_session(storage.engine, holder) as session:
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


def _file_lock(file: Path, vehicle: str) -> AbstractContextManager[bool]:
    return locked_file(file.with_name(f"{file.name}.decoding-{zlib.crc32(vehicle.encode()) % FILES:02d}"))


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
