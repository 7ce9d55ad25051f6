"""Bring a database to the head of the migrations."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from sqlalchemy import Connection, Engine, inspect, text

from estimation.errors import MigrationError
from fleet_db.locks import Subject, serialise
from fleet_db.session import IMMEDIATE, database_engine, sqlite_file, translate_errors

SCRIPTS = Path(__file__).parent / "migrations"
TABLE = "alembic_version"
BEFORE_FIRST_RELEASE = re.compile(r"\d{4}")
FROM_BEFORE = (
    "it is from before the first release, and no upgrade leads from there: name a new database, enter the registry and "
    "ingest the recordings again"
)
FROM_LATER = "this version does not know it: run the later one it is of"


def check_head(engine: Engine) -> None:
    """Refuse a database that is not at the head of this version's migrations, with the command to run."""
    file = sqlite_file(engine)
    if file is not None and not file.exists():
        raise MigrationError(None, head())
    with translate_errors(), engine.connect() as connection:
        revision = revision_of(connection)
    if revision != head():
        raise refusal(revision)


def check_upgradable(connection: Connection) -> None:
    """Refuse a database that no upgrade leads from: from before the first release, or of a later version."""
    revision = revision_of(connection)
    if revision is not None and revision not in known_revisions():
        raise refusal(revision)


def refusal(revision: str | None) -> MigrationError:
    """Return the refusal of a database that is not at the head, with what to do about it."""
    if revision is None or revision in known_revisions():
        return MigrationError(revision, head())
    return MigrationError(revision, head(), FROM_BEFORE if BEFORE_FIRST_RELEASE.fullmatch(revision) else FROM_LATER)


def revision_of(connection: Connection) -> str | None:
    """Return the migration a database is at, None where it has none; several as one text, which no version knows."""
    if not inspect(connection).has_table(TABLE):
        return None
    revisions = connection.execute(text(f"SELECT version_num FROM {TABLE}")).scalars()  # noqa: S608 - a constant
    return ", ".join(sorted(map(str, revisions))) or None


def head() -> str:
    """Return the migration that this version needs."""
    return known_revisions()[-1]


@cache
def known_revisions() -> tuple[str, ...]:
    """Return this version's migrations by the numbers of their files; 0001 and so on are from before the first."""
    return tuple(sorted(path.name.partition("_")[0] for path in (SCRIPTS / "versions").glob("r[0-9]*_*.py")))


def upgrade(url: str) -> str:
    """Create the database file if there is none, run every missing migration in one transaction; return the head."""
    from alembic import command  # noqa: PLC0415 - commands that do not migrate start without it
    from alembic.config import Config  # noqa: PLC0415 - the same

    engine = database_engine(url)
    file = sqlite_file(engine)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
    try:
        with translate_errors(), engine.connect().execution_options(**IMMEDIATE) as connection, connection.begin():
            serialise(connection, Subject.MIGRATION)
            check_upgradable(connection)
            config = Config(attributes={"connection": connection})
            config.set_main_option("script_location", str(SCRIPTS).replace("%", "%%"))
            command.upgrade(config, "head")
    finally:
        engine.dispose()
    return head()
