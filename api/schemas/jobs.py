"""Jobs and their runs."""

from __future__ import annotations

from pydantic import Field

from api.schemas.common import Links, Representation
from api.schemas.derived import Derived
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.values.runs import JobRun as JobRunValue


class JobRun(
    Derived, of=JobRunValue, columns="id job trigger started_at finished_at duration_s outcome counts error links"
):
    """One run of one job and what it did; `finished_at` is null while it runs."""

    duration_s: float | None
    links: Links


class Job(Representation):
    """A scheduled job with its last run; `next_due_at` is when the schedule is due; it needs a running scheduler."""

    name: str = Field(examples=["estimate_windows"])
    description: str
    every_s: float
    last_run: JobRun | None
    next_due_at: Timestamp | None = Field(description="Null before the first run.")
    links: Links


def run(record: JobRunValue) -> JobRun:
    """Return the representation of a run."""
    finished = record.finished_ns
    return JobRun.made(
        record,
        duration_s=None if finished is None else max(0, finished - record.started_ns) / 1e9,
        links={"self": f"/v1/job-runs/{record.run_id}", "job_runs": f"/v1/jobs/{segment(record.job)}/runs"},
    )


def job(name: str, description: str, every_s: float, last: JobRunValue | None) -> Job:
    """Return the representation of a job."""
    due = None if last is None else to_rfc3339(last.started_ns + int(every_s * 1e9))
    return Job(
        name=name,
        description=description,
        every_s=every_s,
        last_run=None if last is None else run(last),
        next_due_at=due,
        links={"self": f"/v1/jobs/{segment(name)}", "runs": f"/v1/jobs/{segment(name)}/runs"},
    )
