"""Migrations lead to exactly the tables that the code knows; a database that they do not lead from is refused."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine

from estimation.errors import MigrationError, ParameterError, StorageError
from fleet_db.migrate import SCRIPTS, check_head, head, known_revisions, upgrade
from fleet_db.session import database_engine
from fleet_db.tables import Base

ROOT = Path(__file__).parent.parent.parent


@pytest.fixture(params=["sqlite", "postgresql"])
def empty_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Return the URL of a database without a table, once on each."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'empty.sqlite3'}"
    url: str = request.getfixturevalue("empty_postgres_url")
    return url


@pytest.fixture
def engine(empty_url: str) -> Iterator[Engine]:
    """Yield an engine on the empty database."""
    engine = database_engine(empty_url)
    yield engine
    engine.dispose()


def index_shape(index: Any) -> str:  # noqa: ANN401 - what the inspector returns
    options = {name: str(value) for name, value in index.get("dialect_options", {}).items()}
    return f"{index['name']} {index['column_names']} {index['unique']} {options}"


def shape(engine: Engine) -> dict[str, Any]:
    """Return all that the database says of its tables, checks included, which Alembic does not compare."""
    inspector = sqlalchemy.inspect(engine)
    found: dict[str, Any] = {}
    for table in set(inspector.get_table_names()) - {"alembic_version"}:
        found[table] = {
            "columns": {
                column["name"]: (repr(column["type"]), column["nullable"]) for column in inspector.get_columns(table)
            },
            "key": inspector.get_pk_constraint(table),
            "foreign": sorted(map(repr, inspector.get_foreign_keys(table))),
            "unique": sorted(map(repr, inspector.get_unique_constraints(table))),
            "indexes": sorted(map(index_shape, inspector.get_indexes(table))),
            "checks": sorted((check["name"], check["sqltext"]) for check in inspector.get_check_constraints(table)),
        }
    return found


def test_the_numbers_of_the_files_are_the_migrations_in_their_order() -> None:
    config = Config()
    config.set_main_option("script_location", str(SCRIPTS))
    scripts = ScriptDirectory.from_config(config)
    assert [script.revision for script in reversed(list(scripts.walk_revisions()))] == list(known_revisions())
    assert scripts.get_current_head() == head()


def test_nothing_is_left_to_change(empty_url: str, engine: Engine) -> None:
    assert upgrade(empty_url) == head()
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "compare_server_default": True})
        assert compare_metadata(context, Base.metadata) == []


def test_migrated_and_created_tables_are_the_same(empty_url: str, engine: Engine) -> None:
    Base.metadata.create_all(engine)
    created = shape(engine)
    Base.metadata.drop_all(engine)
    engine.dispose()
    upgrade(empty_url)
    assert shape(engine) == created
    assert set(created) == set(Base.metadata.tables)
    assert all(table["checks"] for name, table in created.items() if name in ("windows", "alerts", "job_runs"))


def test_upgrading_again_changes_nothing(empty_url: str, engine: Engine) -> None:
    upgrade(empty_url)
    check_head(engine)
    upgrade(empty_url)
    check_head(engine)


def test_a_database_never_migrated_is_refused(empty_url: str, engine: Engine) -> None:
    with pytest.raises(MigrationError, match=r"at migration none, this version needs .* run: treadwatch db upgrade"):
        check_head(engine)
    assert not (empty_url.startswith("sqlite") and Path(str(engine.url.database)).exists())


def test_a_database_of_another_version_is_refused(empty_url: str, engine: Engine) -> None:
    upgrade(empty_url)
    with engine.begin() as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = 'r9999'")
    with pytest.raises(MigrationError, match="this version does not know it") as caught:
        check_head(engine)
    assert (caught.value.found, caught.value.expected) == ("r9999", head())
    with engine.begin() as connection:
        connection.exec_driver_sql("INSERT INTO alembic_version VALUES ('0001')")
    with pytest.raises(MigrationError, match="this version does not know it") as caught:
        check_head(engine)
    assert caught.value.found == "0001, r9999"
    with pytest.raises(MigrationError, match="this version does not know it"):
        upgrade(empty_url)


@pytest.mark.parametrize("found", ["0001", "0029", "0049"])
def test_a_database_from_before_the_first_release_is_refused_and_stays_as_it_is(
    empty_url: str, engine: Engine, found: str
) -> None:
    with engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL PRIMARY KEY)")
        connection.execute(sqlalchemy.text("INSERT INTO alembic_version VALUES (:found)"), {"found": found})
    said = (
        f"the database is at migration {found}, this version needs {head()}; it is from before the first release, and "
        "no upgrade leads from there: name a new database, enter the registry and ingest the recordings again"
    )
    for refuses in (lambda: check_head(engine), lambda: upgrade(empty_url)):
        with pytest.raises(MigrationError) as caught:
            refuses()
        assert str(caught.value) == said
    assert sqlalchemy.inspect(engine).get_table_names() == ["alembic_version"]


def test_a_migration_that_fails_leaves_nothing(empty_url: str, engine: Engine) -> None:
    with engine.begin() as connection:  # a table that comes late is in the way
        connection.exec_driver_sql("CREATE TABLE window_bin_tables (x INTEGER)")
    with pytest.raises(StorageError, match="the database failed"):
        upgrade(empty_url)
    assert sqlalchemy.inspect(engine).get_table_names() == ["window_bin_tables"]


KILLED_AT = """
import os, signal, sys
import sqlalchemy
from fleet_db.migrate import upgrade

url, last = sys.argv[1], int(sys.argv[2])
done = 0

@sqlalchemy.event.listens_for(sqlalchemy.Engine, "after_cursor_execute")
def count(*_):
    global done
    done += 1
    if done == last:
        os.kill(os.getpid(), signal.SIGKILL)

upgrade(url)
"""


def test_an_upgrade_that_is_killed_leaves_nothing(empty_url: str, engine: Engine) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    for statement in (10, 60, 120):
        run = [sys.executable, "-c", KILLED_AT, empty_url, str(statement)]
        ended = subprocess.run(run, env=environment, check=False, capture_output=True)
        assert ended.returncode == -signal.SIGKILL, ended.stderr
        assert sqlalchemy.inspect(engine).get_table_names() == []
        engine.dispose()
    upgrade(empty_url)
    check_head(engine)


def test_two_upgrades_at_once(empty_url: str, engine: Engine) -> None:
    code = "import sys; from fleet_db.migrate import upgrade; upgrade(sys.argv[1])"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    both = [subprocess.Popen([sys.executable, "-c", code, empty_url], env=environment) for _ in range(2)]
    assert [one.wait(60) for one in both] == [0, 0]
    check_head(engine)


def test_every_migration_is_a_module_of_the_package() -> None:
    names = [path.name for path in (SCRIPTS / "versions").glob("*.py") if path.name != "__init__.py"]
    assert names
    assert all(re.fullmatch(r"r\d{4}_[a-z_]+\.py", name) for name in names)


def test_the_directory_of_a_new_file_is_made(tmp_path: Path) -> None:
    file = tmp_path / "a" / "b" / "new.sqlite3"
    upgrade(f"sqlite:///{file}")
    assert file.is_file()


@pytest.mark.parametrize(
    "url",
    [
        "sqlite://",
        "sqlite:///:memory:",
        "sqlite:///relative.sqlite3",
        "sqlite:///",
        "mysql://host/database",
        "no address",
        "",
    ],
)
def test_an_unusable_url_is_refused(url: str) -> None:
    with pytest.raises(ParameterError) as caught:
        database_engine(url)
    assert caught.value.field == "database_url"


def test_sqlite_is_opened_the_careful_way(sqlite_url: str) -> None:
    engine = database_engine(sqlite_url)
    with engine.connect() as connection:
        pragmas = {
            name: connection.exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
        }
    engine.dispose()
    assert pragmas == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1, "busy_timeout": 30_000}
