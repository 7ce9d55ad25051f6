"""Transactions: all or nothing, also when the process is killed; one snapshot; many writers; one scheduler."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
import stored_values as make

from bench.put_values import put_geometry
from estimation.errors import AlreadyRunningError, ConflictError, StorageError
from estimation.values.registry import FleetRecord
from estimation.values.runs import JobTrigger
from fleet_db import locks
from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

HERE = Path(__file__).parent
OPEN = """
import sys
from pathlib import Path
import stored_values as make
from bench.put_values import put_geometry
from estimation.values.alerts import AlertEventKind
from estimation.values.registry import FleetRecord
from estimation.values.runs import JobTrigger
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
storage = SqlStorage(database_engine(sys.argv[1]), Path(sys.argv[2]))
"""
WRITE_AND_HANG = """
with storage.write() as unit:
    for index in range(30):
        unit.windows.put(make.window(index), 1.0, 1)
    unit.alerts.save(make.ALERT, [AlertEventKind.RAISED], 1)
    put_geometry(unit, make.geometry_record())
    print("in the middle", flush=True)
    sys.stdin.read()
"""
WRITE_MANY = """
for number in range(25):
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord(f"{sys.argv[3]}-{number}", "x"))
"""
LOCK_AND_HANG = """
with storage.owned(JobTrigger.SCHEDULE, "the first, process 1", 2.0):
    print("locked", flush=True)
    sys.stdin.read()
"""


@contextmanager
def process(code: str, storage: SqlStorage, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run ``code`` with ``storage`` opened in a process of its own."""
    url = storage.engine.url.render_as_string(hide_password=False)
    command = [sys.executable, "-c", OPEN + code, url, str(storage.data_dir), *arguments]
    environment = os.environ | {"PYTHONPATH": f"{HERE}:{HERE.parent.parent}"}
    with subprocess.Popen(
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as running:
        try:
            yield running
        finally:
            running.kill()


def line_of(running: subprocess.Popen[str]) -> str:
    assert running.stdout is not None
    return running.stdout.readline().strip()


def counts(storage: SqlStorage) -> tuple[int, int, int]:
    with storage.read() as unit:
        geometry = unit.geometries.current("WS-1")
        return unit.windows.counts()["pending"], len(unit.alerts.feed(0, 10)), int(geometry is not None)


def test_an_exception_leaves_nothing(fleet: SqlStorage) -> None:
    def write_and_stumble() -> None:
        with fleet.write() as unit:
            unit.windows.put(make.window(), 1.0, 1)
            put_geometry(unit, make.geometry_record())
            raise RuntimeError("on purpose")

    with pytest.raises(RuntimeError, match="on purpose"):
        write_and_stumble()
    assert counts(fleet) == (0, 0, 0)


def test_a_writer_killed_in_the_middle_leaves_nothing_and_blocks_nobody(fleet: SqlStorage) -> None:
    with process(WRITE_AND_HANG, fleet) as running:
        assert line_of(running) == "in the middle"
        assert counts(fleet) == (0, 0, 0)
        running.send_signal(signal.SIGKILL)
        assert running.wait(120) == -signal.SIGKILL
    assert counts(fleet) == (0, 0, 0)
    with fleet.write() as unit:
        assert unit.windows.put(make.window(3), 1.0, 1)
    assert counts(fleet) == (1, 0, 0)


def test_a_reader_sees_one_snapshot(fleet: SqlStorage) -> None:
    with fleet.read() as reader:
        assert len(reader.registry.fleets()) == 1
        with fleet.write() as writer:
            writer.registry.add_fleet(FleetRecord("F-2", "later"))
        assert len(reader.registry.fleets()) == 1
    with fleet.read() as reader:
        assert len(reader.registry.fleets()) == 2


def test_a_reader_cannot_write(fleet: SqlStorage) -> None:
    with pytest.raises(StorageError, match=r"read-?only"), fleet.read() as unit:
        unit.registry.add_fleet(FleetRecord("F-2", "never"))
    with fleet.write() as unit:  # on the same pooled connection
        unit.registry.add_fleet(FleetRecord("F-3", "well"))
    with fleet.read() as unit:
        assert [record.code for record in unit.registry.fleets()] == ["F-1", "F-3"]


@pytest.mark.slow
def test_writers_in_threads_and_processes_all_get_through(fleet: SqlStorage) -> None:
    def write(name: str) -> None:
        for number in range(25):
            with fleet.write() as unit:
                unit.registry.add_fleet(FleetRecord(f"{name}-{number}", "x"))

    with process(WRITE_MANY, fleet, "p1") as first, process(WRITE_MANY, fleet, "p2") as second:
        with ThreadPoolExecutor(3) as pool:
            list(pool.map(write, ["t1", "t2", "t3"]))
        assert (first.wait(60), second.wait(60)) == (0, 0)
    with fleet.read() as unit:
        assert len(unit.registry.fleets()) == 1 + 5 * 25


def test_two_who_store_the_same_window_at_once(fleet: SqlStorage) -> None:
    barrier = threading.Barrier(4)

    def put(_: int) -> list[bool]:
        barrier.wait(120)
        with fleet.write() as unit:
            return [unit.windows.put(make.window(index), 1.0, 1) for index in range(5)]

    with ThreadPoolExecutor(4) as pool:
        new = list(pool.map(put, range(4)))
    assert [sum(column) for column in zip(*new, strict=True)] == [1] * 5


def test_a_constraint_of_the_database_speaks_our_language(fleet: SqlStorage) -> None:
    with pytest.raises(ConflictError, match="the database refused it"), fleet.write() as unit:
        unit.windows.put(make.window(vehicle="V-9"), 1.0, 1)


def test_a_writer_who_waits_too_long_gets_an_error(tmp_path: Path) -> None:
    path = tmp_path / "writer-lock"
    with (
        locks.single_writer(path, 1.0),
        pytest.raises(StorageError, match="another writer"),
        locks.single_writer(path, 0.02),
    ):
        pass
    with locks.single_writer(path, 0.0):
        pass


def test_a_second_scheduler_is_refused(fleet: SqlStorage) -> None:
    with (
        fleet.owned(JobTrigger.SCHEDULE, "scheduler, process 4711", 2.0),
        pytest.raises(AlreadyRunningError, match="scheduler, process 4711"),
        fleet.owned(JobTrigger.SCHEDULE, "another", 2.0),
    ):
        pass
    with fleet.owned(JobTrigger.SCHEDULE, "the next", 2.0):
        pass


@pytest.mark.slow
def test_a_killed_scheduler_lets_the_next_one_in(fleet: SqlStorage) -> None:
    with process(LOCK_AND_HANG, fleet) as running:
        assert line_of(running) == "locked"
        with (
            pytest.raises(AlreadyRunningError, match="the first, process 1"),
            fleet.owned(JobTrigger.SCHEDULE, "second", 2.0),
        ):
            pass
        running.kill()
        running.wait(120)
        for _ in range(200):  # its lease ends by its time
            try:
                with fleet.owned(JobTrigger.SCHEDULE, "second", 2.0):
                    return
            except AlreadyRunningError:
                threading.Event().wait(0.05)
    pytest.fail("the place was never free")


def test_schedulers_of_two_databases_do_not_meet(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'other.sqlite3'}"
    upgrade(url)
    other = SqlStorage(database_engine(url), tmp_path)
    with sqlite_storage.owned(JobTrigger.SCHEDULE, "one", 2.0), other.owned(JobTrigger.SCHEDULE, "two", 2.0):
        pass
    other.close()


def test_a_database_that_cannot_be_reached(tmp_path: Path) -> None:
    for url in (f"postgresql://nobody@/none?host={tmp_path}", f"sqlite:///{tmp_path}/no/such/directory/x.sqlite3"):
        storage = SqlStorage(database_engine(url), tmp_path)
        with pytest.raises(StorageError), storage.read() as unit:
            unit.registry.fleets()
