"""The record of every run of a job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, insert, select, update

from estimation.errors import ConflictError, NotFoundError
from estimation.values.runs import JobOutcome, JobRun, JobTrigger
from fleet_db.models import JobRunRow
from fleet_db.rows import table_of

RUNS = table_of(JobRunRow)


@dataclass(frozen=True, slots=True)
class JobRunStore:
    """Implements ``estimation.storage.JobRuns``."""

    connection: Connection

    def start(self, job: str, trigger: JobTrigger, started_ns: int) -> JobRun:
        """Record that a run has begun."""
        statement = insert(RUNS).values(
            job=job,
            trigger=trigger.value,
            started_ns=started_ns,
            finished_ns=None,
            outcome=JobOutcome.RUNNING.value,
            counts={},
            error=None,
        )
        run_id = self.connection.execute(statement.returning(RUNS.c.run_id)).scalar_one()
        return JobRun(run_id, job, trigger, started_ns, None, JobOutcome.RUNNING, {})

    def finish(
        self, run_id: int, outcome: JobOutcome, counts: Mapping[str, int], finished_ns: int, error: str | None = None
    ) -> None:
        """Record how a run ended.

        Raises
        ------
        NotFoundError
            There is no such run.
        ConflictError
            It has ended already (it may have been given up as abandoned).
        """
        result = self.connection.execute(
            update(RUNS)
            .where(RUNS.c.run_id == run_id, RUNS.c.outcome == JobOutcome.RUNNING.value)
            .values(outcome=outcome.value, counts=dict(counts), finished_ns=finished_ns, error=error)
        )
        if result.rowcount == 0:
            ended = self.get(run_id)
            raise ConflictError(
                f"run {run_id} of {ended.job} has ended: {ended.outcome}", kind="job run", key=str(run_id)
            )

    def abandon_running(self, finished_ns: int) -> int:
        """Mark every run that never ended as abandoned; return how many."""
        result = self.connection.execute(
            update(RUNS)
            .where(RUNS.c.outcome == JobOutcome.RUNNING.value)
            .values(
                outcome=JobOutcome.ABANDONED.value, finished_ns=finished_ns, error="the process ended during the run"
            )
        )
        return result.rowcount

    def get(self, run_id: int) -> JobRun:
        """Return one run.

        Raises
        ------
        NotFoundError
            There is no such run.
        """
        row = self.connection.execute(select(RUNS).where(RUNS.c.run_id == run_id)).first()
        if row is None:
            raise NotFoundError("job run", str(run_id))
        return _run(row)

    def page(self, job: str | None, before_id: int | None, limit: int) -> Sequence[JobRun]:
        """Return at most ``limit`` runs with a number below ``before_id``, newest first."""
        statement = select(RUNS)
        if job is not None:
            statement = statement.where(RUNS.c.job == job)
        if before_id is not None:
            statement = statement.where(RUNS.c.run_id < before_id)
        rows = self.connection.execute(statement.order_by(RUNS.c.run_id.desc()).limit(limit))
        return [_run(row) for row in rows]


def _run(row: Row[Any]) -> JobRun:
    enumerations = {"trigger": JobTrigger(row.trigger), "outcome": JobOutcome(row.outcome)}
    return JobRun(**{**row._mapping, **enumerations})  # noqa: SLF001 - SQLAlchemy's public accessor
