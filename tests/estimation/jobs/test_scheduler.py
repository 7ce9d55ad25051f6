"""The scheduler as it runs: killed, stopped, refused, late. Real processes, real APScheduler, no assertion on time."""

from __future__ import annotations

import logging
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Event, Semaphore, Thread

import pytest
from wheelset_life import SetClock

from estimation.errors import AlreadyRunningError, StorageError
from estimation.jobs.job import Job, JobContext
from estimation.jobs.scheduler import build_scheduler, clock_was_set, serve_jobs
from estimation.jobs.settings import JobSettings
from estimation.storage import Storage, UnitOfWork
from estimation.values.runs import JobRun, JobTrigger
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

PATIENCE_S = 60.0
SCRIPT = Path(__file__).with_name("scheduler_process.py")


@contextmanager
def scheduler_process(url: str, directory: Path) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [sys.executable, str(SCRIPT), url, str(directory)],
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def lines_until(process: subprocess.Popen[str], wanted: str) -> list[str]:
    assert process.stdout is not None
    seen = []
    for line in process.stdout:
        seen.append(line.strip())
        if seen[-1] == wanted:
            return seen
    raise AssertionError(f"{wanted!r} never came: {seen}")


@contextmanager
def serving(
    storage: Storage, jobs: Sequence[Job], interval_s: float = 3600.0, clock: SetClock | None = None
) -> Iterator[Event]:
    """Run a scheduler in a thread; what it raised is raised at the end."""
    stop, raised = Event(), list[BaseException]()

    def serve() -> None:
        try:
            context = JobContext(storage, clock or SetClock(7), "test", JobSettings())
            serve_jobs(context, [replace(one, every_s=interval_s) for one in jobs], stop)
        except BaseException as error:  # noqa: BLE001 - handed to the test's own thread
            raised.append(error)

    thread = Thread(target=serve)
    thread.start()
    try:
        yield stop
    finally:
        stop.set()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()
    for error in raised:
        raise error


def runs_of(storage: Storage, job: str) -> Sequence[JobRun]:
    with storage.read() as unit:
        return unit.jobs.page(job, None, 1000)


def fleets(storage: Storage) -> list[str]:
    with storage.read() as unit:
        return [fleet.code for fleet in unit.registry.fleets()]


def job(name: str, work: Callable[[], None]) -> Job:
    def run(_context: JobContext) -> Mapping[str, int]:
        work()
        return {"worked": 1}

    return Job(name, "", 3600.0, run)


def test_a_killed_job_leaves_nothing_half_written_and_is_abandoned_at_the_next_start(
    storage_url: str, tmp_path: Path
) -> None:
    with scheduler_process(storage_url, tmp_path) as process:
        lines_until(process, "half 3")  # in the middle of the fourth batch
        process.send_signal(signal.SIGKILL)
        assert process.wait(PATIENCE_S) == -signal.SIGKILL
    storage = SqlStorage(database_engine(storage_url), tmp_path)
    whole = [name for batch in range(3) for name in (f"{batch:06}a", f"{batch:06}b")]
    assert fleets(storage) in (whole, [*whole, "000003a", "000003b"])  # it may have been quicker than the signal
    until = time.monotonic() + PATIENCE_S
    while [run.outcome for run in runs_of(storage, "add_pairs")] == ["running"] and time.monotonic() < until:
        Event().wait(0.05)  # for as long as its lease lasts
    shown = [(run.outcome, run.finished_ns, run.error) for run in runs_of(storage, "add_pairs")]
    assert shown == [("abandoned", None, "the process ended during the run")]
    done = Event()
    with serving(storage, [job("other", done.set)]):  # and the dead process's place is free
        assert done.wait(PATIENCE_S)
    (run,) = runs_of(storage, "add_pairs")
    assert (run.outcome, run.finished_ns) == ("abandoned", 7)
    storage.close()


def test_sigterm_ends_a_job_at_its_next_batch(sqlite_url: str, tmp_path: Path) -> None:
    with scheduler_process(sqlite_url, tmp_path) as process:
        lines_until(process, "half 2")
        process.send_signal(signal.SIGTERM)
        lines_until(process, "stopped")
        assert process.wait(PATIENCE_S) == 0
    storage = SqlStorage(database_engine(sqlite_url), tmp_path)
    (run,) = runs_of(storage, "add_pairs")
    assert run.outcome == "abandoned"
    assert run.error is not None
    assert "stopped on request" in run.error
    names = fleets(storage)
    assert len(names) == 2 * run.counts["done"]
    storage.close()


@pytest.mark.slow
def test_a_second_scheduler_is_refused_with_the_name_of_the_first(storage_url: str, tmp_path: Path) -> None:
    with scheduler_process(storage_url, tmp_path) as first:
        lines_until(first, "half 0")
        with scheduler_process(storage_url, tmp_path) as second:
            output, _ = second.communicate(timeout=PATIENCE_S)
            assert second.returncode == 3
        assert "already running" in output
        assert "first of the test" in output
        assert first.poll() is None
        storage = SqlStorage(database_engine(storage_url), tmp_path)
        with pytest.raises(AlreadyRunningError), serving(storage, []):
            pass
        assert [run.outcome for run in runs_of(storage, "add_pairs")] == ["running"]  # not abandoned by the refused
        storage.close()


def test_a_hundred_missed_runs_become_one_and_none_is_dropped_for_being_late(sqlite_storage: Storage) -> None:
    worked = Event()
    late = job("late", worked.set)
    context = JobContext(sqlite_storage, SetClock(7), "test", JobSettings())
    scheduler = build_scheduler(context, [replace(late, every_s=3600.0)])
    scheduler.start(paused=True)
    scheduler.modify_job("late", next_run_time=datetime.now(UTC) - timedelta(hours=100, minutes=30))
    scheduler.resume()
    assert worked.wait(PATIENCE_S)
    scheduler.shutdown(wait=True)
    (run,) = runs_of(sqlite_storage, "late")
    assert (run.outcome, run.trigger) == ("succeeded", "schedule")


@pytest.mark.parametrize("ahead_s", [-3600.0, 400 * 86_400.0])
def test_jobs_are_due_again_when_the_clock_of_the_server_is_set(sqlite_storage: Storage, ahead_s: float) -> None:
    clock, worked = SetClock(1_700_000_000_000_000_000), Semaphore(0)
    with serving(sqlite_storage, [job("hourly", worked.release)], clock=clock):
        assert worked.acquire(timeout=PATIENCE_S)
        while [run.outcome for run in runs_of(sqlite_storage, "hourly")] in ([], ["running"]):  # that waits
            Event().wait(0.05)
        clock.at_ns += round(ahead_s * 1e9)
        assert worked.acquire(timeout=PATIENCE_S)


@pytest.mark.parametrize(("passed_s", "found"), [(30.9, False), (31.1, True), (-28.9, False), (-29.1, True)])
def test_a_clock_was_set_when_it_goes_by_30_s_more_or_less_than_the_interval(passed_s: float, *, found: bool) -> None:
    assert clock_was_set(round(passed_s * 1e9)) is found


def test_a_job_that_is_due_again_while_it_runs_waits_for_itself(sqlite_storage: Storage) -> None:
    at_once, most, count, enough = list[int](), list[int](), list[int](), Event()

    def work() -> None:
        at_once.append(1)
        most.append(len(at_once))
        Event().wait(0.05)  # five intervals long
        at_once.pop()
        count.append(1)
        if len(count) >= 3:
            enough.set()

    with serving(sqlite_storage, [job("busy", work)], interval_s=0.01):
        assert enough.wait(PATIENCE_S)
    assert max(most) == 1


def test_jobs_due_together_run_in_their_order_and_a_failed_one_does_not_end_the_scheduler(
    sqlite_storage: Storage,
) -> None:
    order: list[str] = []
    done = Event()

    def fail() -> None:
        order.append("first")
        raise StorageError("no")

    def last() -> None:
        order.append("third")
        done.set()

    jobs = [job("c", fail), job("b", lambda: order.append("second")), job("a", last)]
    with serving(sqlite_storage, jobs):
        assert done.wait(PATIENCE_S)
    assert order == ["first", "second", "third"]
    (run,) = runs_of(sqlite_storage, "c")
    assert (run.outcome, run.error) == ("failed", "no")


@dataclass(slots=True)
class FailsOnce:
    """The real storage, but one transaction cannot be had."""

    real: Storage
    fails_at: int
    asked: int = 0

    def write(self, *, fenced: bool = True) -> AbstractContextManager[UnitOfWork]:
        self.asked += 1
        if self.asked == self.fails_at:
            raise StorageError("the database cannot be reached")
        return self.real.write(fenced=fenced)

    def read(self) -> AbstractContextManager[UnitOfWork]:
        return self.real.read()

    @contextmanager
    def owned(self, kind: JobTrigger, holder: str, length_s: float) -> Iterator[Storage]:
        with self.real.owned(kind, holder, length_s) as owned:
            yield FailsOnce(owned, self.fails_at)

    def lease_lost(self) -> bool:
        return False


def test_a_run_that_cannot_be_recorded_is_logged_and_the_next_one_runs(
    sqlite_storage: SqlStorage, caplog: pytest.LogCaptureFixture
) -> None:
    done = Event()
    # the first transaction marks abandoned runs, the second begins the first run
    storage = FailsOnce(sqlite_storage, fails_at=2)
    with caplog.at_level(logging.WARNING), serving(storage, [job("unlucky", lambda: None), job("good", done.set)]):
        assert done.wait(PATIENCE_S)
    assert [run.outcome for run in runs_of(sqlite_storage, "good")] == ["succeeded"]
    assert runs_of(sqlite_storage, "unlucky") == []
    assert "job unlucky could not be recorded: the database cannot be reached" in caplog.text
