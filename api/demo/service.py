"""A served deployment inside one process: the REST API and the scheduler in threads."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

from api.factory import create_server, job_context, open_store, scheduled_jobs
from api.settings import Settings
from estimation.errors import StorageError
from estimation.jobs.scheduler import serve_jobs

START_S = 30.0


@contextmanager
def serving(settings: Settings) -> Iterator[str]:
    """Serve the REST API and run the jobs on schedule; yield the base URL, and end both on leaving.

    Raises:
        StorageError: The API did not start.
    """
    stopping = threading.Event()
    scheduler = threading.Thread(target=_schedule, args=(settings, stopping), name="scheduler", daemon=True)
    with serving_api(settings) as url:
        scheduler.start()
        try:
            yield url
        finally:
            stopping.set()
            scheduler.join(settings.shutdown_timeout_s)


@contextmanager
def serving_api(settings: Settings) -> Iterator[str]:
    """Serve the REST API alone; yield its base URL.

    Raises:
        StorageError: The API did not start.
    """
    api = create_server(settings)
    thread = threading.Thread(target=api.run, name="api", daemon=True)
    thread.start()
    try:
        deadline = time.monotonic() + START_S
        while not api.started:
            if time.monotonic() > deadline or not thread.is_alive():
                raise StorageError(f"the API did not start on {settings.host}:{settings.port}")
            time.sleep(0.05)
        yield f"http://{settings.host}:{settings.port}"
    finally:
        api.should_exit = True
        thread.join(settings.shutdown_timeout_s)


def free_port(host: str, wanted: int) -> int:
    """Return ``wanted`` if it can be listened on, else a free port."""
    for port in (wanted, 0):
        with closing(socket.socket(socket.AF_INET, socket.SOCK_STREAM)) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise StorageError(f"no port can be listened on at {host}")


def _schedule(settings: Settings, stopping: threading.Event) -> None:
    with closing(open_store(settings)) as storage:
        serve_jobs(job_context(settings, storage), scheduled_jobs(settings), stopping, holder="demo")
