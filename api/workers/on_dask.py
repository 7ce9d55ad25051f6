"""Units of work on the workers of a Dask scheduler, which are processes on any machines, and such workers here.

Dask carries keys and counts. Settings are not sent: each worker has those of its own environment, with which it opens
the same database and the same files. Whether it does, it shows before it gets work. A unit that Dask loses or does
twice does no harm: the claims are in the database.
"""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar, cast

from api.factory import process_name
from api.settings import Settings, load_settings
from api.workers.pool import context_of, in_worker, work_unit
from estimation.errors import PassingFaultError, TreadwatchError, WorkFailedError
from estimation.jobs.job import JobContext, WorkExecutor
from estimation.values.reasons import ReasonCode
from estimation.values.runs import JobTrigger
from fleet_db.atomic_files import passing_faults
from fleet_db.storage import SqlStorage
from ingest.live.status import Backoff

CONNECT_S = 10.0  # how long the scheduler may take to answer, s
LOOK_S = 1.0  # how often it is asked which workers there are, s
WITHOUT_WORKERS_S = 30.0  # so long units wait for workers, s; they may be starting again
FIRST_DELAY_S, LONGEST_DELAY_S = 0.5, 10.0
"""Between attempts to reach a scheduler that is away; each is twice the one before."""
STOP_LOOK_S = 0.2  # how often a stop is looked for, s
Result = TypeVar("Result")

_log = logging.getLogger(__name__)


class DaskExecutor(WorkExecutor):
    """Does units of work on the workers of a Dask scheduler, those that have shown that they are of this deployment."""

    work = staticmethod(work_unit)

    def __init__(self, settings: Settings) -> None:
        self._settings, self._address = settings, settings.dask_scheduler
        self._client: Any = None
        self._looking = threading.Lock()
        self._looked_s, self._served_s = -LOOK_S, -WITHOUT_WORKERS_S
        self._threads: dict[str, int] = {}
        self._greeted: dict[str, str | None] = {}
        self._sent: dict[Future[Any], frozenset[str]] = {}

    @property
    def width(self) -> int:
        """Number of threads of the workers that are fit; raises where the scheduler has none or does not answer."""
        self.look()
        return max(1, self.threads())

    @property
    def unfit(self) -> Sequence[str]:
        """Of the workers that get no work: who they are and why."""
        return sorted(why for why in self._greeted.values() if why is not None)

    def threads(self) -> int:
        """Return how many units the workers of the moment do at once; 0 where there are none."""
        with self._looking:
            self._look()
            return sum(self._threads[worker] for worker in self._fit())

    def look(self) -> None:
        """Greet workers that are new; give up what was sent to workers that are all gone.

        Raises:
            WorkFailedError: The scheduler does not answer, or there have been no workers that are fit for a while.
        """
        now_s = time.monotonic()
        if self.threads():
            self._served_s = now_s
        elif now_s - self._served_s > WITHOUT_WORKERS_S:
            others = "; ".join(["", *self.unfit])
            raise WorkFailedError(f"the Dask scheduler at {self._address} has no workers of this deployment{others}")

    def submit(self, work: Callable[..., Result], /, *arguments: Any, **named: Any) -> Future[Result]:  # noqa: ANN401 - of any work
        """Return what will hold the result of ``work(context, *arguments)``; cancelled where all are gone."""
        self.look()
        fit = self._fit()
        # another call each time, and no attempt of Dask's own after an exception; workers that are gone it replaces
        executor = self._client.get_executor(pure=False, retries=0, workers=fit, allow_other_workers=False)
        future = cast("Future[Result]", executor.submit(_on_worker, work, *arguments, **named))
        self._sent[future] = frozenset(fit)
        future.add_done_callback(lambda done: self._sent.pop(done, None))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:  # noqa: ARG002, FBT001, FBT002 - of the library
        """End the connection; units that have begun go on, under their claims."""
        with self._looking:
            if self._client is not None:
                self._client.close(timeout=CONNECT_S)
            self._client = None

    def _fit(self) -> list[str]:
        return sorted(worker for worker, why in self._greeted.items() if why is None)

    def _look(self) -> None:
        if time.monotonic() - self._looked_s < LOOK_S:
            return
        if self._client is not None and self._client.status != "running":
            self._client.close(timeout=1.0)
            self._client = None
        if self._client is None:
            self._client = _client(str(self._address))
        self._threads = {worker: int(count) for worker, count in self._client.ncores().items()}
        new = self._threads.keys() - self._greeted.keys()
        self._greeted = {worker: why for worker, why in self._greeted.items() if worker in self._threads}
        if new:
            self._greet(sorted(new))
        for future, workers in list(self._sent.items()):
            if workers.isdisjoint(self._threads):
                future.cancel()
        self._looked_s = time.monotonic()

    def _greet(self, new: Sequence[str]) -> None:
        """Let workers show that they have the version, the settings, the database and the files of this deployment."""
        context = context_of(self._settings)
        assert isinstance(context.storage, SqlStorage)
        with _challenge(context.storage) as word:
            answers = self._client.run(hello, word, estimated_with(context), workers=new, on_error="return")
        for worker in new:
            answer = answers.get(worker, "does not answer")
            self._greeted[worker] = answer if answer is None or isinstance(answer, str) else f"{worker}: {answer!r}"
            if answer is not None:
                _log.warning("a worker gets no work: %s", self._greeted[worker])


def _require_dask() -> None:
    if importlib.util.find_spec("distributed") is None:
        missing = "Dask is not installed: pip install 'treadwatch[dask]'"
        raise PassingFaultError(missing, code=ReasonCode.WAITS_FOR_EXTRA)


def _client(address: str) -> Any:  # noqa: ANN401 - a client of a package that may be missing
    _require_dask()
    from distributed import Client  # noqa: PLC0415 - an extra

    try:
        return Client(  # type: ignore[no-untyped-call]
            address, timeout=CONNECT_S, set_as_default=False
        )
    except (OSError, TimeoutError) as error:
        raise WorkFailedError(f"the Dask scheduler at {address} does not answer: {error}") from error


@contextmanager
def _challenge(storage: SqlStorage) -> Iterator[str]:
    """Yield a word that is in the database, as the holder of a lease, and in a file among the windows; for so long."""
    word = f"hello-{uuid.uuid4().hex}"
    file = storage.data_dir / "windows" / word
    with storage.owned(JobTrigger.CLI, word, CONNECT_S), passing_faults(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(word, "ascii")
        try:
            yield word
        finally:
            file.unlink()


def hello(word: str, wanted: str) -> str | None:
    """Return why the worker that this is called on is not to get work; None where it is."""
    try:
        context = context_of(_settings())
        storage = context.storage
        assert isinstance(storage, SqlStorage)
        with storage.read() as unit:
            same_database = unit.work_claims.has_holder(word)
    except TreadwatchError as error:
        return f"{process_name()}: {error}"
    if estimated_with(context) != wanted:
        return f"{process_name()} has another version or other settings than the process that runs the job"
    if not same_database:
        return f"{process_name()} works with another database"
    file = storage.data_dir / "windows" / word
    try:
        same_files = file.read_text("ascii") == word
    except OSError:
        same_files = False
    return None if same_files else f"{process_name()} does not see the files of this deployment in {file.parent}"


def estimated_with(context: JobContext) -> str:
    """Return a digest of everything in the settings that shapes a result, and of the numerics."""
    return hashlib.sha256(f"{context.code_version} {context.settings!r}".encode()).hexdigest()


_settings = cache(load_settings)


def _on_worker(work: Callable[..., Result], *arguments: Any) -> Result:  # noqa: ANN401 - of any work
    try:
        return in_worker(_settings(), work, *arguments)
    except WorkFailedError as error:
        raise WorkFailedError(f"{process_name()}: {error}") from None


def serve_dask(address: str, settings: Settings, stopping: threading.Event) -> None:
    """Run Dask's program for workers until a stop is asked for; it ends when its scheduler does, and is started again.

    Dask starts a worker again that has twice the memory that one may have.
    """
    _require_dask()
    delays = Backoff(FIRST_DELAY_S, LONGEST_DELAY_S)
    while not stopping.is_set():
        process = subprocess.Popen(_command(address, settings))  # noqa: S603 - our own interpreter
        while process.poll() is None and not stopping.wait(STOP_LOOK_S):
            pass
        if process.poll() is None:
            process.terminate()  # Dask lets the running units end
            process.wait()
            return
        delay_s = delays.failed()
        _log.warning(
            "the workers have ended (%s), perhaps with their scheduler: again in %g s", process.poll(), delay_s
        )
        stopping.wait(delay_s)


def _command(address: str, settings: Settings) -> list[str]:
    options = {
        "--nworkers": settings.worker_count,
        "--nthreads": 1,
        "--memory-limit": f"{2 * settings.worker_memory_mb}MB",
    }
    given = [str(part) for pair in options.items() for part in pair]
    return [sys.executable, "-m", "distributed.cli.dask_worker", address, *given, "--no-dashboard"]
