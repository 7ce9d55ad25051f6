"""A Dask scheduler and workers of it as processes of their own, which a test may kill."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from api.settings import Settings
from bench.services import environment_of

START_S = 60.0


@dataclass
class DaskCluster:
    """A scheduler and its workers, which may be taken away and brought back."""

    environment: Mapping[str, str]
    folder: Path
    port: int
    running: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    @property
    def address(self) -> str:
        """Of the scheduler."""
        return f"tcp://127.0.0.1:{self.port}"

    def start_scheduler(self) -> None:
        """Start the scheduler and wait until it answers."""
        options = ["--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard"]
        self._start("scheduler", [sys.executable, "-m", "distributed.cli.dask_scheduler", *options])
        until = time.monotonic() + START_S
        while not _answers(self.port):
            assert time.monotonic() < until, self.log("scheduler")
            time.sleep(0.05)

    def start_workers(self, count: int, name: str = "workers", **others: str) -> None:
        """Start workers, as ``treadwatch worker`` does."""
        command = "import sys; sys.argv[0] = 'treadwatch'; from api.cli import main; main()"
        options = ["worker", "--dask-scheduler", self.address, "--workers", str(count)]
        self._start(name, [sys.executable, "-c", command, *options], others)

    def kill(self, name: str) -> None:
        """Kill the scheduler, or all workers with the process that replaces them."""
        process = self.running.pop(name)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait(30)

    def log(self, name: str) -> str:
        """Return what the scheduler, or the workers, have written."""
        return (self.folder / f"{name}.log").read_text(errors="replace")

    def _start(self, name: str, command: list[str], others: Mapping[str, str] | None = None) -> None:
        environment = {**self.environment, **(others or {})}
        with (self.folder / f"{name}.log").open("ab") as log:
            self.running[name] = subprocess.Popen(  # noqa: S603 - our own commands
                command, env=environment, stdout=log, stderr=log, start_new_session=True
            )


@contextmanager
def dask_cluster(settings: Settings, folder: Path, workers: int) -> Iterator[DaskCluster]:
    """Yield a running cluster for a deployment, and end it."""
    folder.mkdir(parents=True, exist_ok=True)
    environment = {**environment_of(settings), "TMPDIR": str(folder)}
    cluster = DaskCluster(environment, folder, _free_port())
    try:
        cluster.start_scheduler()
        cluster.start_workers(workers)
        yield cluster
    finally:
        for name in list(cluster.running):
            cluster.kill(name)


def _free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def _answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
    except OSError:
        return False
    return True
