"""Jobs over REST: the catalogue, runs, running one now."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from running_service import running

from api.factory import SystemClock, open_store
from api.services import JobRunner
from api.serving import open_services
from api.settings import Settings
from estimation.errors import ConflictError
from estimation.jobs.catalogue import ALL_JOBS
from estimation.jobs.job import Job, JobContext
from estimation.jobs.settings import JobSettings
from estimation.values.runs import JobOutcome, JobTrigger
from fleet_db.storage import SqlStorage


@pytest.fixture
def client(storage_url: str, tmp_path: Path) -> Iterator[httpx.Client]:
    """Yield a client of a service over an empty database of the test's own."""
    settings = Settings(database_url=storage_url, data_dir=tmp_path, port=0, _env_file=None)
    with running(settings) as address, httpx.Client(base_url=address, timeout=30.0) as found:
        yield found


def finished(client: httpx.Client, path: str) -> Mapping[str, object]:
    """Return a run once it has ended."""
    until = time.monotonic() + 30.0
    while time.monotonic() < until:
        run: Mapping[str, object] = client.get(path).json()
        if run["finished_at"] is not None:
            return run
        time.sleep(0.02)
    raise AssertionError(path)


def test_every_job_is_listed_with_its_last_run(client: httpx.Client) -> None:
    jobs = client.get("/v1/jobs").json()["items"]
    assert {job["name"] for job in jobs} == {"assemble_windows", "purge", *(job.name for job in ALL_JOBS)}
    assert all(job["last_run"] is None and job["next_due_at"] is None for job in jobs)
    started = client.post(jobs[0]["links"]["runs"])
    assert started.status_code == 202
    run = finished(client, started.headers["location"])
    assert (run["outcome"], run["trigger"], run["job"]) == ("succeeded", "api", jobs[0]["name"])
    job = client.get(jobs[0]["links"]["self"]).json()
    assert job["last_run"] == run
    assert job["next_due_at"] > run["started_at"]
    assert client.get(jobs[0]["links"]["runs"]).json()["items"] == [run]


def test_a_repeat_under_the_same_key_starts_no_second_run(client: httpx.Client) -> None:
    path, headers = "/v1/jobs/refresh_trends/runs", {"Idempotency-Key": str(uuid.uuid4())}
    first = client.post(path, headers=headers)
    finished(client, first.headers["location"])
    again = client.post(path, headers=headers)
    assert (again.status_code, again.content) == (202, first.content)
    assert again.headers["location"] == first.headers["location"]
    assert len(client.get(path).json()["items"]) == 1
    assert client.post("/v1/jobs/evaluate_alerts/runs", headers=headers).status_code == 422


def test_a_run_that_another_process_has_under_way_is_409(
    client: httpx.Client, storage_url: str, tmp_path: Path
) -> None:
    storage = open_store(Settings(database_url=storage_url, data_dir=tmp_path, _env_file=None))
    with storage.write() as unit:
        run = unit.jobs.start("refresh_trends", JobTrigger.SCHEDULE, 1)[0]
    refused = client.post("/v1/jobs/refresh_trends/runs")
    assert refused.status_code == 409
    assert f"run {run.run_id}" in refused.json()["detail"]
    with storage.write() as unit:
        unit.jobs.finish(run.run_id, JobOutcome.ABANDONED, {}, 2)
    storage.close()
    assert client.post("/v1/jobs/refresh_trends/runs").status_code == 202


@pytest.fixture
def held_runner(storage: SqlStorage) -> Iterator[tuple[JobRunner, Job, threading.Event]]:
    """Yield a runner, and a job that goes on until its event is set."""
    release = threading.Event()

    def work(context: JobContext) -> Mapping[str, int]:
        for done in range(10_000):
            context.checkpoint(done, 10_000)
            if release.wait(0.005):
                break
        return {"done": 1}

    runner = JobRunner(JobContext(storage, SystemClock(), "test", JobSettings()), storage, "test")
    yield runner, Job("held", "Hold on", 60.0, work), release
    release.set()
    runner.close()


def test_one_job_runs_at_a_time(held_runner: tuple[JobRunner, Job, threading.Event], storage: SqlStorage) -> None:
    runner, job, release = held_runner
    run = runner.start(job)
    assert run.outcome == "running"
    for other in (job, Job("other", "Another", 60.0, lambda _: {})):
        with pytest.raises(ConflictError):
            runner.start(other)
    release.set()
    runner.close()
    with storage.read() as unit:
        assert unit.jobs.get(run.run_id).outcome == "succeeded"


def test_closing_stops_a_job_at_its_next_batch(
    held_runner: tuple[JobRunner, Job, threading.Event], storage: SqlStorage
) -> None:
    runner, job, _ = held_runner
    run = runner.start(job)
    runner.close()
    with storage.read() as unit:
        found = unit.jobs.get(run.run_id)
    assert found.outcome == "abandoned"
    assert found.finished_ns is not None


def test_readiness_is_a_problem_where_the_database_is_at_another_migration(sqlite_storage: SqlStorage) -> None:
    from api.routes import health  # noqa: PLC0415 - only here
    from estimation.errors import MigrationError  # noqa: PLC0415 - the same

    def check() -> None:
        raise MigrationError("0000", "0001")

    url = sqlite_storage.engine.url.set(drivername="sqlite").render_as_string()
    settings = Settings(data_dir=sqlite_storage.data_dir, database_url=url, _env_file=None)
    services = replace(open_services(settings), check=check)
    with pytest.raises(MigrationError, match="treadwatch db upgrade"):
        health.get_readiness(services)
    services.close()
