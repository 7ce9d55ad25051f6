"""A database server that says nothing: given up where it is not there, waited for where it is."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from threading import Timer

import pytest
from postgres_server import PostgresServer, stoppable_server
from sqlalchemy import TextClause, text

from api.factory import open_store
from api.settings import Settings
from estimation.errors import ConflictError, StorageError
from estimation.values.registry import FleetRecord
from fleet_db import session
from fleet_db.migrate import upgrade
from fleet_db.session import ServerLimits, database_engine
from fleet_db.storage import SqlStorage

QUICK = ServerLimits(connect_s=2, silence_s=0.2)


@pytest.fixture(scope="module")
def server() -> Iterator[PostgresServer]:
    with stoppable_server() as server:
        upgrade(server.url)
        yield server


@contextmanager
def opened(server: PostgresServer, limits: ServerLimits, folder: Path) -> Iterator[SqlStorage]:
    storage = SqlStorage(database_engine(server.url, limits), folder)
    try:
        yield storage
    finally:
        storage.close()


def fleets(storage: SqlStorage) -> int | None:
    with storage.read() as unit:
        return unit.connection.scalar(text("SELECT count(*) FROM fleets"))


@pytest.mark.slow
def test_a_frozen_server_is_given_up_and_used_again(server: PostgresServer, tmp_path: Path) -> None:
    with opened(server, QUICK, tmp_path) as storage:
        assert fleets(storage) == 0
        with server.frozen():
            for _ in range(3):  # on the connection there was, and at connecting
                with pytest.raises(StorageError, match=r"silent: no answer for \d+ s|timeout expired"):
                    fleets(storage)
        for _ in range(100):
            with suppress(StorageError):
                fleets(storage)
                break
            time.sleep(0.05)
        assert fleets(storage) == 0


def ended_by_the_server(server: PostgresServer, tmp_path: Path) -> None:
    """End every other connection from the side of the server."""
    with opened(server, QUICK, tmp_path) as other, other.read() as unit:
        unit.connection.execute(
            text(
                "SELECT pg_terminate_backend(pid) FROM pg_stat_activity"
                " WHERE pid <> pg_backend_pid() AND datname = current_database()"
            )
        )


def test_a_connection_that_was_idle_is_asked_before_it_is_used(
    server: PostgresServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with opened(server, QUICK, tmp_path) as storage:
        assert fleets(storage) == 0
        ended_by_the_server(server, tmp_path)
        monkeypatch.setattr(session, "IDLE_S", 0.0)
        assert fleets(storage) == 0  # nobody notices


def test_a_connection_that_answered_a_moment_ago_is_not_asked(server: PostgresServer, tmp_path: Path) -> None:
    with opened(server, QUICK, tmp_path) as storage:
        assert fleets(storage) == 0
        ended_by_the_server(server, tmp_path)
        with pytest.raises(StorageError):
            fleets(storage)
        assert fleets(storage) == 0  # one request fails, the next has a new connection


def add_fleet(storage: SqlStorage, before_commit: Callable[[], object]) -> None:
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        before_commit()


def test_what_was_frozen_at_its_commit_is_reported_and_there_once(server: PostgresServer, tmp_path: Path) -> None:
    with opened(server, QUICK, tmp_path) as storage:
        with ExitStack() as frozen, pytest.raises(StorageError, match="silent"):
            add_fleet(storage, lambda: frozen.enter_context(server.frozen()))
        for _ in range(2):
            with suppress(ConflictError):
                add_fleet(storage, lambda: None)
        assert fleets(storage) == 1


def test_a_slow_statement_is_waited_for_while_the_server_is_there(server: PostgresServer, tmp_path: Path) -> None:
    with opened(server, QUICK, tmp_path) as storage, storage.read() as unit:
        assert unit.connection.scalar(text("SELECT 'done' FROM pg_sleep(0.7)")) == "done"


def test_a_statement_that_takes_too_long_is_ended(server: PostgresServer, tmp_path: Path) -> None:
    limits = ServerLimits(connect_s=2, silence_s=5.0, statement_s=0.2)
    late = text("SELECT pg_sleep(30)")
    with opened(server, limits, tmp_path) as storage, pytest.raises(StorageError, match="statement timeout"):
        execute(storage, late)


def execute(storage: SqlStorage, statement: TextClause) -> None:
    with storage.read() as unit:
        unit.connection.execute(statement)


def test_one_frozen_connection_of_a_server_that_is_there_is_given_up(
    server: PostgresServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "IDLE_S", 0.0)
    limits = ServerLimits(connect_s=2, silence_s=0.2, statement_s=0.5)
    with opened(server, limits, tmp_path) as storage:
        number = own_process(storage)
        thaw = Timer(20.0, os.kill, (number, signal.SIGCONT))
        os.kill(number, signal.SIGSTOP)
        thaw.start()
        try:
            assert own_process(storage) != number  # another connection
            assert thaw.is_alive()
        finally:
            thaw.cancel()
            os.kill(number, signal.SIGCONT)


def own_process(storage: SqlStorage) -> int:
    with storage.read() as unit:
        return int(unit.connection.scalar(text("SELECT pg_backend_pid()")) or 0)


def test_limits_reach_the_driver(server: PostgresServer, tmp_path: Path) -> None:
    settings = Settings(
        data_dir=tmp_path,
        database_url=server.url,
        database_connect_timeout_s=7,
        database_silence_s=8.0,
        database_statement_timeout_s=9.0,
        _env_file=None,
    )
    with closing(open_store(settings)) as storage, storage.read() as unit:
        assert unit.connection.scalar(text("SHOW statement_timeout")) == "9s"
        given = unit.connection.connection.driver_connection.info.get_parameters()
    wanted = {"connect_timeout": "7", "keepalives_idle": "8", "keepalives_interval": "4", "tcp_user_timeout": "16000"}
    assert wanted.items() <= given.items()
