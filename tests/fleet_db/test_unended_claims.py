"""What a worker has claimed when the database goes away: free as soon as that is back, and not counted against it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import psycopg
import pytest
from postgres_server import SAFE, PostgresServer, stoppable_server

from estimation.errors import StorageError
from estimation.values.runs import MOST_ENDED, Claimed
from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

LONG_S, SHORT_S = 600.0, 0.4


@pytest.fixture(scope="module")
def migrated() -> Iterator[PostgresServer]:
    with stoppable_server(SAFE) as server:
        upgrade(server.url)
        yield server


@pytest.fixture
def server(migrated: PostgresServer) -> PostgresServer:
    """Return the server without claims of other tests."""
    with psycopg.connect(migrated.url) as connection:
        connection.execute("DELETE FROM work_claims")
        connection.execute("DELETE FROM work_leases")
    return migrated


@contextmanager
def opened(server: PostgresServer, folder: Path) -> Iterator[SqlStorage]:
    with closing(SqlStorage(database_engine(server.url), folder)) as storage:
        yield storage


def reached(storage: SqlStorage) -> None:
    """Wait until a process that has lost its database asks again."""
    until = time.monotonic() + 30.0
    while time.monotonic() < until:
        with suppress(StorageError), storage.read():
            return
        time.sleep(0.05)
    raise AssertionError("the database does not come back")


def away_while_it_works(
    server: PostgresServer, storage: SqlStorage, length_s: float, *, alone: bool = False
) -> Claimed:
    """Claim two things, lose the database before that ends, and bring it back; return what was claimed."""
    with storage.leased("a", ["1", "2"], "worker", length_s, alone=alone) as (_, claimed):
        server.stop()
    server.start()
    return claimed


def test_what_was_claimed_is_free_once_the_database_is_back(server: PostgresServer, tmp_path: Path) -> None:
    with opened(server, tmp_path) as storage:
        for _ in range(2):
            assert away_while_it_works(server, storage, LONG_S).keys == ("1", "2")
            reached(storage)
        with (
            storage.leased("b", ["1"], "worker", LONG_S),
            opened(server, tmp_path) as other,
            other.leased("a", ["1", "2"], "other", LONG_S) as (_, claimed),
        ):
            assert (claimed.keys, claimed.elsewhere) == (("1", "2"), 0)


def test_outages_do_not_count_as_workers_that_ended(server: PostgresServer, tmp_path: Path) -> None:
    with opened(server, tmp_path) as storage:
        for _ in range(MOST_ENDED):
            assert away_while_it_works(server, storage, SHORT_S).keys == ("1", "2")
            time.sleep(SHORT_S)
            with opened(server, tmp_path) as other, other.leased("b", ["1"], "other", LONG_S):
                pass  # what has ended by its time is free now
            reached(storage)
    with opened(server, tmp_path) as restarted, restarted.leased("a", ["1", "2"], "worker", LONG_S) as (_, claimed):
        assert (claimed.keys, claimed.ended) == ((), (("1", 1), ("2", 1)))  # only what is not ended yet


def test_that_workers_have_ended_at_a_thing_is_not_forgotten_in_an_outage(
    server: PostgresServer, tmp_path: Path
) -> None:
    with opened(server, tmp_path) as storage:
        with storage.write() as unit:
            gone = unit.work_claims.lease("gone", 10**15, unit="7")
            unit.work_claims.take(gone, "a", ["1"])
            unit.work_claims.end(unit.work_claims.lease("whoever begins it again", 10**15, unit="7"))
        assert away_while_it_works(server, storage, LONG_S, alone=True).keys == ("1", "2")
        reached(storage)
        with storage.leased("a", ["1", "2"], "worker", LONG_S) as (_, claimed):
            assert (claimed.keys, claimed.ended) == (("2",), (("1", 1),))


def test_what_another_has_begun_since_is_left_to_it(server: PostgresServer, tmp_path: Path) -> None:
    with opened(server, tmp_path) as storage, opened(server, tmp_path) as other:
        assert away_while_it_works(server, storage, SHORT_S).keys == ("1", "2")
        time.sleep(SHORT_S)
        with other.leased("a", ["1", "2"], "other", LONG_S, alone=True) as (_, taken):
            assert taken.keys == ("1", "2")
            reached(storage)
            with storage.leased("a", ["1", "2"], "worker", LONG_S, alone=True) as (_, claimed):
                assert (claimed.keys, claimed.elsewhere) == ((), 2)
