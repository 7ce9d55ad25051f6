"""Units of work on the workers of a Dask scheduler: real processes, which are killed; so is the scheduler."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from test_workers import compared, harm, holders
from tiny_fleet import Deployment, results

from api.factory import job_context
from api.workers.on_dask import DaskExecutor
from bench.dask_cluster import DaskCluster, dask_cluster
from estimation.jobs.catalogue import job_named, run_all
from estimation.jobs.job import run_job
from estimation.jobs.settings import EstimationSettings
from estimation.values.runs import JobRun, JobTrigger
from ingest.simulator.fleet import FleetReport

pytestmark = pytest.mark.slow

LEASE_S = 4.0


@pytest.fixture
def cluster(fleet: Deployment, tmp_path: Path) -> Iterator[DaskCluster]:
    with dask_cluster(fleet.settings.model_copy(update={"lease_s": LEASE_S}), tmp_path / "dask", 2) as found:
        yield found


@pytest.fixture
def executor(cluster: DaskCluster) -> Iterator[DaskExecutor]:
    with closing(DaskExecutor(cluster.address)) as found:
        until = time.monotonic() + 90.0
        while found.threads() < 2:
            assert time.monotonic() < until, cluster.log("workers")
            time.sleep(0.1)
        yield found


def run(fleet: Deployment, job: str, executor: DaskExecutor) -> JobRun:
    context = replace(job_context(fleet.settings, fleet.storage), clock=fleet.clock, executor=executor)
    return run_job(job_named(job), context, JobTrigger.CLI)


def test_dask_workers_give_what_one_process_gives(
    fleet: Deployment, second_fleet: Deployment, executor: DaskExecutor, report: FleetReport
) -> None:
    for deployed in (fleet, second_fleet):
        deployed.receive(report.recordings[:2])
    context = replace(job_context(fleet.settings, fleet.storage), clock=fleet.clock, executor=executor)
    runs = {found.job: found for found in run_all(context, JobTrigger.CLI)}
    assert {found.outcome for found in runs.values()} == {"succeeded"}, runs
    with fleet.storage.read() as unit:
        windows = sum(unit.windows.counts().values())
    counts = runs["estimate_windows"].counts
    assert counts["estimated"] + counts["refused"] == windows
    assert "worked_on_elsewhere" not in counts
    second_fleet.run_jobs()
    assert results(fleet.storage) == results(second_fleet.storage)
    other = replace(context.settings, estimation=EstimationSettings(half_life_km=1.0))
    fleet.receive(report.recordings[2:3])
    refused = run_job(job_named("estimate_windows"), replace(context, settings=other), JobTrigger.CLI)
    assert refused.error is not None
    assert "another version or other settings" in refused.error


@pytest.mark.parametrize("storage_url", ["postgresql"], indirect=True)
def test_losing_a_worker_or_the_scheduler_of_dask_loses_and_doubles_nothing(
    fleet: Deployment, second_fleet: Deployment, cluster: DaskCluster, executor: DaskExecutor, report: FleetReport
) -> None:
    for deployed in (fleet, second_fleet):
        deployed.receive(report.recordings[:3])
    assert run(fleet, "refresh_alignment", executor).outcome == "succeeded"
    harmed = threading.Thread(target=harm, args=(fleet.storage, (signal.SIGKILL,)))
    harmed.start()
    first = run(fleet, "estimate_windows", executor)
    harmed.join()
    assert first.outcome == "succeeded", first
    fleet.receive(report.recordings[3:4])
    second_fleet.receive(report.recordings[3:4])
    losing = threading.Thread(target=lose_scheduler, args=(fleet, cluster))
    losing.start()
    lost = run(fleet, "estimate_windows", executor)
    losing.join()
    assert lost.outcome == "failed", lost
    assert lost.error is not None
    assert "Dask" in lost.error
    cluster.start_scheduler()
    time.sleep(LEASE_S + 1.0)  # until what was begun is free
    until = time.monotonic() + 90.0
    while run(fleet, "estimate_windows", executor).outcome != "succeeded":
        assert time.monotonic() < until, cluster.log("workers")
    compared(fleet, second_fleet)


def lose_scheduler(fleet: Deployment, cluster: DaskCluster) -> None:
    """Kill the scheduler while a worker holds a claim."""
    until = time.monotonic() + 60.0
    while not [pid for pid in holders(fleet.storage) if pid != os.getpid()]:
        assert time.monotonic() < until
        time.sleep(0.02)
    cluster.kill("scheduler")
