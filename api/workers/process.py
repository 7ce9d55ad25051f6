"""What a worker process does: it opens the storage by itself, works on units, and says now and then that it lives."""

from __future__ import annotations

import logging
import os
import resource
import signal
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path

from api import logs
from api.factory import job_context, open_store, process_name
from api.settings import Settings
from estimation.errors import StorageError, TreadwatchError
from estimation.jobs.catalogue import stage_named
from estimation.jobs.claimed_work import claimed_work
from estimation.jobs.job import JobContext
from fleet_db.storage import SqlStorage

REST_S = 1.0
"""A worker that cannot reach the database rests so long, so that the others get the units."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class UnitOfWork:
    """A unit as it is sent to a worker.

    Attributes:
        stage, keys: What is to be done.
        owner: Token of the process that runs the job, with which claims end; None where the worker goes on without it.
    """

    stage: str
    keys: tuple[str, ...]
    owner: int | None = None


@dataclass(frozen=True, slots=True)
class UnitDone:
    """What came of a unit: counts, or why it was not done."""

    counts: Mapping[str, int]
    error: str | None = None


def work_on(context: JobContext, unit: UnitOfWork) -> UnitDone:
    """Do a unit; whatever is raised is handed back as its message."""
    storage = context.storage
    assert isinstance(storage, SqlStorage)
    working = replace(context, storage=replace(storage, works_for=unit.owner))
    try:
        return UnitDone(dict(claimed_work(working, stage_named(unit.stage), unit.keys)))
    except StorageError as error:
        threading.Event().wait(REST_S)
        return UnitDone({}, str(error))
    except TreadwatchError as error:
        return UnitDone({}, str(error))
    except Exception as error:  # noqa: BLE001 - what fails is a fact of the unit, never the end of the worker
        _log.exception("a unit of %s failed", unit.stage)
        return UnitDone({}, f"{type(error).__name__}: {error}".splitlines()[0])


@cache
def context_of(settings: Settings) -> JobContext:
    """Return what units of this process may touch; opened once.

    Raises:
        TreadwatchError: The database cannot be reached or used, or the settings are wrong.
    """
    return job_context(settings, open_store(settings))


def memory_mb() -> float:
    """Return how much memory this process has, MB."""
    pages = Path("/proc/self/statm")
    if pages.exists():
        return int(pages.read_text(encoding="ascii").split()[1]) * resource.getpagesize() / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3  # its largest so far


def run_worker(connection: Connection, settings: Settings, alive_s: float) -> None:
    """Do what comes through a connection until it ends; the entry of a worker process.

    Args:
        connection: Units come in; what came of them goes out, and between that the memory in MB as a sign of life.
        alive_s: Interval of the signs of life, s.
    """
    for number in (signal.SIGINT, signal.SIGTERM):  # whoever started it ends it, when its unit is done
        signal.signal(number, signal.SIG_IGN)
    logs.configure(settings)
    sending = threading.Lock()
    threading.Thread(target=_say_alive, args=(connection, sending, alive_s), daemon=True).start()
    while True:
        try:
            unit = connection.recv()
        except (EOFError, OSError):
            return
        done = _done(settings, unit)
        with sending:
            connection.send(done)


def _done(settings: Settings, unit: UnitOfWork) -> UnitDone:
    try:
        context = context_of(settings)
    except TreadwatchError as error:
        threading.Event().wait(REST_S)
        return UnitDone({}, str(error))
    return work_on(replace(context, holder=process_name()), unit)


def _say_alive(connection: Connection, sending: threading.Lock, alive_s: float) -> None:
    while True:
        try:
            with sending:
                connection.send(memory_mb())
        except OSError:  # whoever started this process is gone; its claims end with that
            os._exit(1)
        threading.Event().wait(alive_s)
