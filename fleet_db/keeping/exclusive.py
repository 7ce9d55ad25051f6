"""One backup, restore or purge at a time: a file that is being copied is not deleted."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from sqlalchemy import Engine, text
from sqlalchemy.exc import SQLAlchemyError

from estimation.errors import ConflictError, StorageError
from fleet_db.locks import NAMESPACE, Subject, single_writer
from fleet_db.session import sqlite_file, translate_errors

BUSY = "a backup, restore or purge of this database is running"


@contextmanager
def keeping_alone(engine: Engine) -> Iterator[None]:
    """Hold the lock of those who copy or delete files of a database; ConflictError: another process holds it."""
    file = sqlite_file(engine)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        with _file_lock(file.with_name(f"{file.name}.keeping-lock")):
            yield
        return
    names = {"namespace": NAMESPACE, "subject": int(Subject.KEEPING)}
    with translate_errors():
        connection = engine.connect().execution_options(isolation_level="AUTOCOMMIT")
    try:
        with translate_errors():
            if not connection.scalar(text("SELECT pg_try_advisory_lock(:namespace, :subject)"), names):
                raise ConflictError(BUSY, kind="keeping", key="lock")
        yield
    finally:
        with suppress(SQLAlchemyError):  # the next may come at once; a session that is gone holds nothing
            connection.scalar(text("SELECT pg_advisory_unlock(:namespace, :subject)"), names)
        connection.invalidate()
        connection.close()


@contextmanager
def _file_lock(path: Path) -> Iterator[None]:
    with ExitStack() as held:
        try:
            held.enter_context(single_writer(path, 0.0))
        except StorageError as error:
            raise ConflictError(BUSY, kind="keeping", key="lock") from error
        yield
