"""What commands share: the database of this deployment, who uses it, how a process begins and who works for it."""

from __future__ import annotations

import getpass
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial

from rich.console import Console

from api import logs
from api.factory import once_the_database_answers, open_store
from api.logs import start_tracing
from api.settings import Settings, load_settings
from estimation.jobs.job import WorkExecutor
from estimation.jobs.scheduler import stop_on_signals
from fleet_db.storage import SqlStorage, SqlUnitOfWork

NAMELESS = "command line"  # who is recorded where the user of the system has no name, as in a container


def begun(settings: Settings) -> threading.Event:
    """Begin a process that runs until it is asked to stop: logs, tracing, signals; return what is set then."""
    logs.configure(settings)
    start_tracing()
    stopping = threading.Event()
    stop_on_signals(stopping)
    return stopping


def store_once_it_answers(settings: Settings, stopping: threading.Event) -> SqlStorage | None:
    """Return the opened database as soon as it answers; None when a stop is asked for before."""
    return once_the_database_answers(partial(open_store, settings), settings, stopping)


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


@contextmanager
def reading() -> Iterator[SqlUnitOfWork]:
    """Return a reading transaction of the database that the settings name."""
    with closing(open_store(load_settings())) as storage, storage.read() as unit:
        yield unit


@contextmanager
def writing() -> Iterator[SqlUnitOfWork]:
    """Return a writing transaction of the database that the settings name."""
    with closing(open_store(load_settings())) as storage, storage.write() as unit:
        yield unit


def user_name() -> str:
    """Return the name of the user of the system."""
    try:
        return getpass.getuser()
    except (KeyError, OSError, ImportError):
        return NAMELESS


def user_here() -> str:
    """Return who is recorded with what the command line does."""
    name = user_name()
    return f"the {NAMELESS}" if name == NAMELESS else f"{name} at the command line"


def print_line(console: Console, text: str, style: str | None = None) -> None:
    """Print a line as it is, however long."""
    console.print(text, style=style, highlight=False, soft_wrap=True)


def columns(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as lines whose cells stand below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )
