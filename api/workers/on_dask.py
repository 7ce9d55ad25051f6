"""Units of work on the workers of a Dask scheduler, which are processes on any machines; the extra ``dask``.

Dask carries keys and counts. Settings are not sent: each worker has those of its own environment, with which it opens
the same database and the same files, and refuses a unit where it would estimate otherwise. A unit that Dask loses or
does twice does no harm: the claims are in the database.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import threading
import time
import uuid
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Any, cast

from api.factory import process_name
from api.settings import load_settings
from api.workers.process import UnitDone, UnitOfWork, context_of, work_on
from estimation.errors import PassingFaultError, TreadwatchError, WorkFailedError
from estimation.jobs.job import JobContext, Work
from estimation.values.reasons import ReasonCode

CONNECT_S = 10.0
"""How long the scheduler may take to answer, s."""
LOOK_S = 5.0
"""How often it is asked whether there are workers, while a unit is waited for, s."""
WITHOUT_WORKERS_S = 30.0
"""So long a unit waits for workers, s; they may be starting again."""


@dataclass(slots=True)
class DaskExecutor:
    """Does units of work on the workers of a Dask scheduler. Implements ``estimation.jobs.job.WorkExecutor``.

    Args:
        address: Of the scheduler, such as ``tcp://scheduler:8786``.
    """

    address: str
    _client: Any = None
    _opening: threading.Lock = field(default_factory=threading.Lock)

    @property
    def width(self) -> int:
        """Number of threads of all workers.

        Raises:
            WorkFailedError: The scheduler does not answer, or has no workers.
        """
        threads = self.threads()
        if threads == 0:
            raise WorkFailedError(f"the Dask scheduler at {self.address} has no workers")
        return threads

    def threads(self) -> int:
        """Return how many units the workers of the moment do at once; 0 where there are none."""
        return sum(int(count) for count in self._connected().ncores().values())

    def pids(self) -> list[int]:
        """Return the numbers of the processes of all workers, on whatever machine."""
        return [int(number) for number in self._connected().run(os.getpid).values()]

    def submit(self, context: JobContext, stage: Work, keys: Sequence[str]) -> Future[Mapping[str, int]]:
        """Return what will hold the counts of a unit.

        Args:
            context: Of the job that hands the unit out.
            stage, keys: The unit.

        Raises:
            WorkFailedError: The scheduler does not answer.
        """
        name = f"{stage.name}-{uuid.uuid4().hex}"  # another one each time: Dask keeps no result for later
        unit = UnitOfWork(stage.name, tuple(keys))
        client = self._connected()
        sent = client.submit(work, unit, estimated_with(context), key=name, pure=False, retries=0)
        future: Future[Mapping[str, int]] = Future()
        future.set_running_or_notify_cancel()
        threading.Thread(target=_hand_over, args=(client, sent, future), name=name, daemon=True).start()
        return future

    def close(self) -> None:
        """End the connection; units that have begun go on, under their claims."""
        with self._opening:
            if self._client is not None:
                self._client.close(timeout=CONNECT_S)
            self._client = None

    def _connected(self) -> Any:  # noqa: ANN401 - a client of a package that may be missing
        with self._opening:
            if self._client is not None and self._client.status != "running":
                self._client.close(timeout=1.0)
                self._client = None
            if self._client is None:
                self._client = _client(self.address)
            return self._client


def _client(address: str) -> Any:  # noqa: ANN401 - the same
    if importlib.util.find_spec("distributed") is None:
        raise PassingFaultError(
            "Dask is not installed: pip install 'treadwatch[dask]'", code=ReasonCode.WAITS_FOR_EXTRA
        )
    from distributed import Client  # noqa: PLC0415 - an extra

    try:
        return Client(  # type: ignore[no-untyped-call]
            address, timeout=CONNECT_S, set_as_default=False
        )
    except (OSError, TimeoutError) as error:
        raise WorkFailedError(f"the Dask scheduler at {address} does not answer: {error}") from error


def _hand_over(client: Any, sent: Any, future: Future[Mapping[str, int]]) -> None:  # noqa: ANN401 - the same
    """Wait for a unit; whatever Dask says of one that it has lost is that it was not done."""
    try:
        done = _waited_for(client, sent)
    except BaseException as error:  # noqa: BLE001 - of Dask: a worker or the scheduler is gone
        future.set_exception(WorkFailedError(f"Dask has lost a unit: {type(error).__name__}: {error}"))
        return
    finally:
        sent.release()
    if done.error is None:
        future.set_result(done.counts)
    else:
        future.set_exception(WorkFailedError(done.error))


def _waited_for(client: Any, sent: Any) -> UnitDone:  # noqa: ANN401 - the same
    """Return what comes of a unit.

    Raises:
        WorkFailedError: There have been no workers for a while.
    """
    alone_s: float | None = None
    while True:
        try:
            return cast("UnitDone", sent.result(timeout=LOOK_S))
        except TimeoutError:
            if client.ncores():
                alone_s = None
                continue
        alone_s = time.monotonic() if alone_s is None else alone_s
        if time.monotonic() - alone_s > WITHOUT_WORKERS_S:
            raise WorkFailedError("there are no workers")


def estimated_with(context: JobContext) -> str:
    """Return a digest of everything in the settings that shapes an estimate, and of the numerics."""
    text = f"{context.code_version} {context.settings.estimation!r} {context.settings.alignment!r}"
    return hashlib.sha256(text.encode()).hexdigest()


def work(unit: UnitOfWork, wanted: str) -> UnitDone:
    """Do a unit on a worker of Dask, with the settings of its own environment.

    Args:
        wanted: What :func:`estimated_with` returns where the unit comes from.
    """
    try:
        context = context_of(load_settings())
    except TreadwatchError as error:
        return UnitDone({}, f"{process_name()}: {error}")
    if estimated_with(context) != wanted:
        text = "has another version or other settings than the process that runs the job"
        return UnitDone({}, f"{process_name()} {text}")
    done = work_on(replace(context, holder=f"{process_name()}, Dask"), unit)
    return done if done.error is None else replace(done, error=f"{process_name()}: {done.error}")
