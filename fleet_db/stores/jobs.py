"""The record of every run of a job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import Connection, Row, insert, or_, select, update

from estimation.errors import ConflictError, NotFoundError
from estimation.values.runs import JobOutcome, JobRun, JobTrigger
from fleet_db.rows import table_of
from fleet_db.stores.work_claims import LEASES, WorkClaimStore, living
from fleet_db.tables import JobRunRow

RUNS = table_of(JobRunRow)
RUNNING = JobOutcome.RUNNING.value
GONE = "the process ended during the run"


@dataclass(frozen=True, slots=True)
class JobRunStore:
    """Implements ``estimation.storage.JobRuns``."""

    connection: Connection
    owner: int | None = None  # lease of the process that starts runs here

    def start(self, job: str, trigger: JobTrigger, started_ns: int) -> JobRun:
        """Record that a run has begun."""
        statement = insert(RUNS).values(
            job=job,
            trigger=trigger.value,
            started_ns=started_ns,
            finished_ns=None,
            outcome=RUNNING,
            counts={},
            error=None,
            owner=self.owner,
        )
        run_id = self.connection.execute(statement.returning(RUNS.c.run_id)).scalar_one()
        return JobRun(run_id, job, trigger, started_ns, None, JobOutcome.RUNNING, {})

    def finish(
        self, run_id: int, outcome: JobOutcome, counts: Mapping[str, int], finished_ns: int, error: str | None = None
    ) -> JobRun:
        """Record how a run ended; return its record.

        Raises:
            NotFoundError: There is no such run.
            ConflictError: It has ended already (it may have been given up as abandoned).
        """
        row = self.connection.execute(
            update(RUNS)
            .where(RUNS.c.run_id == run_id, RUNS.c.outcome == RUNNING)
            .values(outcome=outcome.value, counts=dict(counts), finished_ns=finished_ns, error=error)
            .returning(RUNS)
        ).first()
        if row is None:
            ended = self.get(run_id)
            raise ConflictError(
                f"run {run_id} of {ended.job} has ended: {ended.outcome}", kind="job run", key=str(run_id)
            )
        return _run(row)

    def abandon_running(self, finished_ns: int) -> int:
        """Mark every run as abandoned whose process is gone; return how many."""
        WorkClaimStore(self.connection).end_outdated()
        gone = or_(RUNS.c.owner.is_(None), RUNS.c.owner.not_in(select(LEASES.c.lease_id)))
        statement = update(RUNS).where(RUNS.c.outcome == RUNNING, gone)
        return self.connection.execute(
            statement.values(outcome=JobOutcome.ABANDONED.value, finished_ns=finished_ns, error=GONE)
        ).rowcount

    def get(self, run_id: int) -> JobRun:
        """Return one run; abandoned where its process is gone, or has begun another one: it runs one job at a time.

        Raises:
            NotFoundError: There is no such run.
        """
        row = self.connection.execute(select(RUNS).where(RUNS.c.run_id == run_id)).first()
        if row is None:
            raise NotFoundError("job run", str(run_id))
        return self._runs([row])[0]

    def page(self, job: str | None, before_id: int | None, limit: int) -> Sequence[JobRun]:
        """Return at most ``limit`` runs with a number below ``before_id``, newest first; as :meth:`get`."""
        statement = select(RUNS)
        if job is not None:
            statement = statement.where(RUNS.c.job == job)
        if before_id is not None:
            statement = statement.where(RUNS.c.run_id < before_id)
        return self._runs(self.connection.execute(statement.order_by(RUNS.c.run_id.desc()).limit(limit)).all())

    def _runs(self, rows: Sequence[Row[Any]]) -> list[JobRun]:
        running = {row.run_id: row.owner for row in rows if row.owner is not None and row.outcome == RUNNING}
        if not running:
            return [_run(row) for row in rows]
        owners = living(self.connection, set(running.values()))
        following = _LATER.where(RUNS.c.run_id.in_(running))
        began = {row.run_id: row.started_ns for row in self.connection.execute(following)}
        gone = {number for number, owner in running.items() if owner not in owners or began[number] is not None}
        return [_run(row, gone=row.run_id in gone, finished_ns=began.get(row.run_id)) for row in rows]


LATER = RUNS.alias("later")
_OF_SAME = select(LATER.c.started_ns).where(LATER.c.owner == RUNS.c.owner, LATER.c.run_id > RUNS.c.run_id)
_LATER = select(
    RUNS.c.run_id, _OF_SAME.order_by(LATER.c.run_id).limit(1).correlate(RUNS).scalar_subquery().label("started_ns")
)
"""When the process of a run has begun its next one."""


def _run(row: Row[Any], *, gone: bool = False, finished_ns: int | None = None) -> JobRun:
    fields = {name: value for name, value in row._mapping.items() if name != "owner"}  # noqa: SLF001 - SQLAlchemy's public accessor
    run = JobRun(**{**fields, "trigger": JobTrigger(row.trigger), "outcome": JobOutcome(row.outcome)})
    return replace(run, outcome=JobOutcome.ABANDONED, finished_ns=finished_ns, error=GONE) if gone else run
