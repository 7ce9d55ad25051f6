"""``treadwatch serve`` as a process of its own, with its log in a file."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

START_S = 60.0
COMMAND = "from api.cli import main; main()"
ROOT = Path(__file__).parent.parent.parent


@dataclass(frozen=True)
class ServiceProcess:
    """A running service: its port and what it has logged."""

    process: subprocess.Popen[bytes]
    port: int
    file: Path

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def log(self) -> str:
        return self.file.read_text()


@contextmanager
def service_process(folder: Path, database_url: str | None = None, **environment: str) -> Iterator[ServiceProcess]:
    """Yield a service on a free port.

    Args:
        database_url: A migrated database; by default SQLite in ``folder``.
        environment: Further settings, without their prefix.
    """
    given: Mapping[str, str] = {"DATA_DIR": str(folder / "data"), "PORT": "0", "DATABASE_URL": database_url or ""}
    variables = {f"TREADWATCH_{name}": value for name, value in {**given, **environment}.items()}

    file = folder / "service.log"
    with file.open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", COMMAND, "serve"],
            env={**os.environ, "PYTHONPATH": str(ROOT), **variables},
            stderr=log,
        )
    try:
        yield ServiceProcess(process, _port(process, file), file)
    finally:
        process.terminate()
        process.wait(120)


def _port(process: subprocess.Popen[bytes], log: Path) -> int:
    until = time.monotonic() + START_S
    while (found := re.search(r"running on http://127\.0\.0\.1:(\d+)", log.read_text())) is None:
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < until, log.read_text()
        time.sleep(0.05)
    return int(found[1])


def wait_for(word: str, log: Path) -> None:
    """Wait until a word is in a log: services write theirs in the background, after they have answered."""
    until = time.monotonic() + START_S
    while word not in log.read_text():
        assert time.monotonic() < until, log.read_text()
        time.sleep(0.05)
