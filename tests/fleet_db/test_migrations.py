"""Migrations lead to exactly the tables that the code knows, on both databases."""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy
import stored_values as make
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine

from estimation.errors import MigrationError, ParameterError, StorageError
from estimation.values.reasons import ReasonCode
from estimation.values.track import AlignmentSource
from fleet_db.migrate import upgrade
from fleet_db.models import Base
from fleet_db.packed_values import pack_alignment
from fleet_db.revisions import SCRIPTS, check_head, head, known_revisions
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

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
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(MigrationError, match="this version does not know it") as caught:
        check_head(engine)
    assert (caught.value.found, caught.value.expected) == ("9999", head())
    with engine.begin() as connection:
        connection.exec_driver_sql("INSERT INTO alembic_version VALUES ('0001')")
    with pytest.raises(MigrationError, match="this version does not know it") as caught:
        check_head(engine)
    assert caught.value.found == "0001, 9999"
    with pytest.raises(MigrationError, match="this version does not know it"):
        upgrade(empty_url)


def test_a_migration_that_fails_leaves_nothing(empty_url: str, engine: Engine) -> None:
    with engine.begin() as connection:  # the last table of the first migration is in the way
        connection.exec_driver_sql("CREATE TABLE window_bin_tables (x INTEGER)")
    with pytest.raises(StorageError, match="the database failed"):
        upgrade(empty_url)
    assert sqlalchemy.inspect(engine).get_table_names() == ["window_bin_tables"]


def test_two_upgrades_at_once(empty_url: str, engine: Engine) -> None:
    code = "import sys; from fleet_db.migrate import upgrade; upgrade(sys.argv[1])"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    both = [subprocess.Popen([sys.executable, "-c", code, empty_url], env=environment) for _ in range(2)]
    assert [one.wait(60) for one in both] == [0, 0]
    check_head(engine)


def test_every_migration_is_a_module_of_the_package() -> None:
    names = [path.name for path in (SCRIPTS / "versions").glob("*.py") if path.name != "__init__.py"]
    assert names
    assert all(re.fullmatch(r"\d{4}_[a-z_]+\.py", name) for name in names)


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


def test_a_database_of_the_first_version_keeps_its_tracks(empty_url: str, engine: Engine) -> None:
    """What it holds of alignments is a recording, in force until the fleet has found something."""
    config = Config()
    config.set_main_option("script_location", str(SCRIPTS))
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "0001")
        connection.exec_driver_sql(
            "INSERT INTO track_sections VALUES ('S-7', 7, 'by the river', '56E1', 0.05, 1.435, 1000.0)"
        )
        packed = pack_alignment(make.alignment(4))
        connection.execute(
            sqlalchemy.text("INSERT INTO track_alignments VALUES ('S-7', 1, 'estimated', 40, :digest, :packed)"),
            {"digest": hashlib.sha256(packed).hexdigest(), "packed": packed},
        )
    assert upgrade(empty_url) == head()
    storage = SqlStorage(engine, Path("unused"))
    with storage.write() as unit:
        assert make.same(unit.tracks.alignment("S-7"), replace(make.alignment(4), version=1))
        record = unit.tracks.in_force("S-7")
        assert record is not None
        assert (record.source, record.same_since, record.gauge_known) == (AlignmentSource.RECORDED, 1, True)
        assert unit.tracks.add_alignment(make.alignment(4)) == 1
        assert unit.tracks.report("S-7") is None


def old_row(connection: sqlalchemy.Connection, table: str, **given: object) -> None:
    """Insert a row as the schema of that time wants it: what is not given is one or an empty text."""
    columns = sqlalchemy.Table(table, sqlalchemy.MetaData(), autoload_with=connection).columns
    least = {int: 1, float: 1.0, str: "", bool: False, bytes: b"", dict: {}}
    values = {column.name: least.get(column.type.python_type) for column in columns if not column.nullable}
    connection.execute(sqlalchemy.insert(columns.values()[0].table).values(**(values | given)))


def test_sentences_of_an_earlier_version_get_codes(empty_url: str, engine: Engine) -> None:
    """A window that was refused for want of an alignment waits again once there is one, however its reason read."""
    config = Config()
    config.set_main_option("script_location", str(SCRIPTS))
    clipped = "12.5% of the samples are clipped, at most 10% may be"
    sentences = ["the alignment of the track section is not known", "somebody's own words", "", clipped]
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "0005")
        old_row(connection, "fleets", code="F")
        old_row(connection, "vehicles", code="V", fleet="F", axles=4)
        old_row(connection, "wheelsets", serial="W", fleet="F")
        old_row(connection, "track_sections", code="S", number=1, rail_profile="60E1")
        for start, sentence in enumerate(sentences):
            state = "refused" if sentence else "pending"
            old_row(connection, "windows", wheelset="W", start_ns=start, vehicle="V", axle=1, track_section="S",
                    length_ns=1, state=state, reason=sentence)  # fmt: skip
    assert upgrade(empty_url) == head()
    with SqlStorage(engine, Path("unused")).write() as unit:
        found = [None if window.reason is None else window.reason.code for window in unit.windows.list("W")]
        assert found == [ReasonCode.ALIGNMENT_UNKNOWN, ReasonCode.OTHER, None, ReasonCode.CLIPPED]
        assert unit.windows.requeue("S", ReasonCode.ALIGNMENT_UNKNOWN) == 1
        assert [window.start_ns for window in unit.windows.ready(10, [])] == [0, 2]


def test_sections_with_windows_of_an_earlier_version_are_known_whether_they_are_on_file_or_not(
    empty_url: str, engine: Engine
) -> None:
    config = Config()
    config.set_main_option("script_location", str(SCRIPTS))
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "0037")
        old_row(connection, "fleets", code="F")
        old_row(connection, "vehicles", code="V", fleet="F", axles=1)
        old_row(connection, "wheelsets", serial="W", fleet="F")
        for number, code in ((1, "S"), (-1, "GONE"), (2, "NEW")):  # -1 is on no bus: the section was voided
            old_row(connection, "track_sections", code=code, number=number, rail_profile="60E1")
        for start, section in enumerate(("S", "S", None, "GONE")):
            old_row(connection, "windows", wheelset="W", start_ns=start, vehicle="V", axle=1, track_section=section,
                    length_ns=1, state="pending", reason="")  # fmt: skip
    assert upgrade(empty_url) == head()
    with SqlStorage(engine, Path("unused")).read() as unit:
        assert unit.section_looks.touched() == {"S": 1, "GONE": 1}


def test_no_trend_of_an_earlier_version_was_recorded_before_the_one_that_it_follows(
    empty_url: str, engine: Engine
) -> None:
    config = Config()
    config.set_main_option("script_location", str(SCRIPTS))
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "0038")
        old_row(connection, "fleets", code="F")
        for serial in ("W", "X"):
            old_row(connection, "wheelsets", serial=serial, fleet="F")
        times = [("W", 10), ("X", 5), ("W", 7), ("W", 9), ("X", 6), ("W", 11)]  # our clock went back at the third
        for number, (serial, recorded_ns) in enumerate(times, start=1):
            old_row(connection, "trends", trend_id=number, wheelset=serial, recorded_ns=recorded_ns, status="invalid")
    assert upgrade(empty_url) == head()
    with engine.connect() as connection:
        found = connection.execute(sqlalchemy.text("SELECT wheelset, recorded_ns FROM trends ORDER BY trend_id")).all()
    assert [tuple(row) for row in found] == [("W", 10), ("X", 5), ("W", 10), ("W", 10), ("X", 6), ("W", 11)]
