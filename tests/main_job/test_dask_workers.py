"""Units of work on the workers of a Dask scheduler: real processes, which are killed; so is the scheduler."""

from __future__ import annotations

import os
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from test_workers import compared, harm, holders
from tiny_fleet import Deployment, results

from api.pipeline import job_context
from api.workers.on_dask import DaskExecutor
from bench.services import DaskCluster, dask_cluster
from estimation.jobs.catalogue import job_named, run_all
from estimation.jobs.job import run_job
from estimation.values.runs import JobRun, JobTrigger
from fleet_db.migrate import upgrade
from ingest.simulator.fleet import FleetReport

pytestmark = pytest.mark.slow

LEASE_S = 4.0


@pytest.fixture
def cluster(fleet: Deployment, tmp_path: Path) -> Iterator[DaskCluster]:
    with dask_cluster(fleet.settings.model_copy(update={"lease_s": LEASE_S}), tmp_path / "dask", 2) as found:
        yield found


@pytest.fixture
def executor(fleet: Deployment, cluster: DaskCluster) -> Iterator[DaskExecutor]:
    with DaskExecutor(fleet.settings.model_copy(update={"dask_scheduler": cluster.address})) as found:
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


def unfit(fleet: Deployment, folder: Path) -> dict[str, tuple[dict[str, str], str]]:
    """Return environments of workers that are not of a deployment, and what is said of each."""
    other_version, other_folder, other_database = (folder / name for name in ("version", "folder", "database"))
    other_version.mkdir(parents=True)
    code = "import estimation.numerics_version\nestimation.numerics_version.NUMERICS_VERSION = 'another'\n"
    (other_version / "sitecustomize.py").write_text(code)
    for data in (other_folder, folder / "gone"):
        (data / "windows").mkdir(parents=True)
    url = f"sqlite:///{other_database}.sqlite3"
    upgrade(url)
    here = {"TREADWATCH_DATABASE_URL": fleet.settings.url}  # where it would be in the data folder
    path = os.pathsep.join([str(other_version), os.environ.get("PYTHONPATH", "")])
    return {
        "version": ({"PYTHONPATH": path}, "has another version or other settings"),
        "folder": ({"TREADWATCH_DATA_DIR": str(folder / "gone"), **here}, str(folder / "gone" / "windows")),
        "windows": ({"TREADWATCH_DATA_DIR": str(other_folder), **here}, "does not see the files"),
        "database": ({"TREADWATCH_DATABASE_URL": url}, "works with another database"),
    }


def test_workers_that_are_not_of_the_deployment_are_named_and_the_others_do_the_work(
    fleet: Deployment,
    second_fleet: Deployment,
    cluster: DaskCluster,
    executor: DaskExecutor,
    report: FleetReport,
    tmp_path: Path,
) -> None:
    for deployed in (fleet, second_fleet):
        deployed.receive(report.recordings[:1])
    others = unfit(fleet, tmp_path / "others")
    for name, (environment, _) in others.items():
        cluster.start_workers(1, name, **environment)
    until = time.monotonic() + 240.0
    while "Start Nanny" not in cluster.log("folder"):  # its folder goes after its start, before it is greeted
        assert time.monotonic() < until, cluster.log("folder")
        time.sleep(0.05)
    shutil.rmtree(tmp_path / "others" / "gone")
    while len(executor.unfit) < len(others):
        executor.look()
        assert time.monotonic() < until, [cluster.log(name) for name in others]
        time.sleep(0.1)
    said = "; ".join(executor.unfit)
    for _, why in others.values():
        assert why in said
    done = run(fleet, "estimate_windows", executor)
    assert (done.outcome, done.counts["unfit_workers"]) == ("succeeded", 4)
    assert done.counts["estimated"] > 0
    assert "leases_lost" not in done.counts
    compared(fleet, second_fleet)


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
    assert "worked_on_elsewhere" not in first.counts  # what the lost worker had claimed was free at once
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
