"""Who decodes recordings of a vehicle: one worker at a time, on as many machines as there are.

Decoding twice would give the same; this only saves the work. A lock ends with its process.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path

from sqlalchemy import Connection, text

from fleet_db.locks import locked_file, postgresql_session
from fleet_db.session import sqlite_file, translate_errors
from fleet_db.storage import SqlStorage

NAMESPACE = 0x7472_6463  # "trdc": ours among the advisory locks of a database, one number a vehicle
FILES = 64
"""Lock files beside an embedded database; vehicles that share one wait for each other."""

TryVehicle = Callable[[str], AbstractContextManager[bool]]
"""Tries to lock a vehicle for as long as the context lasts; yields whether it is locked."""


@contextmanager
def decoding_locks(storage: SqlStorage, holder: str) -> Iterator[TryVehicle]:
    """Yield what locks a vehicle."""
    file = sqlite_file(storage.engine)
    if file is not None:
        yield partial(_file_lock, file)
        return
    with translate_errors(), postgresql_session(storage.engine, holder) as session:
        yield partial(_advisory_lock, session)


def _number(vehicle: str) -> int:
    return zlib.crc32(vehicle.encode())


def _file_lock(file: Path, vehicle: str) -> AbstractContextManager[bool]:
    return locked_file(file.with_name(f"{file.name}.decoding-{_number(vehicle) % FILES:02d}"))


@contextmanager
def _advisory_lock(session: Connection, vehicle: str) -> Iterator[bool]:
    names = {"namespace": NAMESPACE, "number": _number(vehicle) - (1 << 31)}
    locked = bool(session.scalar(text("SELECT pg_try_advisory_lock(:namespace, :number)"), names))
    try:
        yield locked
    finally:
        if locked:
            session.execute(text("SELECT pg_advisory_unlock(:namespace, :number)"), names)
