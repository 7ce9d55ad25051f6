"""Units of work in other processes: killed, stopped and woken, given up; the result is the one of a single process."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import select
from tiny_fleet import DEAD, WORN, Deployment, results

from api.pipeline import job_context
from api.workers.pool import ProcessPool
from estimation.jobs.catalogue import job_named, run_all
from estimation.jobs.job import JobContext, WorkExecutor, run_job
from estimation.jobs.settings import JobSettings
from estimation.values.reasons import ReasonCode
from estimation.values.runs import JobRun, JobTrigger, SubjectKind
from estimation.values.windows import WindowState
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.operation import WorkClaimRow, WorkLeaseRow
from ingest.simulator.fleet import FleetReport

SCRIPT = Path(__file__).with_name("worker_process.py")
CLAIMS, LEASES = table_of(WorkClaimRow), table_of(WorkLeaseRow)
LEASE_S = 2.0
ESTIMATED = ("refresh_alignment", "estimate_windows", "refresh_geometry")


def pool(fleet: Deployment, lease_s: float = 20.0, limit_s: float = 600.0) -> ProcessPool:
    chosen = {"lease_s": lease_s, "unit_limit_s": limit_s, "shutdown_timeout_s": 60}
    return ProcessPool(fleet.settings.model_copy(update=chosen), 2)


def run(fleet: Deployment, job: str, executor: WorkExecutor | None = None) -> JobRun:
    context = replace(job_context(fleet.settings, fleet.storage), clock=fleet.clock, executor=executor)
    return run_job(job_named(job), context, JobTrigger.CLI)


def compared(fleet: Deployment, second: Deployment) -> None:
    """Let a fleet come to rest in this process, and compare it with one that never knew another."""
    for deployed in (fleet, second):
        deployed.run_jobs()
    assert results(fleet.storage) == results(second.storage)
    with fleet.storage.read() as unit:
        assert unit.connection.execute(select(LEASES)).all() == []


def test_worker_processes_give_what_one_process_gives_and_nothing_is_done_twice(
    fleet: Deployment, second_fleet: Deployment, report: FleetReport
) -> None:
    for deployed in (fleet, second_fleet):
        deployed.receive(report.recordings[:3])
    with pool(fleet) as workers:
        context = replace(job_context(fleet.settings, fleet.storage), clock=fleet.clock, executor=workers)
        runs = {found.job: found for found in run_all(context, JobTrigger.CLI)}
        assert {found.outcome for found in runs.values()} == {"succeeded"}, runs
        assert len(workers.pids()) == 2
    with fleet.storage.read() as unit:
        windows = sum(unit.windows.counts().values())
    counts = runs["estimate_windows"].counts
    assert counts["estimated"] + counts["refused"] == windows
    assert "worked_on_elsewhere" not in counts
    assert runs["refresh_geometry"].counts["wheelsets"] == 2
    second_fleet.run_jobs()
    assert results(fleet.storage) == results(second_fleet.storage)
    assert workers.replaced == 0


@pytest.mark.slow
def test_a_worker_that_is_killed_or_stands_still_is_replaced_and_its_work_done_again(
    fleet: Deployment, second_fleet: Deployment, report: FleetReport
) -> None:
    for deployed in (fleet, second_fleet):
        deployed.receive(report.recordings[:3])
    with pool(fleet, limit_s=15.0) as workers:
        harmed = threading.Thread(target=harm, args=(fleet.storage, (signal.SIGKILL, signal.SIGSTOP)))
        harmed.start()
        runs = [run(fleet, job, workers) for job in ESTIMATED]
        harmed.join()
        assert [found.outcome for found in runs] == ["succeeded"] * 3, runs
        assert workers.replaced >= 2
    compared(fleet, second_fleet)


@pytest.mark.slow
@pytest.mark.parametrize("storage_url", ["postgresql"], indirect=True)
def test_workers_that_stood_still_with_their_machine_go_on(
    fleet: Deployment, second_fleet: Deployment, report: FleetReport
) -> None:
    for deployed in (fleet, second_fleet):
        deployed.receive(report.recordings[:3])
    with pool(fleet, lease_s=LEASE_S) as workers:
        suspended = threading.Thread(target=suspend, args=(fleet.storage, workers))
        suspended.start()
        runs = [run(fleet, job, workers) for job in ESTIMATED]
        suspended.join()
        assert [found.outcome for found in runs] == ["succeeded"] * 3, runs
        assert workers.replaced == 0
    compared(fleet, second_fleet)


@pytest.mark.slow
def test_what_ends_three_workers_is_set_aside_and_the_others_go_on(fleet: Deployment, report: FleetReport) -> None:
    fleet.receive(report.recordings[:2])
    with fleet.storage.read() as unit:
        victim = unit.windows.list(WORN)[0]
    key, over = f"{WORN}@{victim.start_ns}", threading.Event()
    with pool(fleet) as workers, that_nobody_can_read(fleet, victim.content_digest):
        murderer = threading.Thread(target=kill_whoever_has, args=(fleet.storage, key, over))
        murderer.start()
        found = run(fleet, "estimate_windows", workers)
        over.set()
        murderer.join()
    assert (found.outcome, workers.replaced) == ("succeeded", 3)
    assert (found.counts["set_aside"], found.counts["quarantined"]) == (1, 1)
    with fleet.storage.read() as unit:
        (held,) = unit.quarantine.held("estimate_windows")
        refused = unit.windows.get(WORN, victim.start_ns)
        others = [w for serial in (WORN, DEAD) for w in unit.windows.list(serial) if w != refused]
    assert (held.kind, held.key, held.code) == (SubjectKind.WINDOW, key, ReasonCode.WORKERS_ENDED)
    assert held.error == "3 worker processes ended while they worked at it"
    assert refused is not None
    assert refused.reason is not None
    assert (refused.state, refused.reason.code) == (WindowState.REFUSED, ReasonCode.WORKERS_ENDED)
    assert WindowState.PENDING not in {one.state for one in others}
    fleet.clock.at_ns = held.due_ns + 1
    assert run(fleet, "estimate_windows").counts["estimated"] == 1
    with fleet.storage.read() as unit:
        assert unit.quarantine.held("estimate_windows") == []


@pytest.mark.slow
@pytest.mark.parametrize("job", ["estimate_windows", "refresh_geometry"])
@pytest.mark.parametrize("where", ["read", "commit"])
def test_a_worker_that_was_stopped_for_longer_than_its_lease_stores_nothing_when_it_wakes(
    fleet: Deployment, second_fleet: Deployment, storage_url: str, report: FleetReport, job: str, where: str
) -> None:
    if where == "commit" and storage_url.startswith("sqlite"):
        pytest.skip("whoever stops in a transaction of SQLite keeps the file")
    for deployed in (fleet, second_fleet):
        deployed.receive(report.recordings[:2])
        if job == "refresh_geometry":
            alone(deployed, "estimate_windows")
    command = [sys.executable, str(SCRIPT), storage_url, str(fleet.settings.data_dir), job, "2.0", where]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as stopped:  # type: ignore[call-overload]
        assert stopped.stdout.readline() == "waits\n"
        os.kill(stopped.pid, signal.SIGSTOP)
        time.sleep(2.5)
        taken = alone(fleet, job)
        before = results(fleet.storage)
        os.kill(stopped.pid, signal.SIGCONT)
        said = stopped.communicate("\n" * 1000)[0].splitlines()[-1]
    # it notices when it commits; or it sees, where it reads what is due only now, that another has done everything; or
    # the server has ended its transaction, which was idle for longer than the lease
    nothing_due = (job, where) == ("refresh_geometry", "read") and "'wheelsets': 0" in said
    ended = where == "commit" and said.startswith("failed") and "idle-in-transaction timeout" in said
    assert ended or (said.startswith("succeeded") and ("'leases_lost': 1" in said or nothing_due)), said
    assert taken.counts.get("estimated", taken.counts.get("wheelsets")) > 0
    assert "worked_on_elsewhere" not in taken.counts
    assert results(fleet.storage) == before
    alone(second_fleet, job)
    assert results(second_fleet.storage) == before


def alone(fleet: Deployment, job: str) -> JobRun:
    context = JobContext(fleet.storage, fleet.clock, "test", JobSettings())
    found = run_job(job_named(job), context, JobTrigger.CLI)
    assert found.outcome == "succeeded", found
    return found


def holders(storage: SqlStorage, key: str | None = None) -> list[int]:
    """Return the processes that hold a claim, on one thing or on any."""
    chosen = select(LEASES.c.holder).join(CLAIMS, CLAIMS.c.lease_id == LEASES.c.lease_id)
    with storage.read() as unit:
        found = unit.connection.scalars(chosen if key is None else chosen.where(CLAIMS.c.key == key)).all()
    return [int(match[1]) for holder in set(found) if (match := re.search(r"process (\d+)(, Dask)?$", holder))]


def harm(storage: SqlStorage, signals: tuple[signal.Signals, ...]) -> None:
    """Send signals to workers that hold claims, each to another one."""
    harmed: set[int] = set()
    for number in signals:
        until = time.monotonic() + 120.0
        while not (found := [pid for pid in holders(storage) if pid not in harmed and pid != os.getpid()]):
            assert time.monotonic() < until
            time.sleep(0.02)
        os.kill(found[0], number)
        harmed.add(found[0])


def suspend(storage: SqlStorage, workers: ProcessPool) -> None:
    """Stop this process and its workers for longer than a lease once one is at work, and wake them, us first."""
    until = time.monotonic() + 120.0
    while not [pid for pid in holders(storage) if pid != os.getpid()]:
        assert time.monotonic() < until
        time.sleep(0.02)
    others = " ".join(map(str, workers.pids()))
    script = f"kill -STOP {others} {os.getpid()}; sleep {2 * LEASE_S}; kill -CONT {os.getpid()}; sleep 0.5"
    subprocess.run(["sh", "-c", f"{script}; kill -CONT {others}"], check=True)


@contextmanager
def that_nobody_can_read(fleet: Deployment, digest: str) -> Iterator[None]:
    """Let whoever reads a window stand still: it is killed there, however slow this machine is."""
    (path,) = fleet.settings.data_dir.rglob(f"{digest}.window")
    content = path.read_bytes()
    path.unlink()
    os.mkfifo(path)
    try:
        yield
    finally:
        path.unlink()
        path.write_bytes(content)


def kill_whoever_has(storage: SqlStorage, key: str, over: threading.Event) -> None:
    killed: set[int] = set()
    while not over.wait(0.02):
        for pid in holders(storage, key):
            if pid not in killed and pid != os.getpid() and len(killed) < 3:
                os.kill(pid, signal.SIGKILL)
                killed.add(pid)
