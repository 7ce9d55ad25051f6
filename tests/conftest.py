"""Storages for tests, on SQLite and on a real PostgreSQL, each with a migrated database; and the command line."""

from __future__ import annotations

import fcntl
import gc
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import no_access_log  # noqa: F401 - before any service is started
import one_thread  # noqa: F401 - must come before whatever loads the linear algebra
import open_access  # noqa: F401 - before any settings are read
import psycopg
import pytest
import same_product  # noqa: F401 - before any process is started
import sqlalchemy
import usual_signals  # noqa: F401 - before any process is started
from hypothesis import HealthCheck, settings
from in_process_command import Run, command_line
from one_database import in_turn
from postgres_server import running_server
from psycopg import sql
from raw_stores import Behind, in_bucket, in_files
from s3_server import S3Server, running_s3_server

from fleet_db.migrate import head, upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from fleet_db.tables import Base

GIVEN = "TREADWATCH_TEST_POSTGRES_URL"

# how long an example takes says how busy the machine is, and what is compiled first
settings.register_profile("any-load", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any-load")


def pytest_collection_finish() -> None:
    """Leave what was collected out of garbage collections: it stays."""
    gc.freeze()


@pytest.fixture
def treadwatch(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Iterator[Run]:
    """Yield the command line, in this process and a folder of the test's own."""
    monkeypatch.chdir(tmp_path)
    with command_line(monkeypatch, capsys) as run:
        yield run


@pytest.fixture
def live_bus() -> Iterator[None]:
    """Keep other test processes off the multicast bus: every group's frames arrive on the one port of all groups."""
    with (Path(tempfile.gettempdir()) / f"treadwatch-test-live-bus-{os.getuid()}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@pytest.fixture(scope="session")
def postgres_server_url() -> Iterator[str]:
    """Yield the server of TREADWATCH_TEST_POSTGRES_URL, whose user must be allowed to create databases, or our own."""
    given = os.environ.get(GIVEN)
    if given:
        yield given
        return
    with running_server() as url:
        yield url


@pytest.fixture(scope="session")
def migrated_postgres_url(postgres_server_url: str) -> Iterator[str]:
    """Yield a migrated database for all tests of this process, one after the other."""
    with new_database(postgres_server_url) as url:
        upgrade(url)
        yield url


@pytest.fixture
def empty_postgres_url(postgres_server_url: str) -> Iterator[str]:
    """Yield an empty database of the test's own."""
    with new_database(postgres_server_url) as url:
        yield url


@pytest.fixture
def postgres_url(migrated_postgres_url: str) -> Iterator[str]:
    """Yield a migrated database that is the test's own until it ends; then it is emptied, whoever is connected."""
    yield migrated_postgres_url
    with psycopg.connect(migrated_postgres_url, autocommit=True) as connection:
        connection.execute(END_SESSIONS)
        connection.execute(EMPTY)
        connection.execute(sql.SQL("UPDATE alembic_version SET version_num = {}").format(head()))


@pytest.fixture(scope="session")
def s3_server() -> Iterator[S3Server]:
    """Yield an S3 server for all tests of this process; each writes below a prefix of its own."""
    with running_s3_server() as server:
        yield server


@pytest.fixture(params=["files", "s3"])
def raw_behind(request: pytest.FixtureRequest, tmp_path: Path) -> Behind:
    """Return an empty store of raw recordings, once of each kind."""
    if request.param == "files":
        return in_files(tmp_path)
    return in_bucket(request.getfixturevalue("s3_server"), uuid.uuid4().hex, tmp_path)


@pytest.fixture(scope="session")
def migrated_sqlite_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a migrated file that others are copied from."""
    file = tmp_path_factory.mktemp("migrated") / "treadwatch.sqlite3"
    upgrade(f"sqlite:///{file}")
    return file


@pytest.fixture
def sqlite_url(migrated_sqlite_file: Path, tmp_path: Path) -> str:
    """Return a migrated file of the test's own."""
    file = tmp_path / "treadwatch.sqlite3"
    shutil.copyfile(migrated_sqlite_file, file)
    return f"sqlite:///{file}"


@pytest.fixture
def sqlite_storage(sqlite_url: str, tmp_path: Path) -> Iterator[SqlStorage]:
    """Yield an empty storage on SQLite."""
    yield from opened(sqlite_url, tmp_path)


@pytest.fixture
def postgres_storage(postgres_url: str, tmp_path: Path) -> Iterator[SqlStorage]:
    """Yield an empty storage on PostgreSQL."""
    yield from opened(postgres_url, tmp_path)


@pytest.fixture(params=["sqlite", "postgresql"])
def storage(request: pytest.FixtureRequest) -> SqlStorage:
    """Return an empty storage, once on each database."""
    name = "sqlite_storage" if request.param == "sqlite" else "postgres_storage"
    found: SqlStorage = request.getfixturevalue(name)
    return found


@pytest.fixture(params=in_turn)
def storage_url(request: pytest.FixtureRequest) -> str:
    """Return the URL of a migrated database, once on each."""
    found: str = request.getfixturevalue("sqlite_url" if request.param == "sqlite" else "postgres_url")
    return found


def opened(url: str, directory: Path) -> Iterator[SqlStorage]:
    """Yield a storage and close it."""
    storage = SqlStorage(database_engine(url), directory / "data")
    yield storage
    storage.close()


END_SESSIONS = """
SELECT pg_terminate_backend(pid) FROM pg_stat_activity
WHERE datname = current_database() AND pid <> pg_backend_pid()
"""
# much faster than another database for each test
TABLES = [table.name for table in Base.metadata.sorted_tables if table.name != "feed_branches"]  # its identity stays
EMPTY = sql.SQL("; ").join(
    [
        *(sql.SQL("DELETE FROM {}").format(sql.Identifier(name)) for name in reversed(TABLES)),
        sql.SQL("SELECT setval(seqrelid, 1, false) FROM pg_sequence"),
    ]
)


@contextmanager
def new_database(server_url: str) -> Iterator[str]:
    """Yield the URL of a new database; dropped at the end, unless the whole server goes anyway."""
    name = f"test_{uuid.uuid4().hex}"
    server = sqlalchemy.make_url(server_url).set(drivername="postgresql")
    address = server.render_as_string(hide_password=False)
    with psycopg.connect(address, autocommit=True) as connection:
        connection.execute(sql.SQL("CREATE DATABASE {}").format(sql.Identifier(name)))
        try:
            yield server.set(database=name).render_as_string(hide_password=False)
        finally:
            if GIVEN in os.environ:
                connection.execute(sql.SQL("DROP DATABASE {} WITH (FORCE)").format(sql.Identifier(name)))
