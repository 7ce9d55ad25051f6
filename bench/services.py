"""Processes of the product and databases that benches start."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import psycopg
import sqlalchemy
from psycopg import sql

from api.settings import PREFIX, Settings
from tests.postgres_server import SAFE, stoppable_server

COMMAND = "import sys; sys.argv[0] = 'treadwatch'; from api.cli import main; main()"
START_S = 120.0
DATABASES = ("sqlite", "postgresql")


def environment_of(settings: Settings) -> dict[str, str]:
    """Return the environment of a process that has these settings: those that are not the default."""
    chosen = settings.model_dump(exclude_defaults=True).items()
    path = os.pathsep.join(path for path in sys.path if path)
    return {**os.environ, "PYTHONPATH": path, **{f"{PREFIX}{name.upper()}": str(value) for name, value in chosen}}


def started(
    settings: Settings, *arguments: str, log: Path | None = None, others: Mapping[str, str] | None = None
) -> subprocess.Popen[bytes]:
    """Start a command of the product in a process group of its own; ``others`` are more variables for it."""
    return started_program(["-c", COMMAND, *arguments], {**environment_of(settings), **(others or {})}, log)


def started_program(
    arguments: list[str], environment: Mapping[str, str], log: Path | None = None
) -> subprocess.Popen[bytes]:
    """Start a Python program whose output goes to a file, or nowhere."""
    with (log or Path(os.devnull)).open("ab") as output:
        return subprocess.Popen(  # noqa: S603 - our own commands
            [sys.executable, *arguments], env=environment, stdout=output, stderr=output, start_new_session=True
        )


@contextmanager
def running(settings: Settings, *arguments: str, log: Path | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """Let a command of the product run meanwhile."""
    process = started(settings, *arguments, log=log)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(START_S)


def free_port() -> int:
    """Return a port on which nobody listens."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def answers(url: str) -> bool:
    """Return whether a service answers as it should."""
    try:
        with urllib.request.urlopen(url, timeout=5):  # noqa: S310 - our own service
            return True
    except (urllib.error.URLError, ConnectionError, TimeoutError):
        return False


def until(reached: Callable[[], bool], seconds: float) -> float | None:
    """Wait until something is so; return how long it took, s, or None."""
    begin = time.monotonic()
    while not reached():
        if time.monotonic() - begin > seconds:
            return None
        time.sleep(0.02)
    return time.monotonic() - begin


@contextmanager
def new_database(kind: str) -> Iterator[tuple[Path, str | None]]:
    """Yield a data folder and the URL of an empty database of a kind; None for the file in the folder."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-bench-") as name:
        if kind == "sqlite":
            yield Path(name), None
            return
        with stoppable_server(SAFE) as server:
            yield Path(name), server.url


def created(server: str, name: str, template: str = "template0", password: str | None = None) -> str:
    """Create a database on a server as a copy of another, and return its URL, with a password where one is given."""
    with psycopg.connect(server, autocommit=True) as connection:
        names = sql.Identifier(name), sql.Identifier(template)
        connection.execute(sql.SQL("CREATE DATABASE {} TEMPLATE {}").format(*names))
    url = sqlalchemy.make_url(server).set(drivername="postgresql", database=name, password=password)
    return url.render_as_string(hide_password=False)


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
        self._start("scheduler", ["-m", "distributed.cli.dask_scheduler", *options])
        assert until(lambda: _listens(self.port), START_S) is not None, self.log("scheduler")

    def start_workers(self, count: int, name: str = "workers", **others: str) -> None:
        """Start workers, as ``treadwatch worker`` does."""
        options = ["worker", "--dask-scheduler", self.address, "--workers", str(count)]
        self._start(name, ["-c", COMMAND, *options], others)

    def kill(self, name: str) -> None:
        """Kill the scheduler, or all workers with the process that replaces them."""
        process = self.running.pop(name)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait(30)

    def log(self, name: str) -> str:
        """Return what the scheduler, or the workers, have written."""
        return (self.folder / f"{name}.log").read_text(errors="replace")

    def _start(self, name: str, arguments: list[str], others: Mapping[str, str] | None = None) -> None:
        environment = {**self.environment, **(others or {})}
        self.running[name] = started_program(arguments, environment, self.folder / f"{name}.log")


@contextmanager
def dask_cluster(settings: Settings, folder: Path, workers: int) -> Iterator[DaskCluster]:
    """Yield a running cluster for a deployment, and end it."""
    folder.mkdir(parents=True, exist_ok=True)
    environment = {**environment_of(settings), "TMPDIR": str(folder)}
    cluster = DaskCluster(environment, folder, free_port())
    try:
        cluster.start_scheduler()
        cluster.start_workers(workers)
        yield cluster
    finally:
        for name in list(cluster.running):
            cluster.kill(name)


def _listens(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
    except OSError:
        return False
    return True
