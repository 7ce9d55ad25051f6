"""A job as a process of its own, for tests that stop it: python worker_process.py URL DIRECTORY JOB LEASE_S WHERE.

Before every commit of results, or after every reading of inputs, it says so and waits for a line on its input.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from estimation.jobs.catalogue import job_named
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.values.runs import JobTrigger
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage, SqlUnitOfWork


class SystemClock:
    def now_ns(self) -> int:
        return time.time_ns()


def hesitate() -> None:
    print("waits", flush=True)  # noqa: T201 - what the test waits for
    sys.stdin.readline()


@dataclass(frozen=True)
class BeforeCommit(SqlStorage):
    """Waits before every commit under a lease."""

    @contextmanager
    def write(self, *, fenced: bool = True) -> Iterator[SqlUnitOfWork]:
        with super().write(fenced=fenced) as unit:
            yield unit
            if self.lease is not None:
                unit.subjects.flush()
                hesitate()


@dataclass(frozen=True)
class AfterRead(SqlStorage):
    """Waits after every reading under a lease."""

    @contextmanager
    def read(self) -> Iterator[SqlUnitOfWork]:
        with super().read() as unit:
            yield unit
        if self.lease is not None:
            hesitate()


if __name__ == "__main__":
    address, directory, name, lease_s, where = sys.argv[1:]
    kind = {"commit": BeforeCommit, "read": AfterRead}[where]
    storage = kind(database_engine(address), Path(directory))
    context = JobContext(
        storage, SystemClock(), "test", JobSettings(), holder="the stopped one", lease_s=float(lease_s)
    )
    found = run_job(job_named(name), context, JobTrigger.CLI)
    print(found.outcome, dict(found.counts), found.error, flush=True)  # noqa: T201 - the same
