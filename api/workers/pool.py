"""Worker processes of this machine: the standard library's pool, one for each worker.

In a pool of several processes one that is killed breaks the futures of all, and nothing limits how long a unit takes:
``docs/decisions/worker-pool.md`` shows what becomes of that here and in other libraries. A pool of one process breaks
alone, and a new one takes its place; the unit is handed out again by whoever handed it out.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import resource
import signal
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import parent_process
from multiprocessing.connection import wait
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

from api import logs
from api.factory import open_store, process_name
from api.pipeline import job_context
from api.settings import Settings
from estimation.errors import StorageError, TreadwatchError, WorkFailedError
from estimation.jobs.catalogue import stage_named
from estimation.jobs.job import JobContext, WorkExecutor, WorkUnit
from estimation.jobs.work import claimed_work

REST_S = 1.0  # a worker that cannot reach the database rests so long, so that the others get the units
Result = TypeVar("Result")

_log = logging.getLogger(__name__)


@cache
def context_of(settings: Settings) -> JobContext:
    """Return what units of this process may touch; opened once."""
    return replace(job_context(settings, open_store(settings)), holder=process_name())


def in_worker(settings: Settings, work: Callable[..., Result], *arguments: Any) -> Result:  # noqa: ANN401 - of any work
    """Return ``work(context, *arguments)``; what is raised fails the unit, as its message, never the worker."""
    try:
        return work(context_of(settings), *arguments)
    except StorageError as error:
        threading.Event().wait(REST_S)
        raise WorkFailedError(str(error)) from None
    except TreadwatchError as error:
        raise WorkFailedError(str(error)) from None
    except Exception as error:  # noqa: BLE001 - see above
        _log.exception("a unit failed")
        raise WorkFailedError(f"{type(error).__name__}: {error}".splitlines()[0]) from None


def work_unit(context: JobContext, unit: WorkUnit) -> Mapping[str, int]:
    """Do a unit of a stage that this process knows by its name; return what was counted."""
    return claimed_work(context, stage_named(unit.stage), unit)


def begin(settings: Settings) -> None:
    """Prepare a process of a pool: it leaves signals to whoever started it, and ends when that is gone."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    logs.configure(settings)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


RECYCLED_AFTER = 500
"""Units after which a worker is replaced, whatever its memory: fragments of memory are never given back otherwise."""
LARGEST = 2.0  # a worker that has so many times the memory that it may have after a unit is ended during it
START_S = 120.0  # a worker takes at most so long to start: it loads the numerics
LOOK_S = 1.0  # how often a worker that is at work is looked at, s


class ProcessPool(WorkExecutor):
    """Does units of work in processes of its own."""

    work = staticmethod(work_unit)

    def __init__(self, settings: Settings, count: int) -> None:
        self._settings, self._count = settings, count
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="worker")
        self._workers = [_Worker(settings) for _ in range(count)]
        self._idle: SimpleQueue[_Worker] = SimpleQueue()
        for worker in self._workers:
            self._idle.put(worker)
        self.replaced = 0

    @property
    def width(self) -> int:
        """Number of workers."""
        return self._count

    def pids(self) -> list[int]:
        """Return the numbers of the processes that are running now."""
        return [worker.pid for worker in self._workers if worker.pid]

    def submit(self, work: Callable[..., Result], /, *arguments: Any, **named: Any) -> Future[Result]:  # noqa: ANN401 - of any work
        """Return what will hold the result of ``work(context, *arguments)``, or ``BrokenExecutor``."""
        assert not named
        return self._threads.submit(self._done, work, arguments)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:  # noqa: FBT001, FBT002 - of the library
        """Let the running units end, for as long as a shutdown may take, and end the workers."""
        self._threads.shutdown(wait=False, cancel_futures=cancel_futures)
        until_s = time.monotonic() + self._settings.shutdown_timeout_s
        for worker in self._workers:
            worker.until_s = min(worker.until_s, until_s)
        self._threads.shutdown(wait)
        for worker in self._workers:
            worker.end()

    def _done(self, work: Callable[..., Result], arguments: tuple[Any, ...]) -> Result:
        worker = self._idle.get()
        try:
            return worker.done(work, arguments)
        except BrokenExecutor as error:
            self.replaced += 1
            _log.warning("worker %s has ended: %s", process_name(worker.pid), error)
            worker.end()
            raise
        finally:
            self._idle.put(worker)


@dataclass(slots=True)
class _Worker:
    """One process after the other, each behind a pool that has no other."""

    settings: Settings
    until_s: float = float("inf")  # when the pool is closed, on the monotonic clock
    pool: ProcessPoolExecutor | None = None
    pid: int = 0
    units: int = 0  # that the process has done

    def done(self, work: Callable[..., Result], arguments: tuple[Any, ...]) -> Result:
        """Return what comes of a unit; a process that has ended, or is to be killed, is a broken executor."""
        pool = self.pool or self._started()
        future = pool.submit(in_worker, self.settings, work, *arguments)
        begun_s = time.monotonic()
        while True:
            try:
                result = future.result(LOOK_S)
                break
            except TimeoutError:
                self._check(time.monotonic() - begun_s)
        self.units += 1
        if self.units >= RECYCLED_AFTER or _memory_mb(self.pid) > self.settings.worker_memory_mb:
            _log.info("worker %s is replaced after %d units", process_name(self.pid), self.units)
            self.end()
        return result

    def end(self) -> None:
        """End the process, which is at no unit or has ended."""
        if self.pool is not None:
            self.pool.shutdown(wait=self.pid > 0)
        self.pool, self.pid, self.units = None, 0, 0

    def _started(self) -> ProcessPoolExecutor:
        server = multiprocessing.get_context("forkserver")
        server.set_forkserver_preload([in_worker.__module__])
        self.pool = ProcessPoolExecutor(1, server, begin, (self.settings,))
        try:
            self.pid = self.pool.submit(os.getpid).result(START_S)
        except TimeoutError:
            raise BrokenExecutor(f"it has not started within {START_S:g} s") from None
        return self.pool

    def _check(self, took_s: float) -> None:
        memory_mb = _memory_mb(self.pid)
        if took_s > self.settings.unit_limit_s:
            why = f"a unit has taken {took_s:.0f} s"
        elif memory_mb > LARGEST * self.settings.worker_memory_mb:
            why = f"it has {memory_mb:.0f} MB"
        elif time.monotonic() > self.until_s:
            why = "the process is stopping"
        else:
            return
        os.kill(self.pid, signal.SIGKILL)
        if time.monotonic() > self.until_s:
            self._forgive()
        raise BrokenExecutor(why)

    def _forgive(self) -> None:
        """Let what the worker had claimed be free: that it is ended now does not count against that."""
        try:
            with closing(open_store(self.settings)) as storage, storage.write() as unit:
                unit.work_claims.forgive(process_name(self.pid))
        except StorageError as error:
            _log.warning("the claims of worker %s could not be ended: %s", process_name(self.pid), error)


def _memory_mb(pid: int) -> float:
    pages = Path(f"/proc/{pid}/statm")
    return int(pages.read_text("ascii").split()[1]) * resource.getpagesize() / 1e6 if pages.exists() else 0.0
