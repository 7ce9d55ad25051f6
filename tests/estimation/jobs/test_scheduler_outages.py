"""The scheduler when its database goes away and comes back, and when another one has taken its place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Event

import pytest
import sqlalchemy
from postgres_server import SAFE, PostgresServer, stoppable_server
from wheelset_life import SetClock

from estimation.errors import AlreadyRunningError, ClaimLostError
from estimation.jobs.job import Job, JobContext, run_job
from estimation.jobs.scheduler import serve_jobs
from estimation.jobs.settings import JobSettings
from estimation.storage import Storage
from estimation.values.registry import FleetRecord
from estimation.values.runs import JobRun, JobTrigger
from fleet_db.locks import check_claim
from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

PATIENCE_S = 60.0
END_SESSION = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = :holder"


@pytest.fixture(scope="module")
def server() -> Iterator[PostgresServer]:
    with stoppable_server(SAFE) as running:
        upgrade(running.url)
        yield running


@pytest.fixture
def storage(server: PostgresServer, tmp_path: Path) -> Iterator[SqlStorage]:
    opened = SqlStorage(database_engine(server.url), tmp_path)
    with opened.engine.begin() as connection:
        for table in ("job_runs", "job_owners", "fleets"):
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
def scheduling(storage: Storage, jobs: Sequence[Job], holder: str) -> Iterator[Future[None]]:
    stop = Event()
    with ThreadPoolExecutor(1) as pool:
        context = JobContext(storage, SetClock(7), "test", JobSettings())
        service = pool.submit(serve_jobs, context, jobs, stop, holder=holder)
        try:
            yield service
        finally:
            stop.set()


@contextmanager
def taken_over(storage: SqlStorage, before: str, after: str) -> Iterator[None]:
    """End the session of one scheduler and take its place, before it is back."""
    with ExitStack() as stack:
        for _ in range(100):
            with storage.engine.begin() as connection:
                connection.execute(sqlalchemy.text(END_SESSION), {"holder": before})
            with suppress(AlreadyRunningError):  # its session is still ending, or it was faster
                stack.enter_context(storage.owned(JobTrigger.SCHEDULE, after, 2))
                break
        yield


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
        rounds.next.set()  # into a transaction without a database, or a checkpoint of a scheduler without a lock
        server.start()
        wait_for(rounds.wrote)  # the run after the next start of the scheduler
        after, before = runs_of(storage, "rounds")
        assert (before.outcome, after.outcome) == ("abandoned", "running")
        with pytest.raises(AlreadyRunningError, match="crashed"), storage.owned(JobTrigger.SCHEDULE, "second", 1):
            pass
        assert not service.done()
        rounds.next.set()


def test_a_scheduler_whose_lock_another_one_has_taken_commits_nothing_more(storage: SqlStorage) -> None:
    with storage.owned(JobTrigger.SCHEDULE, "first", 1) as first:
        with first.write() as unit:
            unit.registry.add_fleet(FleetRecord("F-1", "before"))
            run = unit.jobs.start("rounds", JobTrigger.SCHEDULE, 1)
        assert first.holds()
        with storage.engine.begin() as connection:
            connection.execute(sqlalchemy.text(END_SESSION), {"holder": "first"})
        assert not first.holds()
        assert [found.outcome for found in runs_of(storage, "rounds")] == ["abandoned"]
        with storage.owned(JobTrigger.SCHEDULE, "second", 2) as second:
            with pytest.raises(ClaimLostError, match="first has lost its claim"), first.write() as unit:
                unit.registry.add_fleet(FleetRecord("F-2", "too late"))
            with second.write() as unit:
                unit.jobs.abandon_running(3)
            assert second.holds()
    with storage.read() as unit:
        assert [fleet.code for fleet in unit.registry.fleets()] == ["F-1"]
        assert unit.jobs.get(run.run_id).finished_ns == 3


def test_a_take_over_waits_for_what_the_one_before_is_committing(storage: SqlStorage) -> None:
    with storage.owned(JobTrigger.SCHEDULE, "first", 1) as first, ThreadPoolExecutor(1) as pool:
        with first.write() as unit:
            unit.registry.add_fleet(FleetRecord("F-1", "in time"))
            check_claim(unit.connection, first.token, "first")
            with storage.engine.begin() as connection:
                connection.execute(sqlalchemy.text(END_SESSION), {"holder": "first"})

            def take_over() -> list[str]:
                with storage.owned(JobTrigger.SCHEDULE, "second", 2), storage.read() as seen:
                    return [fleet.code for fleet in seen.registry.fleets()]

            second = pool.submit(take_over)
            waiting = "SELECT count(*) FROM pg_locks WHERE NOT granted"
            with storage.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
                while not second.done() and not connection.scalar(sqlalchemy.text(waiting)):
                    Event().wait(0.02)
        assert second.result(PATIENCE_S) == ["F-1"]


def test_a_scheduler_that_finds_another_one_after_an_outage_ends_and_names_it(storage: SqlStorage) -> None:
    rounds = Rounds()
    with scheduling(storage, [rounds.job], "first") as service:
        wait_for(rounds.wrote)
        with taken_over(storage, "first", "second"):
            rounds.next.set()
            with pytest.raises(AlreadyRunningError, match="second"):
                service.result(PATIENCE_S)
    assert [run.outcome for run in runs_of(storage, "rounds")] == ["abandoned"]


def test_a_run_that_could_not_be_closed_is_closed_by_the_next_of_the_same_process(storage: SqlStorage) -> None:
    with storage.owned(JobTrigger.SCHEDULE, "one", 1) as owned:
        with owned.write() as unit:
            lost = unit.jobs.start("rounds", JobTrigger.SCHEDULE, 1)  # and its end could not be recorded
        context = JobContext(owned, SetClock(7), "test", JobSettings())
        run_job(Job("other", "", 1.0, lambda _context: {}), context, JobTrigger.SCHEDULE)
        with owned.read() as unit:
            assert (unit.jobs.get(lost.run_id).outcome, unit.jobs.get(lost.run_id).finished_ns) == ("abandoned", 7)
