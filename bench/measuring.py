"""What work costs: processor time and memory of all processes, statements, transactions that write."""

from __future__ import annotations

import os
import resource
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event, Thread

import numpy as np

from api.comparison.trial import Recorded, receive
from api.settings import Settings
from api.workers.on_dask import DaskExecutor
from api.workers.pool import ProcessPool
from bench.counting import asked, run
from bench.services import dask_cluster
from estimation.jobs.catalogue import ALL_JOBS
from estimation.jobs.job import JobContext, WorkExecutor
from fleet_db.storage import SqlStorage

TICKS = os.sysconf("SC_CLK_TCK")
INGEST = "ingest"
Pids = Callable[[], Sequence[int]]
Kind = Callable[[Settings, int], AbstractContextManager[tuple[WorkExecutor | None, Pids]]]
"""From settings and a number to workers, and what gives the numbers of their processes."""


@dataclass(slots=True)
class Stages:
    """What each stage from recordings to alerts took: CPU s and statements; and the windows that came of them."""

    windows: int = 0
    cpu_s: Counter[str] = field(default_factory=Counter)
    statements: Counter[str] = field(default_factory=Counter)
    estimated: int = 0

    @property
    def whole_s(self) -> float:
        """CPU s of all stages."""
        return self.cpu_s.total()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add what the block takes to a stage."""
        begin_s = cpu_of_tree()
        with asked() as found:
            yield
        self.cpu_s[name] += cpu_of_tree() - begin_s
        self.statements[name] += found.statements

    def measure(self, storage: SqlStorage, context: JobContext, settings: Settings, recorded: Recorded) -> None:
        """Receive recordings and run all jobs."""
        known = windows_of(storage).total()
        with self.stage(INGEST):
            receive(recorded, settings)
        self.windows += windows_of(storage).total() - known
        self.run_jobs(context)

    def run_jobs(self, context: JobContext) -> None:
        """Run all jobs."""
        for job in ALL_JOBS:
            with self.stage(job.name):
                self.estimated += run(job, context).counts.get("estimated", 0)


def windows_of(storage: SqlStorage) -> Counter[str]:
    """Return how many windows a deployment has, by state."""
    with storage.read() as unit:
        return Counter(unit.windows.counts())


def exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """Return the slope of the logarithm of the cost against that of the size."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def tree(root: int) -> list[int]:
    """Return the number of a process and of all that descend from it and run."""
    found, left = [], [root]
    while left:
        pid = left.pop()
        found.append(pid)
        for children in Path(f"/proc/{pid}/task").glob("*/children"):
            left += map(int, _text(children).split())
    return found


def cpu_of(pid: int, *, ended_too: bool = False) -> float:
    """Return the processor time of a process so far, s, with that of children that have ended; 0 where it is gone."""
    fields = _text(Path(f"/proc/{pid}/stat")).rpartition(") ")[2].split()
    return sum(map(int, fields[11 : 15 if ended_too else 13])) / TICKS


def cpu_of_tree() -> float:
    """Return the processor time of this process and all that descend from it so far, s."""
    return sum(cpu_of(pid, ended_too=True) for pid in tree(os.getpid()))


def memory_of_tree() -> int:
    """Return the memory of all of them, in which what several share counts once, bytes; it takes milliseconds."""
    lines = (line for pid in tree(os.getpid()) for line in _text(Path(f"/proc/{pid}/smaps_rollup")).splitlines())
    return sum(1024 * int(line.split()[1]) for line in lines if line.startswith("Pss:"))


def resident_of(pid: int) -> int:
    """Return the resident memory of a process, bytes; 0 where it is gone."""
    return int((_text(Path(f"/proc/{pid}/statm")).split() or ["0", "0"])[1]) * resource.getpagesize()


@contextmanager
def every(seconds: float, do: Callable[[], None]) -> Iterator[None]:
    """Do something again and again meanwhile, in a thread."""
    ended, failed = Event(), list[Exception]()

    def loop() -> None:
        try:
            while not ended.wait(seconds):
                do()
        except Exception as error:  # noqa: BLE001 - raised at the end
            failed.append(error)

    thread = Thread(target=loop, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
    if failed:
        raise failed[0]


def _text(path: Path) -> str:
    """Return what a file of the kernel says; nothing where its process is gone."""
    try:
        return path.read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""


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

    with dask_cluster(settings, settings.data_dir.parent / "dask", count) as cluster:
        chosen = settings.model_copy(update={"dask_scheduler": cluster.address})
        with DaskExecutor(chosen) as executor, Client(cluster.address) as client:
            while executor.threads() < count:
                time.sleep(0.1)
            pids = [int(number) for number in client.run(os.getpid).values()]
            yield executor, lambda: pids


KINDS: Mapping[str, Kind] = {"processes": pool_of, "Dask workers": dask_of}
