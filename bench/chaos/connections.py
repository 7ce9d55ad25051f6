"""Clients that open connections and do not use them, beside those that do: a real server, few and many files."""

from __future__ import annotations

import re
import resource
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.request import urlopen

from api.settings import Settings
from bench.chaos.run import ChaosSettings
from bench.report import BenchRow
from bench.services import START_S, answers, environment_of, free_port, started_program, until
from fleet_db.migrate import upgrade

TIMEOUT_S = 2.0
"""Of headers and of bodies in this run; the product's own are longer."""
FEW_FILES = 256
MANY = 1000
"""Connections from which on a server with the usual number of files is tried, too."""
ASKED = 20
INVENTED = 200
MOST_LOG_BYTES = 500
HALVES = (
    b"",
    b"GET /v1/fleets HTTP/1.1\r\nHost: chaos\r\nX-Half: ",
    b"POST /v1/alerts/1/acknowledge HTTP/1.1\r\nHost: chaos\r\nIf-Match: *\r\nContent-Length: 99\r\n\r\n{",
)
SERVE = "import resource; limit = {}; limit and resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit)); "
SERVE += "import sys; sys.argv = ['treadwatch', 'serve']; from api.cli import main; main()"


@dataclass(frozen=True, slots=True)
class _Server:
    address: tuple[str, int]
    log: Path

    def seconds_of(self, path: str) -> float:
        """Return how long an answer took; it must be a good one."""
        began = time.perf_counter()
        with urlopen(f"http://{self.address[0]}:{self.address[1]}{path}", timeout=60) as answer:
            answer.read()
        return time.perf_counter() - began


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Yield what clients that wait for nothing do to those that ask something.

    ``size`` is the number of connections.
    """
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = settings.size + 100
    resource.setrlimit(resource.RLIMIT_NOFILE, (wanted if most == resource.RLIM_INFINITY else min(most, wanted), most))
    for descriptors in (FEW_FILES, None) if settings.size >= MANY else (FEW_FILES,):
        folder = settings.folder / str(descriptors)
        folder.mkdir()
        with _serving(folder, descriptors) as server:
            named = f"{settings.size:,} half-open connections, {descriptors or 'the usual'} descriptors"
            yield from _half_open(server, settings.size, named)
            if descriptors == FEW_FILES:
                yield _labels(server)


def _half_open(server: _Server, size: int, named: str) -> Iterator[BenchRow]:
    server.seconds_of("/healthz")
    took, held = [], []
    for number in range(size):
        connection = socket.create_connection(server.address, timeout=30)
        connection.sendall(HALVES[number % len(HALVES)])
        held.append(connection)
        if number % max(1, size // ASKED) == 0:
            took.append(server.seconds_of("/healthz"))
    took += [server.seconds_of("/healthz") for _ in range(ASKED)]
    yield BenchRow(f"/healthz beside {named}", f"{max(took):.3f} s at most", "< 1 s", max(took) < 1.0)
    listed = server.seconds_of("/v1/fleets")
    yield BenchRow(f"/v1/fleets beside {named}", f"{listed:.3f} s", "< 1 s", listed < 1.0)
    left = _open_after(held, TIMEOUT_S + 5.0)
    yield BenchRow(f"{named}: open 5 s after the timeout", f"{left}", "0", left == 0)
    each = server.log.stat().st_size / size
    yield BenchRow(f"{named}: log", f"{each:.0f} bytes each", f"< {MOST_LOG_BYTES}", each < MOST_LOG_BYTES)
    answered = server.seconds_of("/readyz")
    yield BenchRow(f"{named}: /readyz afterwards", f"{answered:.3f} s", "< 1 s", answered < 1.0)


def _open_after(held: list[socket.socket], seconds: float) -> int:
    """Return how many the server has not closed after ``seconds``, and close them."""
    until = time.monotonic() + seconds
    left = 0
    for connection in held:
        connection.settimeout(max(0.01, until - time.monotonic()))
        try:
            while connection.recv(65536):
                pass
        except TimeoutError:
            left += 1
        except ConnectionError:
            pass
        connection.close()
    return left


def _labels(server: _Server) -> BenchRow:
    for number in range(INVENTED):
        with socket.create_connection(server.address, timeout=30) as connection:
            connection.sendall(f"M{number} /v1/fleets HTTP/1.1\r\nHost: chaos\r\nConnection: close\r\n\r\n".encode())
            while connection.recv(65536):
                pass
    with urlopen("http://{}:{}/metrics".format(*server.address), timeout=60) as answer:  # noqa: S310 - our own server
        methods = set(re.findall(r'method="([^"]+)"', answer.read().decode()))
    measured = f"{len(methods)} values of the label method"
    return BenchRow(f"{INVENTED} invented methods", measured, "at most 10", len(methods) <= 10)


@contextmanager
def _serving(folder: Path, descriptors: int | None) -> Iterator[_Server]:
    url, port = f"sqlite:///{(folder / 'treadwatch.sqlite').resolve()}", free_port()
    upgrade(url)
    timeouts = {"header_timeout_s": TIMEOUT_S, "body_timeout_s": TIMEOUT_S}
    settings = Settings.model_validate({"data_dir": folder, "database_url": url, "port": port, **timeouts})
    log = folder / "log"
    process = started_program(["-c", SERVE.format(descriptors)], environment_of(settings), log)
    try:
        assert until(lambda: answers(f"http://127.0.0.1:{port}/readyz"), START_S) is not None, log.read_text()
        yield _Server(("127.0.0.1", port), log)
    finally:
        process.terminate()
        process.wait(60)
