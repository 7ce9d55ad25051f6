"""Jobs that must succeed, and what a process asks of its databases meanwhile.

Apart from ``measuring``, for a process whose memory is measured imports nothing else.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from sqlalchemy import event
from sqlalchemy.engine import Engine

from estimation.errors import TreadwatchError
from estimation.jobs.catalogue import ALL_JOBS
from estimation.jobs.job import Job, JobContext, run_job
from estimation.values.runs import JobRun, JobTrigger
from fleet_db.storage import SqlStorage, SqlUnitOfWork


@dataclass(slots=True)
class Asked:
    """What a process asks of its databases: statements, transactions that write, and the time that those take."""

    statements: int = 0
    writes: int = 0
    writing_s: float = 0.0


@contextmanager
def asked() -> Iterator[Asked]:
    """Count while the block lasts; ``BEGIN``, which SQLite is sent and PostgreSQL is not, is not counted."""
    found, write = Asked(), SqlStorage.write

    def count(_connection: object, _cursor: object, statement: str, *_: object) -> None:
        found.statements += not statement.startswith("BEGIN")

    @contextmanager
    def timed(self: SqlStorage, **terms: bool) -> Iterator[SqlUnitOfWork]:
        begin_s = time.perf_counter()
        with write(self, **terms) as unit:
            yield unit
        found.writes += 1
        found.writing_s += time.perf_counter() - begin_s

    event.listen(Engine, "before_cursor_execute", count)
    SqlStorage.write = timed  # type: ignore[method-assign]
    try:
        yield found
    finally:
        SqlStorage.write = write  # type: ignore[method-assign]
        event.remove(Engine, "before_cursor_execute", count)


def run_all(context: JobContext) -> Counter[str]:
    """Run all jobs, which must succeed; return their counts together."""
    counts: Counter[str] = Counter()
    for job in ALL_JOBS:
        counts.update(run(job, context).counts)
    return counts


def run(job: Job, context: JobContext) -> JobRun:
    """Run a job, which must succeed."""
    done = run_job(job, context, JobTrigger.CLI)
    if done.error is not None:
        raise TreadwatchError(f"{done.job}: {done.error}")
    return done
