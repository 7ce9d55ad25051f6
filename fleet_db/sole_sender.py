"""The one process that sends to webhooks: it holds a lock for as long as it does, or lives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from sqlalchemy import Connection, Engine, text
from sqlalchemy.exc import SQLAlchemyError

from fleet_db.locks import NAMESPACE, Subject, locked_file, postgresql_session
from fleet_db.session import sqlite_file, translate_errors


@contextmanager
def sending_alone(engine: Engine, holder: str) -> Iterator[Callable[[], bool] | None]:
    """Hold the lock of the one sender of a database; yield what tells if it is held, None where another one sends."""
    file = sqlite_file(engine)
    if file is not None:
        with locked_file(file.with_name(f"{file.name}.webhooks-lock")) as locked:
            yield (lambda: True) if locked else None
        return
    names = {"namespace": NAMESPACE, "subject": int(Subject.WEBHOOKS)}
    with translate_errors(), postgresql_session(engine, holder) as session:
        locked = bool(session.scalar(text("SELECT pg_try_advisory_lock(:namespace, :subject)"), names))
        yield (lambda: _answers(session)) if locked else None


def _answers(session: Connection) -> bool:
    """Return whether a session is alive: its locks are held for as long."""
    try:
        session.execute(text("SELECT 1"))
    except SQLAlchemyError:
        return False
    return True
