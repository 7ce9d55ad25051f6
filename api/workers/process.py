"""What a worker process does: it opens the storage by itself, and does what it is handed."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from multiprocessing import parent_process
from multiprocessing.connection import wait
from typing import Any, TypeVar

from api import logs
from api.factory import job_context, open_store, process_name
from api.settings import Settings
from estimation.errors import StorageError, TreadwatchError, WorkFailedError
from estimation.jobs.catalogue import stage_named
from estimation.jobs.hand_out import claimed_work
from estimation.jobs.job import JobContext, WorkUnit

REST_S = 1.0
"""A worker that cannot reach the database rests so long, so that the others get the units."""
Result = TypeVar("Result")

_log = logging.getLogger(__name__)


@cache
def context_of(settings: Settings) -> JobContext:
    """Return what units of this process may touch; opened once.

    Raises:
        TreadwatchError: The database cannot be reached or used, or the settings are wrong.
    """
    return replace(job_context(settings, open_store(settings)), holder=process_name())


def in_worker(settings: Settings, work: Callable[..., Result], *arguments: Any) -> Result:  # noqa: ANN401 - of any work
    """Return ``work(context, *arguments)`` with the context of this process.

    Raises:
        WorkFailedError: Whatever was raised, as its message: what fails is a fact of the unit, never the worker's end.
    """
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
