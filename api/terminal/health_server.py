"""Health and metrics of a process that serves nothing else, on a port of its own: plain HTTP for probes."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import socket
from typing import Any

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import Metric

from api.measures import Measured
from estimation.errors import ParameterError

REQUEST_TIMEOUT_S = 5.0
CONNECTIONS = 16  # at a time; more are closed at once, so that nobody can use up the descriptors of the process

Answer = tuple[HTTPStatus, str, bytes]


@dataclass(frozen=True, slots=True)
class HealthAddress:
    """Where the health endpoint listens; port 0 takes a free one."""

    host: str
    port: int


@contextmanager
def served(
    address: HealthAddress,
    healthz: Callable[[], Answer],
    readyz: Callable[[], Answer],
    measures: Sequence[Callable[[], Iterable[Metric]]],
) -> Iterator[int]:
    """Serve ``/healthz``, ``/readyz`` and ``/metrics`` from threads of their own; yield the port."""
    registry = registry_of(*measures)
    answers: dict[str, Callable[[], Answer]] = {
        "/healthz": healthz,
        "/readyz": readyz,
        "/metrics": lambda: (HTTPStatus.OK, CONTENT_TYPE_LATEST, generate_latest(registry)),
    }
    try:
        server = _Server((address.host, address.port), partial(_Handler, answers))
    except (OSError, OverflowError) as error:
        where = f"{address.host}:{address.port}"
        raise ParameterError(f"nobody can listen on {where}: {error}", field="--health-port") from error
    thread = threading.Thread(target=server.serve_forever, name="health", daemon=True)
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()


def json_answer(well: bool, facts: Mapping[str, object]) -> Answer:  # noqa: FBT001 - the answer's first word
    """Return an answer: whether all is well, with status 503 where it is not, and the facts."""
    code = HTTPStatus.OK if well else HTTPStatus.SERVICE_UNAVAILABLE
    body = {"status": "ok" if well else "failing", **facts}
    return code, "application/json", json.dumps(body).encode()


def registry_of(*measures: Callable[[], Iterable[Metric]]) -> CollectorRegistry:
    """Return the registry of measures that are read when they are asked for."""
    registry = CollectorRegistry()
    for read in measures:
        registry.register(Measured(read))
    return registry


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self, address: tuple[str, int], handler: Callable[..., BaseHTTPRequestHandler]) -> None:
        self._free = threading.BoundedSemaphore(CONNECTIONS)
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:  # noqa: ANN401 - as in socketserver
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:  # noqa: ANN401 - as in socketserver
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: socket | tuple[bytes, socket], client_address: Any) -> None:  # noqa: ANN401 - the same
        """Let a client that went away go."""


class _Handler(BaseHTTPRequestHandler):
    timeout = REQUEST_TIMEOUT_S
    server_version = "treadwatch"
    sys_version = ""

    def __init__(self, answers: Mapping[str, Callable[[], Answer]], *arguments: Any) -> None:  # noqa: ANN401 - the same
        self._answers = answers
        super().__init__(*arguments)

    def do_GET(self) -> None:
        """Answer a request."""
        answer = self._answers.get(self.path.partition("?")[0])
        code, kind, body = answer() if answer else (HTTPStatus.NOT_FOUND, "text/plain", b"not found\n")
        self.send_response(code)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_arguments: object) -> None:
        """Say nothing: probes come all the time."""
