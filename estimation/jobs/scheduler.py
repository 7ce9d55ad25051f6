"""The one scheduler of a deployment: APScheduler with schedules declared here, nothing kept in it.

What is due is a matter of this process, what was done is in the database: jobs are idempotent, so a schedule needs no
store of its own. One worker runs the jobs one after the other. Runs that were missed while it was busy become one run,
and none is ever dropped for being late.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from threading import Event

from apscheduler.events import EVENT_JOB_ERROR, EVENT_JOB_MAX_INSTANCES, EVENT_JOB_MISSED, JobEvent
from apscheduler.executors.pool import ThreadPoolExecutor
from apscheduler.jobstores.memory import MemoryJobStore
from apscheduler.schedulers.background import BackgroundScheduler

from estimation.errors import AlreadyRunningError, StorageError
from estimation.jobs.job import Job, JobContext, run_job
from estimation.jobs.parameters import WORK
from estimation.storage import Storage
from estimation.values.runs import JobTrigger

_log = logging.getLogger(__name__)


def serve_jobs(
    context: JobContext,
    jobs: Sequence[Job],
    stop_event: Event,
    *,
    holder: str = "scheduler",
    wait: bool = False,
) -> None:
    """Run the jobs on their schedules until ``stop_event`` is set; a job that is running then ends at its next batch.

    Args:
        stop_event: Set by whoever ends the service, as SIGTERM does.
        holder: Name that the refusal of a second scheduler contains, such as host and process number.
        wait: Stand by while another scheduler is at work, and take its place when it has ended.

    Raises:
        AlreadyRunningError: Another scheduler is at work on this database, at the start or later.
        StorageError: The database cannot be reached at the start. Later the scheduler waits for it.
    """
    begun, before = False, ""
    lease_s = min(context.lease_s, WORK.scheduler_lease_s)
    while not stop_event.is_set():
        try:
            with context.storage.owned(JobTrigger.SCHEDULE, holder, lease_s) as owned:
                begun, before = True, ""
                _serve_while_owned(replace(context, storage=owned), jobs, stop_event)
        except AlreadyRunningError as error:
            if not wait:
                raise
            if before != error.holder:
                _log.info("standing by: %s", error)
            begun, before = True, error.holder
        except StorageError as error:
            if not begun:
                raise
            _log.warning("the scheduler waits for the database: %s", error)
        stop_event.wait(WORK.scheduler_check_s)


def _serve_while_owned(context: JobContext, jobs: Sequence[Job], stop_event: Event) -> None:
    """Run the jobs until a stop is asked for or the place is lost; then the running job ends at its next batch."""
    with context.storage.write() as unit:
        abandoned = unit.jobs.abandon_running(context.clock.now_ns())
    if abandoned:
        _log.warning("%d runs of a process that is gone were marked as abandoned", abandoned)
    over = Event()
    scheduler = build_scheduler(replace(context, stopping=over.is_set), jobs)
    looked_ns = context.clock.now_ns()  # before the first job: the clock may be set while it runs
    scheduler.start()
    _log.info("scheduler started with %s", ", ".join(job.name for job in jobs))
    kept: bool | None = True
    try:
        while kept is not False and not stop_event.wait(WORK.scheduler_check_s):
            before_ns, looked_ns = looked_ns, context.clock.now_ns()
            was_kept, kept = kept, _kept(context.storage)
            if clock_was_set(looked_ns - before_ns):
                _log.warning("the clock went by %g s in a second: all jobs are due now", (looked_ns - before_ns) / 1e9)
                _make_due(scheduler, jobs)
            elif kept and was_kept is None:
                _log.info("the database is back: all jobs are due now")
                _make_due(scheduler, jobs)
        if kept is False:
            _log.warning("the scheduler has lost its place: it stood still, and another may have taken over")
    finally:
        over.set()
        scheduler.shutdown(wait=True)
        _log.info("scheduler stopped")


def _kept(owned: Storage) -> bool | None:
    """Return whether the scheduler keeps its place; None while the database is away, which takes it from nobody."""
    try:
        return not owned.lease_lost()
    except StorageError as error:
        _log.warning("the scheduler waits for the database: %s", error)
        return None


def clock_was_set(passed_ns: int) -> bool:
    """Return whether somebody set the clock, or this process stood still, by what passed between two looks of it."""
    return abs(passed_ns - WORK.scheduler_check_s * 1e9) > WORK.clock_step_ns


def _make_due(scheduler: BackgroundScheduler, jobs: Sequence[Job]) -> None:
    """Let all jobs be due now, in their order: what was due by a clock that was ahead might never come."""
    first = datetime.now(UTC)
    for place, job in enumerate(jobs):
        scheduler.modify_job(job.name, next_run_time=first + timedelta(milliseconds=place))


def build_scheduler(context: JobContext, jobs: Sequence[Job]) -> BackgroundScheduler:
    """Return a scheduler, not started, that runs every job at once and then at its interval."""
    scheduler = BackgroundScheduler(
        jobstores={"default": MemoryJobStore()},
        executors={"default": ThreadPoolExecutor(1)},
        job_defaults={"misfire_grace_time": None, "coalesce": True, "max_instances": 1},
        timezone=UTC,
    )
    scheduler.add_listener(_report, EVENT_JOB_MISSED | EVENT_JOB_ERROR | EVENT_JOB_MAX_INSTANCES)
    first = datetime.now(UTC)
    for place, job in enumerate(jobs):
        scheduler.add_job(
            _scheduled,
            "interval",
            args=(job, replace(context, quiet_s=job.every_s)),  # until a run finds nothing new
            seconds=job.every_s,
            id=job.name,
            name=job.name,
            next_run_time=first + timedelta(milliseconds=place),  # due together, they go in order
        )
    return scheduler


def _scheduled(job: Job, context: JobContext) -> None:
    if context.stopping is None or not context.stopping():
        run_job(job, context, JobTrigger.SCHEDULE)


def _report(event: JobEvent) -> None:
    if event.code == EVENT_JOB_ERROR:
        _log.error("job %s could not be recorded: %s", event.job_id, getattr(event, "exception", ""))
    elif event.code == EVENT_JOB_MISSED:
        _log.warning("a run of job %s was missed", event.job_id)
    else:
        _log.info("job %s is still running; its next run waits", event.job_id)
