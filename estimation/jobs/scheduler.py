"""The one scheduler of a deployment: APScheduler with schedules declared here, nothing kept in it.

What is due is a matter of this process, what was done is in the database: jobs are idempotent, so a schedule needs no
store of its own. One worker runs the jobs one after the other. Runs that were missed while it was busy become one run,
and none is ever dropped for being late.
"""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from threading import Event
from types import FrameType

from apscheduler.events import (
    EVENT_JOB_ERROR,
    EVENT_JOB_MAX_INSTANCES,
    EVENT_JOB_MISSED,
    JobEvent,
)
from apscheduler.executors.pool import ThreadPoolExecutor
from apscheduler.jobstores.memory import MemoryJobStore
from apscheduler.schedulers.background import BackgroundScheduler

from estimation.jobs.job import Job, JobContext, run_job
from estimation.values.runs import JobTrigger

_log = logging.getLogger(__name__)


def serve_jobs(
    context: JobContext,
    jobs: Sequence[Job],
    stop_event: Event,
    *,
    holder: str = "scheduler",
    every_s: Callable[[Job], float] | None = None,
) -> None:
    """Run the jobs on their schedules until ``stop_event`` is set; a job that is running then ends at its next batch.

    Parameters
    ----------
    context
        What the jobs may touch.
    jobs
        What to run, in the order in which one hands its results to the next.
    stop_event
        Set by whoever ends the service, see :func:`stop_on_signals`.
    holder
        Name that the refusal of a second scheduler contains, such as host and process number.
    every_s
        Interval of a job where the deployment sets it apart from the job's default.

    Raises
    ------
    AlreadyRunningError
        Another scheduler is at work on this database.
    """
    with context.storage.scheduler_lock(holder):
        with context.storage.write() as unit:
            abandoned = unit.jobs.abandon_running(context.clock.now_ns())
        if abandoned:
            _log.warning("%d runs of a process that is gone were marked as abandoned", abandoned)
        scheduler = build_scheduler(replace(context, stopping=stop_event.is_set), jobs, every_s or _default_interval)
        scheduler.start()
        _log.info("scheduler started with %s", ", ".join(job.name for job in jobs))
        try:
            stop_event.wait()
        finally:
            stop_event.set()
            scheduler.shutdown(wait=True)
            _log.info("scheduler stopped")


def build_scheduler(context: JobContext, jobs: Sequence[Job], every_s: Callable[[Job], float]) -> BackgroundScheduler:
    """Return a scheduler, not started, that runs every job at once and then at its interval.

    Parameters
    ----------
    context
        What the jobs may touch.
    jobs
        What to run; jobs due at the same time run in this order.
    every_s
        Interval of a job, s.
    """
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
            args=(job, context),
            seconds=every_s(job),
            id=job.name,
            name=job.name,
            next_run_time=first + timedelta(milliseconds=place),  # due together, they go in order
        )
    return scheduler


def stop_on_signals(stop_event: Event) -> None:
    """Set ``stop_event`` on SIGTERM and SIGINT; for the main thread of a service."""

    def stop(_signal: int, _frame: FrameType | None) -> None:
        stop_event.set()

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)


def _default_interval(job: Job) -> float:
    return job.every_s


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
