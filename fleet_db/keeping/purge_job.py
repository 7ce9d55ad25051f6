"""Job: what has been kept long enough is deleted, once a day."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from estimation.jobs.job import Job, JobContext
from fleet_db.keeping.purge import purge
from fleet_db.keeping.retention import Retention
from fleet_db.raw import RawStore
from fleet_db.storage import SqlStorage

EVERY_S = 86_400.0


def purge_job(retention: Retention, raw: RawStore, storage_of: Callable[[JobContext], SqlStorage]) -> Job:
    """Return the job."""
    run = partial(_run, retention, raw, storage_of)
    return Job("purge", "Delete what has been kept long enough", every_s=EVERY_S, run=run)


def _run(
    retention: Retention, raw: RawStore, storage_of: Callable[[JobContext], SqlStorage], context: JobContext
) -> Mapping[str, int]:
    done = purge(storage_of(context), raw, retention, context.clock.now_ns(), partial(context.checkpoint, 0, 0))
    return {one.kind.value: one.items for one in done}
