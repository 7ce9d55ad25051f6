"""Worker processes of this machine, each watched by a thread: one that is gone, still or too large is replaced.

What a replaced worker had claimed is free at once, and its unit goes to the next one. How often workers have ended at a
thing is counted in the database, so that no thing ends worker after worker.
"""

from __future__ import annotations

import logging
import multiprocessing
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerProcess
from queue import SimpleQueue

from api.factory import process_name
from api.settings import Settings
from api.workers.process import UnitDone, UnitOfWork, run_worker
from estimation.errors import StorageError, WorkFailedError
from estimation.jobs.job import JobContext, Work
from fleet_db.storage import SqlStorage

RECYCLED_AFTER = 500
"""Units after which a worker is replaced, whatever its memory: fragments of memory are never given back otherwise."""
SIGNS_A_LEASE = 8
"""How often a worker says that it lives during the length of a lease."""
LARGEST = 2.0
"""A worker that has so many times the memory that it may have after a unit is ended during it."""
START_S = 120.0
"""A worker that starts says nothing for so long at most: it loads the numerics."""
Handed = tuple[UnitOfWork, SqlStorage, Future[Mapping[str, int]]]

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Worker:
    """A running worker process."""

    process: ForkServerProcess
    connection: Connection
    said_s: float
    looked_s: float
    memory_mb: float = 0.0
    units: int = 0
    begun: bool = False  # it has said something

    @property
    def holder(self) -> str:
        """Name of the process in its claims."""
        return process_name(self.process.pid)


@dataclass(slots=True)
class ProcessPool:
    """Does units of work in processes of its own. Implements ``estimation.jobs.job.WorkExecutor``.

    Args:
        count: How many workers there are; started when the first unit comes.
    """

    settings: Settings
    count: int
    _units: SimpleQueue[Handed | None] = field(default_factory=SimpleQueue)
    _watchers: list[threading.Thread] = field(default_factory=list)
    _workers: dict[int, Worker] = field(default_factory=dict)
    _closing: threading.Event = field(default_factory=threading.Event)
    _until_s: float = float("inf")  # of closing, on the monotonic clock
    replaced: int = 0

    @property
    def width(self) -> int:
        """Number of workers."""
        return self.count

    def pids(self) -> list[int]:
        """Return the numbers of the processes that are running now."""
        return [worker.process.pid for worker in list(self._workers.values()) if worker.process.pid is not None]

    def submit(self, context: JobContext, stage: Work, keys: Sequence[str]) -> Future[Mapping[str, int]]:
        """Return what will hold the counts of a unit.

        Args:
            context: Of the job that hands the unit out.
            stage, keys: The unit.
        """
        storage = context.storage
        assert isinstance(storage, SqlStorage)
        self._start()
        future: Future[Mapping[str, int]] = Future()
        self._units.put((UnitOfWork(stage.name, tuple(keys), storage.owner_token), storage, future))
        return future

    def close(self) -> None:
        """Let the running units end, for as long as a shutdown may take, and end the workers."""
        self._until_s = time.monotonic() + self.settings.shutdown_timeout_s
        self._closing.set()
        for _ in self._watchers:
            self._units.put(None)
        for watcher in self._watchers:
            watcher.join()

    def _start(self) -> None:
        if self._watchers:
            return
        for number in range(self.count):
            watcher = threading.Thread(target=self._watch, args=(number,), name=f"worker {number}", daemon=True)
            self._watchers.append(watcher)
            watcher.start()

    def _watch(self, number: int) -> None:
        """Hand units to one worker after the other, until the pool is closed."""
        while (handed := self._units.get()) is not None:
            unit, storage, future = handed
            if self._closing.is_set() or not future.set_running_or_notify_cancel():
                future.cancel()
                continue
            try:
                done = self._done(number, unit, storage)
            except Exception as error:  # noqa: BLE001 - it is raised where the result is looked at
                _log.exception("a unit of %s could not be handed to a worker", unit.stage)
                done = UnitDone({}, str(error))
            if done.error is None:
                future.set_result(done.counts)
            else:
                future.set_exception(WorkFailedError(done.error))
        self._end(number)

    def _done(self, number: int, unit: UnitOfWork, storage: SqlStorage) -> UnitDone:
        """Return what comes of a unit, whatever happens to workers meanwhile."""
        while True:
            worker = self._worker(number)
            done = self._of_worker(worker, unit)
            if done is None:
                self._end(number)
                self.replaced += 1
                _freed(storage, worker, forgiven=self._closing.is_set())
                if self._closing.is_set():
                    return UnitDone({}, "the process is stopping")
                continue
            worker.units += 1
            if worker.units >= RECYCLED_AFTER or worker.memory_mb > self.settings.worker_memory_mb:
                _log.info(
                    "worker %s is replaced after %d units, %.0f MB", worker.holder, worker.units, worker.memory_mb
                )
                self._end(number)
            return done

    def _worker(self, number: int) -> Worker:
        worker = self._workers.get(number)
        if worker is None:
            worker = self._workers[number] = _started(self.settings, self._sign_s)
        return worker

    @property
    def _sign_s(self) -> float:
        return self.settings.lease_s / SIGNS_A_LEASE

    def _of_worker(self, worker: Worker, unit: UnitOfWork) -> UnitDone | None:
        """Return what comes of a unit in one worker; None where the worker is to be replaced."""
        worker.said_s = worker.looked_s = time.monotonic()
        try:
            worker.connection.send(unit)
            while True:
                if wait([worker.connection, worker.process.sentinel], self._sign_s) and worker.connection.poll():
                    said = worker.connection.recv()
                    worker.said_s, worker.begun = time.monotonic(), True
                    if isinstance(said, UnitDone):
                        return said
                    worker.memory_mb = said
                elif not worker.process.is_alive():
                    _log.warning("worker %s has ended: %s", worker.holder, worker.process.exitcode)
                    return None
                if (why := self._why_ended(worker)) is not None:
                    _log.warning("worker %s is ended: %s", worker.holder, why)
                    return None
        except (EOFError, OSError):
            worker.process.join(1.0)
            _log.warning("worker %s has ended: %s", worker.holder, worker.process.exitcode)
            return None

    def _why_ended(self, worker: Worker) -> str | None:
        """Return why a worker that is at work is to be ended; None where it is not."""
        now_s = time.monotonic()
        stood_still_s = now_s - worker.looked_s - self._sign_s
        worker.looked_s = now_s
        if stood_still_s > self._sign_s:  # this process, perhaps its machine: what was said then is not read yet
            worker.said_s += stood_still_s
        if now_s - worker.said_s > (self.settings.lease_s if worker.begun else START_S):
            return f"it has said nothing for {now_s - worker.said_s:.0f} s"
        if worker.memory_mb > LARGEST * self.settings.worker_memory_mb:
            return f"it has {worker.memory_mb:.0f} MB"
        if self._closing.is_set() and now_s > self._until_s:
            return "the process is stopping"
        return None

    def _end(self, number: int) -> None:
        """End a worker that is at no unit, or not to be waited for."""
        worker = self._workers.pop(number, None)
        if worker is None:
            return
        worker.connection.close()
        worker.process.kill()
        worker.process.join()


def _started(settings: Settings, sign_s: float) -> Worker:
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload([run_worker.__module__])
    ours, theirs = server.Pipe()
    process = server.Process(target=run_worker, args=(theirs, settings, sign_s), daemon=True)
    process.start()
    theirs.close()
    return Worker(process, ours, time.monotonic(), time.monotonic())


def _freed(storage: SqlStorage, worker: Worker, *, forgiven: bool) -> None:
    """Let what a worker that is gone had claimed be free at once; else it is when the lease ends."""
    try:
        with storage.write() as unit:
            unit.work_claims.end_of(worker.holder, forgiven=forgiven)
    except StorageError as error:
        _log.warning("the claims of worker %s could not be ended: %s", worker.holder, error)
