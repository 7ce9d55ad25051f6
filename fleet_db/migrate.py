"""Bring a database to the head of the migrations."""

from __future__ import annotations

from alembic import command
from alembic.config import Config

from fleet_db.locks import Subject, serialise
from fleet_db.revisions import SCRIPTS, check_upgradable, head
from fleet_db.session import IMMEDIATE, database_engine, sqlite_file, translate_errors


def upgrade(url: str) -> str:
    """Create the database file if there is none, run every missing migration in one transaction; return the head.

    Raises:
        ParameterError: ``url`` names no database that can be used.
        MigrationError: The database is from before the first release, or of a later version.
        StorageError: It cannot be reached.
    """
    engine = database_engine(url)
    file = sqlite_file(engine)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
    try:
        with translate_errors(), engine.connect().execution_options(**IMMEDIATE) as connection, connection.begin():
            serialise(connection, Subject.MIGRATION)
            check_upgradable(connection)
            config = _config()
            config.attributes["connection"] = connection
            command.upgrade(config, "head")
    finally:
        engine.dispose()
    return head()


def _config() -> Config:
    config = Config()
    config.set_main_option("script_location", str(SCRIPTS).replace("%", "%%"))
    return config
