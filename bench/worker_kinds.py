"""Workers of a deployment, by kind and number: none, processes of this machine, or those of a Dask scheduler."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from api.settings import Settings
from api.workers.on_dask import DaskExecutor
from api.workers.pool import ProcessPool
from bench.dask_cluster import dask_cluster
from estimation.jobs.job import WorkExecutor

TICKS = os.sysconf("SC_CLK_TCK")
Pids = Callable[[], Sequence[int]]
Kind = Callable[[Settings, int], AbstractContextManager[tuple[WorkExecutor | None, Pids]]]
"""From settings and a number to workers, and what gives the numbers of their processes."""


def cpu_of(pid: int) -> float:
    """Return the processor time of a process so far, s; 0 where it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(") ")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / TICKS


@contextmanager
def here(_settings: Settings, _count: int) -> Iterator[tuple[WorkExecutor | None, Pids]]:
    """Yield no workers: this process does the work."""
    yield None, tuple


@contextmanager
def pool_of(settings: Settings, count: int) -> Iterator[tuple[WorkExecutor | None, Pids]]:
    """Yield a process pool for a deployment."""
    with ProcessPool(settings, count) as pool:
        yield pool, pool.pids


@contextmanager
def dask_of(settings: Settings, count: int) -> Iterator[tuple[WorkExecutor | None, Pids]]:
    """Yield the workers of a Dask scheduler for a deployment."""
    from distributed import Client  # noqa: PLC0415 - workers of this machine are measured without it

    folder = settings.data_dir.parent / "dask"
    with dask_cluster(settings, folder, count) as cluster:
        chosen = settings.model_copy(update={"dask_scheduler": cluster.address})
        with DaskExecutor(chosen) as executor, Client(cluster.address) as client:
            while executor.threads() < count:
                time.sleep(0.1)
            pids = [int(number) for number in client.run(os.getpid).values()]
            yield executor, lambda: pids
