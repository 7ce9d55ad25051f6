"""All stages and all jobs, in the order in which one hands its results to the next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from estimation.errors import NotFoundError
from estimation.jobs import (
    estimate_windows,
    evaluate_alerts,
    refresh_adhesion,
    refresh_alignment,
    refresh_fleet,
    refresh_geometry,
    refresh_rails,
    refresh_signatures,
    refresh_trends,
)
from estimation.jobs.compare_identities import IDENTITIES, JUMPS, SUSPENSIONS
from estimation.jobs.estimate_windows import JUDGE, OUTDATED, TABLES
from estimation.jobs.evaluate_alerts import ALERTS, WORKLIST
from estimation.jobs.job import Job, JobContext, Work, run_job
from estimation.jobs.refresh_adhesion import FIRST, OF_SECTIONS, OF_VEHICLES
from estimation.jobs.refresh_adhesion import OF_WINDOWS as CREEP
from estimation.jobs.refresh_alignment import ALIGNMENT
from estimation.jobs.refresh_fleet import OF_ALL as FLEETS
from estimation.jobs.refresh_fleet import OF_WHEELSETS as WEARS
from estimation.jobs.refresh_geometry import GEOMETRY
from estimation.jobs.refresh_rails import OF_ALL as RAILS
from estimation.jobs.refresh_rails import OF_WHEELSETS as CELLS
from estimation.jobs.refresh_signatures import OF_ALL as ANSWERS
from estimation.jobs.refresh_trends import TREND
from estimation.jobs.runner import work_of
from estimation.jobs.stage import AnyStage
from estimation.jobs.steps.signature_windows import ASSUMED, OF_WINDOWS
from estimation.values.runs import JobRun, JobTrigger

ALL_STAGES: tuple[AnyStage, ...] = (
    ALIGNMENT,
    JUDGE,
    OUTDATED,
    TABLES,
    GEOMETRY,
    FIRST,
    CREEP,
    OF_VEHICLES,
    OF_SECTIONS,
    WEARS,
    FLEETS,
    TREND,
    JUMPS,
    IDENTITIES,
    SUSPENSIONS,
    ALERTS,
    WORKLIST,
    CELLS,
    RAILS,
    ASSUMED,
    OF_WINDOWS,
    ANSWERS,
)


ALL_JOBS: tuple[Job, ...] = (
    refresh_alignment.JOB,
    estimate_windows.JOB,
    refresh_geometry.JOB,
    refresh_adhesion.JOB,
    refresh_fleet.JOB,
    refresh_trends.JOB,
    evaluate_alerts.JOB,
    refresh_rails.JOB,
    refresh_signatures.JOB,
)

T = TypeVar("T", Job, Work)
STAGES = tuple(map(work_of, ALL_STAGES))
"""Work that is done in units, by other processes where there are some."""


def stage_named(name: str) -> Work:
    """Return the stage of a name; raises NotFoundError."""
    return _named(STAGES, "stage", name)


def job_named(name: str) -> Job:
    """Return the job of a name; raises NotFoundError."""
    return _named(ALL_JOBS, "job", name)


def _named(all_of_kind: Sequence[T], kind: str, name: str) -> T:
    for item in all_of_kind:
        if item.name == name:
            return item
    raise NotFoundError(kind, name)


def run_all(context: JobContext, trigger: JobTrigger, jobs: Sequence[Job] = ALL_JOBS) -> list[JobRun]:
    """Run the jobs one after the other, until ``context.stopping``, and return their records.

    A failed job does not keep the later ones from their work: each works on what is stored.
    """
    runs = []
    for job in jobs:
        runs.append(run_job(job, context, trigger))
        if context.stopping is not None and context.stopping():
            break
    return runs
