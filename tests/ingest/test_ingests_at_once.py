"""Ingests of one vehicle at once: whoever stores windows has seen every recording that was stored before."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest
import sqlalchemy
from vehicle_bus import SECOND_NS, VEHICLE, Run, register

from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkRecord
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from ingest.catalogue import default_catalogue
from ingest.frames import take
from ingest.logs import write_blf
from ingest.receiver import ATTEMPTS_BESIDE_OTHERS, ChunkReceipt, Decoded, Receiver

LENGTH_S = 10.0
WAITING = "SELECT count(*) FROM pg_locks WHERE NOT granted"
PATIENCE_S = 60.0


class CountingClock:
    def __init__(self) -> None:
        self._count = itertools.count(1_800_000_000 * SECOND_NS)

    def now_ns(self) -> int:
        return next(self._count)


class Held(Receiver):
    """Stops in its write transaction, windows stored and nothing committed, until it is let go."""

    def __init__(self, storage: SqlStorage, raw: FileRawStore) -> None:
        super().__init__(storage, raw, default_catalogue(), CountingClock(), window_length_s=LENGTH_S)
        self.stored, self.go_on = threading.Event(), threading.Event()

    def _commit(self, unit: SqlUnitOfWork, made: Decoded) -> tuple[ChunkRecord, int]:
        changed = super()._commit(unit, made)
        self.stored.set()
        assert self.go_on.wait(PATIENCE_S)
        return changed


def halves(folder: Path) -> list[Path]:
    run = Run(seconds=25.0).frames()
    paths = [folder / f"{VEHICLE}__{name}.blf" for name in ("first", "second")]
    for path, part in zip(paths, (slice(0, len(run) // 2), slice(len(run) // 2, None)), strict=True):
        write_blf(path, take(run, part))
    return paths


def contents(storage: SqlStorage) -> dict[tuple[str, int], str]:
    with storage.read() as unit:
        return {(w.wheelset, w.start_ns): w.content_digest for axle in (1, 2) for w in unit.windows.list(f"WS-{axle}")}


def wait_until_blocked(storage: SqlStorage, second: Future[ChunkReceipt]) -> None:
    """Return when the second ingest waits for the first one, or has not waited and is through."""
    if storage.engine.dialect.name == "sqlite":
        time.sleep(0.3)  # nothing shows who waits for a lock file
        return
    until = time.monotonic() + PATIENCE_S
    with storage.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        while not second.done() and not connection.scalar(sqlalchemy.text(WAITING)):
            assert time.monotonic() < until
            time.sleep(0.02)


@pytest.fixture
def other(storage: SqlStorage) -> Iterator[SqlStorage]:
    """Yield the same storage with connections of its own, as another process has them."""
    url = storage.engine.url.render_as_string(hide_password=False)
    opened = SqlStorage(database_engine(url), storage.data_dir)
    yield opened
    opened.close()


@pytest.mark.parametrize("attempts", [0, ATTEMPTS_BESIDE_OTHERS])
def test_a_recording_that_comes_while_its_neighbour_is_stored_is_joined_to_it(
    storage: SqlStorage, other: SqlStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, attempts: int
) -> None:
    monkeypatch.setattr("ingest.receiver.ATTEMPTS_BESIDE_OTHERS", attempts)
    with storage.write() as unit:
        register(unit)
    raw, paths = FileRawStore(tmp_path / "raw"), halves(tmp_path)
    first = Held(storage, raw)
    with ThreadPoolExecutor(2) as pool:
        one = pool.submit(first.receive_file, paths[0], VEHICLE)
        assert first.stored.wait(PATIENCE_S)
        second = Receiver(other, raw, default_catalogue(), CountingClock(), window_length_s=LENGTH_S)
        two = pool.submit(second.receive_file, paths[1], VEHICLE)
        wait_until_blocked(storage, two)
        first.go_on.set()
        states = {one.result(PATIENCE_S).record.state, two.result(PATIENCE_S).record.state}
    assert states == {"decoded"}
    at_once = contents(storage)
    with storage.engine.begin() as connection:
        for table in ("windows", "chunks"):
            connection.execute(sqlalchemy.delete(sqlalchemy.table(table)))
    for path in paths:
        second.receive_file(path, VEHICLE)
    assert at_once == contents(storage)
