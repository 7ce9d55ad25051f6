"""Data of every older migration come through an upgrade, also through one that was killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
import sqlalchemy
import stored_values as make
from alembic import command
from alembic.config import Config
from full_storage import fill
from stored_raw import raw_of

from estimation.errors import MigrationError
from fleet_db.keeping.deep_check import check_deep
from fleet_db.migrate import upgrade
from fleet_db.revisions import SCRIPTS, check_head, head, known_revisions, revision_of
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

ROOT = Path(__file__).parent.parent.parent
OLDER = known_revisions()[:-1]
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
print(done)
"""


@pytest.fixture
def full(fleet: SqlStorage) -> SqlStorage:
    """Return a storage with one of everything, once on each database."""
    fill(fleet)
    return fleet


@pytest.fixture
def older(empty_postgres_url: str, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[SqlStorage]:
    """Yield an older database with data, once on each kind: brought back from this version."""
    url = empty_postgres_url if request.param[0] == "postgresql" else f"sqlite:///{tmp_path / 'old.sqlite3'}"
    upgrade(url)
    with closing(SqlStorage(database_engine(url), tmp_path / "data")) as storage:
        make.populate(storage)
        fill(storage)
        bring_back(storage, request.param[1])
        yield storage


def bring_back(storage: SqlStorage, revision: str) -> None:
    """Bring a database to an older migration."""
    config = Config()
    config.set_main_option("script_location", str(SCRIPTS))
    with storage.engine.connect() as connection, connection.begin():
        config.attributes["connection"] = connection
        command.downgrade(config, revision)


def address(storage: SqlStorage) -> str:
    return storage.engine.url.render_as_string(hide_password=False)


def check_whole(storage: SqlStorage) -> None:
    """Check that what every migration has had a place for is there, and readable."""
    assert check_deep(storage, raw_of(storage), lambda _done, _total: None).findings == ()
    with storage.read() as unit:
        assert [window.state.value for window in unit.windows.list("WS-1")] == ["estimated"] * 3
        assert make.same(unit.windows.load("WS-1", make.START), make.window())
        assert [table.samples for _, table, _ in unit.tables.stream("WS-1", 0, None)] == [4999, 5000, 5001]
        current = unit.geometries.current("WS-1")
        assert current is not None
        assert make.same(current.geometry, make.geometry())
        assert {alert.kind for alert in unit.alerts.all_open()} >= {make.ALERT.kind}
        assert unit.registry.wheelset("WS-1").mounting == make.MOUNTING
        assert [section.code for section in unit.tracks.sections()] == ["S-7"]
        assert unit.jobs.get(1).job == "refresh_geometry"
        assert len(unit.chunks.overlapping("V-1", make.START, make.START + 1)) == 1


CASES = [("sqlite", revision) for revision in OLDER] + [("postgresql", OLDER[0]), ("postgresql", OLDER[-2])]


@pytest.mark.parametrize("older", CASES, indirect=True, ids=map("-".join, CASES))
def test_data_of_every_older_migration_come_through(older: SqlStorage) -> None:
    with pytest.raises(MigrationError):
        check_head(older.engine)
    assert upgrade(address(older)) == head()
    check_whole(older)


@pytest.mark.parametrize("older", [("sqlite", OLDER[0]), ("postgresql", OLDER[0])], indirect=True)
def test_a_killed_upgrade_changes_nothing(older: SqlStorage) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    killed = 0
    for statement in (4, 20, 45):
        run = [sys.executable, "-c", KILLED_AT, address(older), str(statement)]
        ended = subprocess.run(run, env=environment, check=False, capture_output=True)
        killed += ended.returncode == -signal.SIGKILL
        with older.engine.connect() as connection:
            assert revision_of(connection) == OLDER[0], ended.stderr
        older.engine.dispose()
    assert killed == 3
    assert upgrade(address(older)) == head()
    check_whole(older)


def test_nothing_of_it_is_lost_without_an_upgrade(full: SqlStorage) -> None:
    check_whole(full)
    assert sqlalchemy.inspect(full.engine).has_table("alembic_version")
