"""Workers of a Dask scheduler on this machine, each one process with one thread, under Dask's own supervisor."""

from __future__ import annotations

import importlib.util
import os
import sys
from typing import NoReturn

from api.settings import Settings
from estimation.errors import PassingFaultError
from estimation.values.reasons import ReasonCode


def become_dask_workers(address: str, settings: Settings) -> NoReturn:
    """Go on as Dask's program for workers, which replaces workers that end, and waits for its scheduler.

    Parameters
    ----------
    address
        Of the scheduler.
    settings
        Of the deployment: how many workers, and their memory; a worker above it is started again.

    Raises
    ------
    PassingFaultError
        Dask is not installed.
    """
    if importlib.util.find_spec("distributed") is None:
        missing = "Dask is not installed: pip install 'treadwatch[dask]'"
        raise PassingFaultError(missing, code=ReasonCode.WAITS_FOR_EXTRA)
    options = {
        "--nworkers": settings.worker_count,
        "--nthreads": 1,
        "--memory-limit": f"{2 * settings.worker_memory_mb}MB",
        "--death-timeout": 60,
    }
    given = [str(part) for pair in options.items() for part in pair]
    command = [sys.executable, "-m", "distributed.cli.dask_worker", address, *given, "--no-dashboard"]
    os.execv(sys.executable, command)  # noqa: S606 - our own interpreter
