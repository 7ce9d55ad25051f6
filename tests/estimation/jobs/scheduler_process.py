"""A scheduler as a process of its own, for tests that kill it: python scheduler_process.py URL DIRECTORY.

Its one job adds fleets in batches of two, each batch in one transaction, for as long as it is left alone. It prints a
line for every batch that it has committed, and one when it is in the middle of the next.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from threading import Event

from api.terminal.stopping import stop_on_signals
from estimation.errors import AlreadyRunningError
from estimation.jobs.job import Job, JobContext
from estimation.jobs.scheduler import serve_jobs
from estimation.jobs.settings import JobSettings
from estimation.values.registry import FleetRecord
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage


class SystemClock:
    def now_ns(self) -> int:
        return time.time_ns()


def add_pairs(context: JobContext) -> Mapping[str, int]:
    for batch in range(1_000_000):
        with context.storage.write() as unit:
            unit.registry.add_fleet(FleetRecord(f"{batch:06}a", "first of a pair"))
            print("half", batch, flush=True)  # noqa: T201 - what the test waits for
            time.sleep(0.02)
            unit.registry.add_fleet(FleetRecord(f"{batch:06}b", "second of a pair"))
        print("whole", batch, flush=True)  # noqa: T201 - the same
        context.checkpoint(batch + 1, 1_000_000)
    return {}


def main(url: str, directory: str) -> int:
    storage = SqlStorage(database_engine(url), Path(directory))
    stop = Event()
    stop_on_signals(stop)
    job = Job("add_pairs", "adds pairs of fleets", 3600.0, add_pairs)
    try:
        serve_jobs(
            JobContext(storage, SystemClock(), "test", JobSettings(), lease_s=2.0),
            [job],
            stop,
            holder="first of the test",
        )
    except AlreadyRunningError as error:
        print(error, flush=True)  # noqa: T201 - what the test waits for
        return 3
    finally:
        storage.close()
    print("stopped", flush=True)  # noqa: T201 - the same
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
