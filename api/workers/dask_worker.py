"""Workers of a Dask scheduler on this machine, each one process with one thread, under Dask's own supervisor."""

from __future__ import annotations

import importlib.util
import logging
import subprocess
import sys
from threading import Event

from api.settings import Settings
from estimation.errors import PassingFaultError
from estimation.values.reasons import ReasonCode
from ingest.live.backoff import Backoff

FIRST_DELAY_S, LONGEST_DELAY_S = 0.5, 10.0
"""Between attempts to reach a scheduler that is away; each is twice the one before."""
LOOK_S = 0.2
"""How often a stop is looked for, s."""

_log = logging.getLogger(__name__)


def serve_dask(address: str, settings: Settings, stopping: Event) -> None:
    """Run Dask's program for workers until a stop is asked for; it ends when its scheduler does, and is started again.

    Args:
        settings: Of the deployment: how many workers, and their memory; Dask starts a worker again that has twice as
            much.
        stopping: Set by whoever ends the service.

    Raises:
        PassingFaultError: Dask is not installed.
    """
    if importlib.util.find_spec("distributed") is None:
        missing = "Dask is not installed: pip install 'treadwatch[dask]'"
        raise PassingFaultError(missing, code=ReasonCode.WAITS_FOR_EXTRA)
    delays = Backoff(FIRST_DELAY_S, LONGEST_DELAY_S)
    while not stopping.is_set():
        process = subprocess.Popen(_command(address, settings))  # noqa: S603 - our own interpreter
        while process.poll() is None and not stopping.wait(LOOK_S):
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
