"""Which migration a database is at, and which one this version needs; without the tool that runs migrations.

Every service looks at its start, and ``/readyz`` at every request.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from sqlalchemy import Connection, Engine, inspect, text

from estimation.errors import MigrationError
from fleet_db.session import sqlite_file, translate_errors

SCRIPTS = Path(__file__).parent / "migrations"
TABLE = "alembic_version"


def check_head(engine: Engine) -> None:
    """Refuse a database that is not at the head of this version's migrations.

    Raises
    ------
    MigrationError
        It is elsewhere, or has never been migrated; the message gives the command to run.
    StorageError
        It cannot be reached.
    """
    file = sqlite_file(engine)
    if file is not None and not file.exists():
        raise MigrationError(None, head())
    with translate_errors(), engine.connect() as connection:
        found = revision_of(connection)
    if found != head():
        raise MigrationError(found, head(), known=found is None or found in known_revisions())


def revision_of(connection: Connection) -> str | None:
    """Return the migration that a database is at; None where it has never been migrated.

    A database of another origin may be at several; they are returned as one text, which no version knows.
    """
    if not inspect(connection).has_table(TABLE):
        return None
    found = connection.execute(text(f"SELECT version_num FROM {TABLE}")).scalars()  # noqa: S608 - a constant
    return ", ".join(sorted(map(str, found))) or None


def head() -> str:
    """Return the migration that this version needs."""
    return known_revisions()[-1]


@cache
def known_revisions() -> tuple[str, ...]:
    """Return the migrations of this version, the first one first: the numbers with which their files begin."""
    return tuple(sorted(path.name.partition("_")[0] for path in (SCRIPTS / "versions").glob("[0-9]*_*.py")))
