"""Bring a database to the head of the migrations, and refuse one that is elsewhere."""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine

from estimation.errors import MigrationError, StorageError
from fleet_db.locks import Subject, serialise
from fleet_db.session import IMMEDIATE, database_engine, sqlite_file, translate_errors

SCRIPTS = Path(__file__).parent / "migrations"


def upgrade(url: str) -> str:
    """Create the database file if there is none, run every missing migration in one transaction; return the head.

    Raises
    ------
    ParameterError
        ``url`` names no database that can be used.
    MigrationError
        The database is at a migration that this version does not know.
    StorageError
        It cannot be reached.
    """
    engine = database_engine(url)
    file = sqlite_file(engine)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
    try:
        with translate_errors(), engine.connect().execution_options(**IMMEDIATE) as connection, connection.begin():
            serialise(connection, Subject.MIGRATION)
            found = MigrationContext.configure(connection).get_current_revision()
            if found is not None and found not in _known():
                raise MigrationError(found, head(), known=False)
            config = _config()
            config.attributes["connection"] = connection
            command.upgrade(config, "head")
    finally:
        engine.dispose()
    return head()


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
        found = MigrationContext.configure(connection).get_current_revision()
    if found != head():
        raise MigrationError(found, head(), known=found is None or found in _known())


def head() -> str:
    """Return the migration that this version needs."""
    found = ScriptDirectory.from_config(_config()).get_current_head()
    if found is None:
        raise StorageError(f"no migrations under {SCRIPTS}")
    return found


def _known() -> frozenset[str]:
    return frozenset(script.revision for script in ScriptDirectory.from_config(_config()).walk_revisions())


def _config() -> Config:
    config = Config()
    config.set_main_option("script_location", str(SCRIPTS).replace("%", "%%"))
    return config
