"""A job as a process of its own, for tests that kill it: python job_process.py URL DIRECTORY JOB.

It commits as little at a time as it can, and before every commit it says so and waits, so that a kill hits a
transaction with everything written and nothing committed.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from estimation.jobs.catalogue import job_named
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.settings import EstimationSettings, JobSettings
from estimation.values.runs import JobTrigger
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage, SqlUnitOfWork

LEASE_S = 2.0


class SystemClock:
    def now_ns(self) -> int:
        return time.time_ns()


@dataclass(frozen=True)
class Hesitant(SqlStorage):
    """Waits before every commit."""

    @contextmanager
    def write(self, *, fenced: bool = True) -> Iterator[SqlUnitOfWork]:
        with super().write(fenced=fenced) as unit:
            yield unit
            if threading.current_thread() is not threading.main_thread():
                return  # the lease is prolonged as time passes, which is none of the job's commits
            unit.subjects.flush()
            print("not committed", flush=True)  # noqa: T201 - what the test waits for
            time.sleep(0.3)


if __name__ == "__main__":
    address, directory, name = sys.argv[1:]
    storage = Hesitant(database_engine(address), Path(directory))
    settings = JobSettings(estimation=EstimationSettings(batch=1))
    run_job(job_named(name), JobContext(storage, SystemClock(), "test", settings, lease_s=LEASE_S), JobTrigger.CLI)
