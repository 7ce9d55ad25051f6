"""Health and metrics of a live receiver, on a port of its own: plain HTTP for a probe and for Prometheus."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import socket
from types import MappingProxyType
from typing import Any

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from estimation.errors import ParameterError
from ingest.live.status import LiveStatus

PREFIX = "treadwatch_live_"
REQUEST_TIMEOUT_S = 5.0
CONNECTIONS = 16
"""At a time; more are closed at once, so that nobody can use up the descriptors of the receiver."""

COUNTERS: Mapping[str, str] = MappingProxyType(
    {
        "frames_received": "Frames taken off the bus.",
        "frames_unreadable": "Frames left out because they are none of a classic CAN bus.",
        "frames_spooled": "Frames that reached the disk.",
        "frames_lost_by_bus": "Frames dropped before they came to this process, since its start.",
        "frames_dropped": "Frames of this vehicle that were dropped, also before this start.",
        "frames_rejected": "Frames of pieces that were rejected, so that no window is made of them.",
        "pieces_stored": "Pieces that have their receipt.",
        "pieces_rejected": "Pieces that were stored and rejected.",
    }
)
GAUGES: Mapping[str, str] = MappingProxyType(
    {
        "buffered_bytes": "Frames in memory that are not on the disk yet.",
        "spool_bytes": "Frames on the disk without a receipt.",
        "spool_limit_bytes": "How much the spool may hold.",
        "pieces_waiting": "Pieces without a receipt.",
        "rejected_in_a_row": "Pieces rejected since one was decoded.",
        "pieces_aside": "Pieces that could not be stored whatever was tried.",
    }
)
TIMES: Mapping[str, str] = MappingProxyType(
    {
        "last_frame": "When the last frame came; 0 before the first.",
        "last_receipt": "When the last receipt was committed; 0 before the first.",
        "silent_since": "When the last frame came on a bus that is silent; 0 on one that speaks.",
    }
)

Answer = tuple[HTTPStatus, str, bytes]


@contextmanager
def serving_health(host: str, port: int, statuses: Mapping[str, LiveStatus]) -> Iterator[int]:
    """Serve ``/healthz``, ``/readyz`` and ``/metrics`` from threads of their own; yield the port.

    Parameters
    ----------
    host, port
        Where; port 0 takes a free one.
    statuses
        What is served, by the vehicle.

    Raises
    ------
    ParameterError
        Nobody can listen there.
    """
    registry = registered(statuses)
    answers: dict[str, Callable[[], Answer]] = {
        "/healthz": partial(_health, statuses),
        "/readyz": partial(_readiness, statuses),
        "/metrics": lambda: (HTTPStatus.OK, CONTENT_TYPE_LATEST, generate_latest(registry)),
    }
    try:
        server = _Server((host, port), partial(_Handler, answers))
    except (OSError, OverflowError) as error:
        raise ParameterError(f"nobody can listen on {host}:{port}: {error}", field="--health-port") from error
    thread = threading.Thread(target=server.serve_forever, name="health", daemon=True)
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()


def registered(statuses: Mapping[str, LiveStatus]) -> CollectorRegistry:
    """Return the measures of a receiver.

    Parameters
    ----------
    statuses
        What is measured, by the vehicle.
    """
    registry = CollectorRegistry()
    registry.register(_Measures(statuses))
    return registry


def _health(statuses: Mapping[str, LiveStatus]) -> Answer:
    """Whether every thread runs."""
    alive = all(status.alive for status in statuses.values())
    threads = {
        vehicle: {thread.name: thread.is_alive() for thread in status.threads} for vehicle, status in statuses.items()
    }
    return _json(alive, {"threads": threads})


def _readiness(statuses: Mapping[str, LiveStatus]) -> Answer:
    """Whether frames reach their receipts and can be used; a silent bus is no fault, a vehicle may be switched off."""
    faults = {vehicle: status.faults for vehicle, status in statuses.items()}
    alive = all(status.alive for status in statuses.values())
    silent_s = {vehicle: _silent_s(status) for vehicle, status in statuses.items()}
    bad = {vehicle: found for vehicle, found in faults.items() if found}
    return _json(alive and not bad, {"faults": bad, "silent_for_s": silent_s})


def _silent_s(status: LiveStatus) -> float | None:
    since_s = status.silent_since_s
    return None if since_s is None else round(max(0.0, time.time() - since_s), 1)


def _json(well: bool, facts: Mapping[str, object]) -> Answer:  # noqa: FBT001 - the answer's first word
    code = HTTPStatus.OK if well else HTTPStatus.SERVICE_UNAVAILABLE
    body = {"status": "ok" if well else "failing", **facts}
    return code, "application/json", json.dumps(body).encode()


class _Measures(Collector):
    def __init__(self, statuses: Mapping[str, LiveStatus]) -> None:
        self._statuses = statuses

    def collect(self) -> Iterable[Metric]:
        statuses = self._statuses.items()
        for name, text in COUNTERS.items():
            counter = CounterMetricFamily(f"{PREFIX}{name}", text, labels=["vehicle"])
            for vehicle, status in statuses:
                counter.add_metric([vehicle], getattr(status, name))
            yield counter
        for name, text in GAUGES.items():
            gauge = GaugeMetricFamily(f"{PREFIX}{name}", text, labels=["vehicle"])
            for vehicle, status in statuses:
                gauge.add_metric([vehicle], getattr(status, name))
            yield gauge
        for name, text in TIMES.items():
            stamp = GaugeMetricFamily(f"{PREFIX}{name}_timestamp_seconds", text, labels=["vehicle"])
            for vehicle, status in statuses:
                stamp.add_metric([vehicle], getattr(status, f"{name}_s") or 0.0)
            yield stamp
        up = GaugeMetricFamily(f"{PREFIX}up", "Whether it works.", labels=["vehicle", "what"])
        for vehicle, status in statuses:
            for what in ("bus", "spool", "raw", "database", "recordings"):
                up.add_metric([vehicle, what], 0.0 if what in status.faults else 1.0)
        yield up


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
