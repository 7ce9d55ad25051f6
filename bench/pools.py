"""The command ``python -m bench pools``: what becomes of work in process pools when a worker is killed or hangs.

The standard library's pool, our own of one such pool a worker, and pebble's and loky's where they are installed
(``pip install pebble==5.2.3 loky==3.7.0``); nothing else of ours needs those two.
"""

from __future__ import annotations

import argparse
import importlib.util
import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from api.factory import open_store
from api.settings import Settings
from api.workers.pool import ProcessPool
from fleet_db.migrate import upgrade

WORKERS, LIMIT_S, WAITED_S, SHORT_S = 2, 5.0, 20.0, 0.5
Submit = Callable[..., "Future[Any]"]


def answer(*_context: object, after_s: float = 0.0) -> int:
    """Return the number of this process, after a while."""
    time.sleep(after_s)
    return os.getpid()


def answer_late(*_context: object) -> int:
    """Return the number of this process after a while."""
    return answer(after_s=2.0)


def die(*_context: object) -> None:
    """Kill this process a moment after it has begun."""
    time.sleep(SHORT_S)
    os.kill(os.getpid(), signal.SIGKILL)


def hang(*_context: object) -> None:
    """Never come back."""
    while True:
        time.sleep(1.0)


@contextmanager
def ours(folder: Path) -> Iterator[Submit]:
    """Yield a pool of workers, each behind a pool of its own."""
    settings = Settings(data_dir=folder, unit_limit_s=LIMIT_S, shutdown_timeout_s=1)
    (folder / "windows").mkdir()
    upgrade(settings.url)
    open_store(settings).close()
    with ProcessPool(settings, WORKERS) as pool:
        yield pool.submit


@contextmanager
def _executor(made: Executor) -> Iterator[Submit]:
    try:
        yield made.submit
    finally:
        for process in dict(getattr(made, "_processes", None) or {}).values():
            with suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGKILL)
        made.shutdown(wait=False)


def stdlib(_folder: Path) -> AbstractContextManager[Submit]:
    """Return the standard library's pool."""
    return _executor(ProcessPoolExecutor(WORKERS, multiprocessing.get_context("forkserver")))


def loky(_folder: Path) -> AbstractContextManager[Submit]:
    """Return loky's pool."""
    return _executor(importlib.import_module("loky").ProcessPoolExecutor(WORKERS))


@contextmanager
def pebble(_folder: Path) -> Iterator[Submit]:
    """Yield pebble's pool, with a limit of time for each call."""
    pool = importlib.import_module("pebble").ProcessPool(WORKERS, context=multiprocessing.get_context("forkserver"))
    try:
        yield lambda function: pool.schedule(function, timeout=LIMIT_S)
    finally:
        pool.stop()
        pool.join()


POOLS: Mapping[str, Callable[[Path], AbstractContextManager[Submit]]] = {
    "one pool a worker (ours)": ours,
    "concurrent.futures": stdlib,
    "loky": loky,
    "pebble": pebble,
}


def said(submit: Submit, function: Callable[..., object]) -> str:
    """Return what comes of a call: done, or the name of what was raised."""
    try:
        return _of(submit(function))
    except Exception as error:  # noqa: BLE001 - that is what is measured
        return type(error).__name__


def _of(future: Future[Any]) -> str:
    try:
        future.result(WAITED_S)
    except TimeoutError:
        return "TimeoutError" if future.done() else f"nothing in {WAITED_S:g} s"
    except BaseException as error:  # noqa: BLE001 - the same
        return type(error).__name__
    return "done"


def after_fault(submit: Submit, fault: Callable[..., object]) -> tuple[str, str, str]:
    """Return what comes of a call at fault, of one that another worker does at the same time, and of the next."""
    for begun in [submit(answer_late) for _ in range(WORKERS)]:
        begun.result(10 * WAITED_S)
    faulty, beside = submit(fault), submit(answer_late)
    return _of(faulty), _of(beside), said(submit, answer)


def idle_killed(submit: Submit) -> tuple[str, str, str]:
    """Return the same where a worker is killed that is at nothing."""
    pid = submit(answer).result(10 * WAITED_S)
    os.kill(pid, signal.SIGKILL)
    time.sleep(SHORT_S)
    return "-", said(submit, answer), said(submit, answer)


FAULTS: Mapping[str, Callable[[Submit], tuple[str, str, str]]] = {
    "killed at work": lambda submit: after_fault(submit, die),
    "killed while idle": idle_killed,
    "hangs": lambda submit: after_fault(submit, hang),
}


def main(arguments: Sequence[str]) -> int:
    """Print what becomes of work in each pool that is installed."""
    argparse.ArgumentParser("python -m bench pools", description=__doc__).parse_args(arguments)
    table = Table("pool", "a worker", "its call", "the call beside it", "the next call", title_justify="left")
    for name, made in POOLS.items():
        if made in {loky, pebble} and importlib.util.find_spec(name) is None:
            continue
        for fault, harm in FAULTS.items():
            with tempfile.TemporaryDirectory(prefix="treadwatch-pools-") as folder, made(Path(folder)) as submit:
                table.add_row(name, fault, *harm(submit))
    Console(width=140).print(table)
    return 0
