"""Which executor a deployment has."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from api.settings import Settings
from api.workers.on_dask import DaskExecutor
from api.workers.pool import ProcessPool
from estimation.jobs.job import WorkExecutor


@contextmanager
def executor_of(settings: Settings) -> Iterator[WorkExecutor | None]:
    """Yield what does the units of work of this deployment: None for this process itself."""
    if settings.dask_scheduler is None and settings.worker_count == 1:
        yield None
        return
    with (
        ProcessPool(settings, settings.worker_count)
        if settings.dask_scheduler is None
        else DaskExecutor(settings) as made
    ):
        yield made
