"""Two worker processes of uvicorn over a database."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from api.access.keys import EVERYTHING, Wanted, make_key
from fleet_db.storage import SqlStorage

WORKERS = 2
START_S = 60.0


def new_key(storage: SqlStorage) -> str:
    """Make a key that may everything, and return the header line that carries it."""
    wanted = Wanted(owner="bench", scopes=EVERYTHING, fleets=None, expires_ns=None)
    with storage.write() as unit:
        _, token = make_key(unit, wanted, "bench", time.time_ns())
    return f"Authorization: Bearer {token}"


@contextmanager
def served(folder: Path, database_url: str | None, workers: int = WORKERS) -> Iterator[str]:
    """Yield the URL of a running service.

    Args:
        folder: Its data folder; the log goes beside it.
        database_url: Of a migrated database; None for SQLite in the folder.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    url = f"http://127.0.0.1:{port}"
    environment = {
        **os.environ,
        "TREADWATCH_DATA_DIR": str(folder),
        "TREADWATCH_DATABASE_URL": database_url or "",
        "TREADWATCH_LOG_LEVEL": "warning",
        "TREADWATCH_ACCESS": "keys",
        "TREADWATCH_REQUESTS_PER_S": "1e6",
        "TREADWATCH_REQUESTS_BURST": "1000000",
        "TREADWATCH_STREAMS_PER_KEY": "1000",
        "TREADWATCH_FAILED_KEYS_PER_MINUTE": "6e4",
        "TREADWATCH_DOCS": "open",
    }
    command = [sys.executable, "-m", "uvicorn", "--factory", "api.asgi:app", "--port", str(port)]
    command += ["--workers", str(workers), "--no-access-log", "--log-level", "warning"]
    with (folder / "service.log").open("wb") as log:
        process = subprocess.Popen(command, env=environment, stderr=log, stdout=log)  # noqa: S603 - our own command
    try:
        _wait(url, process)
        yield url
    finally:
        process.terminate()
        process.wait(30)


def _wait(url: str, process: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + START_S
    while True:
        try:
            with urllib.request.urlopen(f"{url}/readyz", timeout=5):  # noqa: S310 - our own service
                return
        except (urllib.error.URLError, ConnectionError):
            if process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError("the service has not started; see service.log in its folder") from None
            time.sleep(0.1)
