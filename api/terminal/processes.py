"""How a process of the command line begins, waits for its database, and who works for it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import typer

from api import logs
from api.factory import once_the_database_answers, open_store
from api.logs import start_tracing
from api.settings import Settings
from api.terminal.stopping import stop_on_signals
from estimation.jobs.job import WorkExecutor
from fleet_db.storage import SqlStorage


def begun(settings: Settings) -> threading.Event:
    """Begin a process that runs until it is asked to stop: logs, tracing, signals; return what is set then."""
    logs.configure(settings)
    start_tracing()
    stopping = threading.Event()
    stop_on_signals(stopping)
    return stopping


def store_once_it_answers(settings: Settings, stopping: threading.Event) -> SqlStorage:
    """Return the opened database as soon as it answers; the command ends when a stop is asked for before."""
    opened = once_the_database_answers(partial(open_store, settings), settings, stopping)
    if opened is None:
        raise typer.Exit
    return opened


@contextmanager
def executor_of(settings: Settings) -> Iterator[WorkExecutor | None]:
    """Yield what does the units of work of this deployment: None for this process itself."""
    if settings.dask_scheduler is not None:
        from api.workers.on_dask import DaskExecutor  # noqa: PLC0415 - an extra

        with DaskExecutor(settings) as on_dask:
            yield on_dask
    elif settings.worker_count > 1:
        from api.workers.pool import ProcessPool  # noqa: PLC0415 - most commands work alone

        with ProcessPool(settings, settings.worker_count) as pool:
            yield pool
    else:
        yield None
