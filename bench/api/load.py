"""Clients that ask again as soon as they are answered, over connections that stay open."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from urllib.parse import urlsplit

HEAD_END = b"\r\n\r\n"


@dataclass(frozen=True)
class Percentiles:
    """Latencies of one endpoint in one round, in milliseconds, and how fast it was served."""

    p50_ms: float
    p99_ms: float
    per_second: float
    refused: int
    mean_bytes: float


@dataclass
class _Round:
    """What all clients of a round share."""

    requests: Sequence[bytes]
    done: asyncio.Future[None]
    sent: int = 0
    latencies_s: list[float] = field(default_factory=list)
    statuses: list[int] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)

    def next_request(self) -> bytes | None:
        if self.sent == len(self.requests):
            return None
        self.sent += 1
        return self.requests[self.sent - 1]

    def note(self, latency_s: float, status: int, size: int) -> None:
        self.latencies_s.append(latency_s)
        self.statuses.append(status)
        self.sizes.append(size)
        if len(self.latencies_s) == len(self.requests) and not self.done.done():
            self.done.set_result(None)


class _Client(asyncio.Protocol):
    """One connection; its server must send Content-Length."""

    def __init__(self) -> None:
        self.shared: _Round | None = None
        self.buffer = bytearray()
        self.expected = -1
        self.status = 0
        self.began = 0.0
        self.transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport  # type: ignore[assignment] # a stream transport

    def connection_lost(self, exc: Exception | None) -> None:
        if self.shared is not None and not self.shared.done.done():
            self.shared.done.set_exception(exc or ConnectionError("the server closed a connection"))

    def data_received(self, data: bytes) -> None:
        self.buffer += data
        if self.expected < 0:
            end = self.buffer.find(HEAD_END)
            if end < 0:
                return
            head = bytes(self.buffer[:end]).lower()
            self.status = int(head[9:12])
            length = head.partition(b"content-length:")[2].split(b"\r\n", 1)[0]
            self.expected = end + len(HEAD_END) + int(length or b"0")
        if len(self.buffer) >= self.expected and self.shared is not None:
            size = self.expected
            self.buffer.clear()
            self.expected = -1
            self.shared.note(time.perf_counter() - self.began, self.status, size)
            self.ask(self.shared)

    def ask(self, shared: _Round) -> None:
        self.shared = shared
        request = shared.next_request()
        if request is not None and self.transport is not None:
            self.began = time.perf_counter()
            self.transport.write(request)


def ask(
    url: str, wanted: Mapping[str, Sequence[str]], clients: int, headers: Sequence[str] = ()
) -> dict[str, Percentiles]:
    """Ask for every path of each endpoint in turn, by clients that wait for their answer before they ask again.

    All endpoints are asked over the same connections, so that they share how these fell to the worker processes: a
    worker that got 30 of 50 answers each half as often again, whatever it is asked for.

    Args:
        wanted: What to ask for, under the name of the endpoint.
        clients: Connections at the same time.
        headers: Lines that every request has.
    """
    return asyncio.run(_ask_all(url, wanted, clients, headers))


async def _ask_all(
    url: str, wanted: Mapping[str, Sequence[str]], clients: int, headers: Sequence[str]
) -> dict[str, Percentiles]:
    address = urlsplit(url)
    lines = "".join(f"{line}\r\n" for line in (f"Host: {address.netloc}", *headers))
    loop = asyncio.get_running_loop()
    opened = [await loop.create_connection(_Client, address.hostname, address.port) for _ in range(clients)]
    found = {}
    for name, paths in wanted.items():
        shared = _Round([f"GET {path} HTTP/1.1\r\n{lines}\r\n".encode() for path in paths], loop.create_future())
        began = time.perf_counter()
        for _, client in opened:
            client.ask(shared)
        await shared.done
        found[name] = _percentiles(shared, time.perf_counter() - began)
    for transport, _ in opened:
        transport.abort()
    return found


def _percentiles(shared: _Round, took_s: float) -> Percentiles:
    sorted_ms = sorted(1000.0 * latency for latency in shared.latencies_s)
    return Percentiles(
        p50_ms=_quantile(sorted_ms, 0.5),
        p99_ms=_quantile(sorted_ms, 0.99),
        per_second=len(sorted_ms) / took_s,
        refused=sum(status >= 300 for status in shared.statuses),
        mean_bytes=sum(shared.sizes) / len(shared.sizes),
    )


def _quantile(ordered: Sequence[float], share: float) -> float:
    return ordered[min(len(ordered) - 1, round(share * (len(ordered) - 1)))]
