"""One run of a job and its record, whatever becomes of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest
from wheelset_life import SetClock

from estimation.errors import InputError, NotFoundError
from estimation.jobs.catalogue import ALL_JOBS, job_named, run_all
from estimation.jobs.job import Job, JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.storage import Storage
from estimation.values.registry import FleetRecord
from estimation.values.runs import JobTrigger


def context_of(storage: Storage, stopping: Callable[[], bool] | None = None) -> JobContext:
    return JobContext(storage, SetClock(100), "test", JobSettings(), stopping=stopping)


def ticking(context: JobContext) -> Mapping[str, int]:
    assert isinstance(context.clock, SetClock)
    for i in range(3):
        context.clock.at_ns += 10
        with context.storage.write() as unit:
            unit.registry.add_fleet(FleetRecord(f"F{i}", "a fleet"))
        context.checkpoint(i + 1, 3)
    return {"fleets": 3}


def fleets(storage: Storage) -> list[str]:
    with storage.read() as unit:
        return [fleet.code for fleet in unit.registry.fleets()]


def test_a_run_is_recorded_with_times_counts_and_progress(storage: Storage) -> None:
    seen: list[tuple[int, int]] = []
    context = JobContext(
        storage, SetClock(100), "test", JobSettings(), progress=lambda done, total: seen.append((done, total))
    )
    run = run_job(Job("tick", "", 1.0, ticking), context, JobTrigger.CLI)
    assert (run.outcome, run.counts, run.error) == ("succeeded", {"fleets": 3}, None)
    assert (run.trigger, run.started_ns, run.finished_ns) == ("cli", 100, 130)
    assert seen == [(1, 3), (2, 3), (3, 3)]
    with storage.read() as unit:
        assert unit.jobs.page("tick", None, 10) == [run]


def test_a_run_is_visible_while_it_runs(storage: Storage) -> None:
    def look(context: JobContext) -> Mapping[str, int]:
        with context.storage.read() as unit:
            assert [run.outcome for run in unit.jobs.page("look", None, 10)] == ["running"]
        return {}

    assert run_job(Job("look", "", 1.0, look), context_of(storage), JobTrigger.API).outcome == "succeeded"


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (InputError("is wrong", file="a.toml", field="x"), "a.toml, field 'x': is wrong"),
        (ZeroDivisionError("division by zero\nwith detail"), "ZeroDivisionError: division by zero"),
    ],
)
def test_a_failure_is_in_the_record_without_a_trace(storage: Storage, error: Exception, message: str) -> None:
    def fail(context: JobContext) -> Mapping[str, int]:
        context.checkpoint(2, 5)
        with context.storage.write() as unit:
            unit.registry.add_fleet(FleetRecord("half", "rolled back"))
            raise error

    run = run_job(Job("fail", "", 1.0, fail), context_of(storage), JobTrigger.API)
    assert (run.outcome, run.error, run.counts) == ("failed", message, {"done": 2, "total": 5})
    assert fleets(storage) == []


def test_a_stop_ends_a_run_between_batches_and_keeps_what_was_done(storage: Storage) -> None:
    run = run_job(Job("tick", "", 1.0, ticking), context_of(storage, lambda: len(fleets(storage)) >= 2), JobTrigger.CLI)
    assert (run.outcome, run.counts) == ("abandoned", {"done": 2, "total": 3})
    assert run.error == "stopped on request after 2 of 3"
    assert fleets(storage) == ["F0", "F1"]
    assert run_job(Job("tick", "", 1.0, ticking), context_of(storage), JobTrigger.CLI).outcome == "succeeded"
    assert fleets(storage) == ["F0", "F1", "F2"]


def test_a_run_that_was_given_up_meanwhile_stays_given_up(sqlite_storage: Storage) -> None:
    def given_up(context: JobContext) -> Mapping[str, int]:
        with context.storage.write() as unit:
            assert unit.jobs.abandon_running(150) == 1
        return {}

    run = run_job(Job("late", "", 1.0, given_up), context_of(sqlite_storage), JobTrigger.API)
    assert (run.outcome, run.finished_ns) == ("abandoned", 150)


def test_the_catalogue_names_every_job_in_its_order(storage: Storage) -> None:
    names = [job.name for job in ALL_JOBS]
    assert names == [
        "refresh_alignment",
        "estimate_windows",
        "refresh_geometry",
        "refresh_adhesion",
        "refresh_fleet",
        "refresh_trends",
        "evaluate_alerts",
        "refresh_rails",
        "refresh_signatures",
    ]
    assert job_named("refresh_trends") is ALL_JOBS[5]
    with pytest.raises(NotFoundError, match="no job 'nothing'"):
        job_named("nothing")
    runs = run_all(context_of(storage), JobTrigger.CLI)
    assert [(run.job, run.outcome) for run in runs] == [(name, "succeeded") for name in names]


def test_a_failed_job_does_not_keep_later_ones_from_their_work(sqlite_storage: Storage) -> None:
    def fail(_context: JobContext) -> Mapping[str, int]:
        raise InputError("no")

    jobs = (Job("fail", "", 1.0, fail), Job("tick", "", 1.0, ticking))
    assert [run.outcome for run in run_all(context_of(sqlite_storage), JobTrigger.CLI, jobs)] == ["failed", "succeeded"]
    assert len(run_all(context_of(sqlite_storage, lambda: True), JobTrigger.CLI, jobs)) == 1
