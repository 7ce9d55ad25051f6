"""The scheduler when its database goes away and comes back, and when another one has taken its place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Event

import pytest
import sqlalchemy
from postgres_server import SAFE, PostgresServer, stoppable_server
from wheelset_life import SetClock

from estimation.errors import AlreadyRunningError, LeaseLostError, StorageError
from estimation.jobs.job import Job, JobContext, run_job
from estimation.jobs.parameters import WORK
from estimation.jobs.scheduler import serve_jobs
from estimation.jobs.settings import JobSettings
from estimation.storage import Storage
from estimation.values.registry import FleetRecord
from estimation.values.runs import JobRun, JobTrigger
from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

PATIENCE_S = 60.0
LONG_S, SHORT_S = 600.0, 0.4
END_LEASE = "UPDATE work_leases SET until_ns = 0 WHERE holder = :holder"


@pytest.fixture(scope="module")
def server() -> Iterator[PostgresServer]:
    with stoppable_server(SAFE) as running:
        upgrade(running.url)
        yield running


@pytest.fixture
def storage(server: PostgresServer, tmp_path: Path) -> Iterator[SqlStorage]:
    opened = SqlStorage(database_engine(server.url), tmp_path)
    with opened.engine.begin() as connection:
        for table in ("job_runs", "work_claims", "work_leases", "fleets"):
            connection.execute(sqlalchemy.delete(sqlalchemy.table(table)))
    yield opened
    opened.close()


class Rounds:
    """A job that writes a fleet a round and says when it has; it goes round until it is stopped."""

    def __init__(self) -> None:
        self.wrote, self.next = Event(), Event()
        self.count = 0
        self.job = Job("rounds", "adds fleets", 3600.0, self._run)

    def _run(self, context: JobContext) -> Mapping[str, int]:
        while True:
            with context.storage.write() as unit:
                unit.registry.add_fleet(FleetRecord(f"F-{self.count}", "x"))
            self.count += 1
            self.wrote.set()
            context.checkpoint(self.count, 1_000_000)
            while not self.next.wait(0.02):
                context.checkpoint(self.count, 1_000_000)
            self.next.clear()


@contextmanager
def scheduling(
    storage: Storage, jobs: Sequence[Job], holder: str, lease_s: float = LONG_S, *, wait: bool = False
) -> Iterator[Future[None]]:
    stop = Event()
    with ThreadPoolExecutor(1) as pool:
        context = JobContext(storage, SetClock(7), "test", JobSettings(), lease_s=lease_s)
        service = pool.submit(serve_jobs, context, jobs, stop, holder=holder, wait=wait)
        try:
            yield service
        finally:
            stop.set()


def end_lease(storage: SqlStorage, holder: str) -> None:
    """Let the time of the leases of a process be over."""
    with storage.engine.begin() as connection:
        connection.execute(sqlalchemy.text(END_LEASE), {"holder": holder})


def runs_of(storage: Storage, job: str) -> Sequence[JobRun]:
    with storage.read() as unit:
        return unit.jobs.page(job, None, 1000)


def wait_for(reached: Event) -> None:
    assert reached.wait(PATIENCE_S)
    reached.clear()


def test_a_scheduler_goes_on_by_itself_when_its_database_has_crashed_and_is_back(
    server: PostgresServer, storage: SqlStorage
) -> None:
    rounds = Rounds()
    with scheduling(storage, [rounds.job], "crashed") as service:
        wait_for(rounds.wrote)
        server.stop()
        rounds.next.set()  # into a transaction without a database
        while storage_is_reached(storage):
            Event().wait(0.02)
        Event().wait(2.0 * WORK.scheduler_check_s)  # until the scheduler has seen it
        server.start()
        wait_for(rounds.wrote)  # the run after the outage
        after, before = runs_of(storage, "rounds")
        assert (before.outcome, after.outcome) == ("abandoned", "running")
        with pytest.raises(AlreadyRunningError, match="crashed"), storage.owned(JobTrigger.SCHEDULE, "second", LONG_S):
            pass
        assert not service.done()
        rounds.next.set()


def storage_is_reached(storage: SqlStorage) -> bool:
    try:
        with storage.read():
            return True
    except StorageError:
        return False


def test_a_scheduler_whose_place_another_one_has_taken_commits_nothing_more(storage: SqlStorage) -> None:
    with storage.owned(JobTrigger.SCHEDULE, "first", LONG_S) as first:
        with first.write() as unit:
            unit.registry.add_fleet(FleetRecord("F-1", "before"))
            run = unit.jobs.start("rounds", JobTrigger.SCHEDULE, 1)[0]
        assert not first.lease_lost()
        with first.leased("a", ["1"], "its worker", LONG_S) as (working, _):
            end_lease(storage, "first")
            assert [found.outcome for found in runs_of(storage, "rounds")] == ["abandoned"]
            with storage.owned(JobTrigger.SCHEDULE, "second", LONG_S) as second:
                assert first.lease_lost()
                assert working.lease_lost()
                for storing in (first, working):
                    with pytest.raises(LeaseLostError, match="has lost its lease"), storing.write() as unit:
                        unit.registry.add_fleet(FleetRecord("F-2", "too late"))
                with second.write() as unit:
                    unit.jobs.abandon_running(3)
                assert not second.lease_lost()
    with storage.read() as unit:
        assert [fleet.code for fleet in unit.registry.fleets()] == ["F-1"]
        assert unit.jobs.get(run.run_id).finished_ns == 3


def test_nobody_takes_over_while_the_one_before_is_committing(storage: SqlStorage) -> None:
    with storage.owned(JobTrigger.SCHEDULE, "first", LONG_S) as first:
        assert first.lease is not None
        with first.write() as unit:
            unit.registry.add_fleet(FleetRecord("F-1", "in time"))
            unit.work_claims.check(first.lease.number, "first")
            end_lease_of = "SET LOCAL lock_timeout = '0'; UPDATE work_leases SET until_ns = 0"
            with storage.engine.begin() as connection:
                connection.execute(sqlalchemy.text(end_lease_of))
            with (
                pytest.raises(AlreadyRunningError, match="first"),
                storage.owned(JobTrigger.SCHEDULE, "second", LONG_S),
            ):
                pass
        with storage.owned(JobTrigger.SCHEDULE, "second", LONG_S), storage.read() as seen:
            assert [fleet.code for fleet in seen.registry.fleets()] == ["F-1"]


def test_a_scheduler_that_finds_another_one_in_its_place_ends_and_names_it(storage: SqlStorage) -> None:
    rounds = Rounds()
    with scheduling(storage, [rounds.job], "first") as service:
        wait_for(rounds.wrote)
        end_lease(storage, "first")
        with storage.owned(JobTrigger.SCHEDULE, "second", LONG_S):
            rounds.next.set()
            with pytest.raises(AlreadyRunningError, match="second"):
                service.result(PATIENCE_S)
    assert [run.outcome for run in runs_of(storage, "rounds")] == ["abandoned"]


def test_a_scheduler_that_stands_by_takes_the_place_of_one_that_is_lost_without_a_word(storage: SqlStorage) -> None:
    rounds = Rounds()
    with storage.write() as unit:  # nobody prolongs it, as when its machine has lost power
        unit.work_claims.take_place(unit.work_claims.lease("lost", round(3e9)))
    with scheduling(storage, [rounds.job], "standby", wait=True) as service:
        assert not rounds.wrote.wait(1.0)
        wait_for(rounds.wrote)
        assert not service.done()


def test_a_run_that_could_not_be_closed_is_closed_by_the_next_of_the_same_process(storage: SqlStorage) -> None:
    with storage.owned(JobTrigger.SCHEDULE, "one", LONG_S) as owned:
        with owned.write() as unit:
            lost = unit.jobs.start("rounds", JobTrigger.SCHEDULE, 1)[0]  # and its end could not be recorded
        context = JobContext(owned, SetClock(7), "test", JobSettings())
        run_job(Job("other", "", 1.0, lambda _context: {}), context, JobTrigger.SCHEDULE)
        with owned.read() as unit:
            assert (unit.jobs.get(lost.run_id).outcome, unit.jobs.get(lost.run_id).finished_ns) == ("abandoned", 7)
