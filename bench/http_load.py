"""Clients that ask again as soon as they are answered, over connections that stay open."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import numpy as np

HEAD_END = b"\r\n\r\n"


@dataclass(slots=True)
class Answers:
    """What clients were answered: latencies, ms, from the first byte sent to the last one read; statuses and sizes."""

    latencies_ms: list[float] = field(default_factory=list)
    statuses: Counter[int] = field(default_factory=Counter)
    bytes_: int = 0
    took_s: float = 0.0
    cpu_s: float = 0.0  # of this process, which asks

    def percentile(self, share: float) -> float:
        """Return a percentile of the latencies, ms."""
        return float(np.percentile(self.latencies_ms, share))

    @property
    def per_second(self) -> float:
        """Answers by the clock."""
        return len(self.latencies_ms) / self.took_s

    @property
    def mean_kb(self) -> float:
        """Size of an answer with its head."""
        return self.bytes_ / len(self.latencies_ms) / 1000.0


@dataclass
class _Round:
    """What all clients of a round share."""

    requests: Sequence[bytes]
    done: asyncio.Future[None]
    sent: int = 0
    answers: Answers = field(default_factory=Answers)

    def next_request(self) -> bytes | None:
        if self.sent == len(self.requests):
            return None
        self.sent += 1
        return self.requests[self.sent - 1]

    def note(self, latency_s: float, status: int, size: int) -> None:
        self.answers.latencies_ms.append(1000.0 * latency_s)
        self.answers.statuses[status] += 1
        self.answers.bytes_ += size
        if len(self.answers.latencies_ms) == len(self.requests) and not self.done.done():
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


def request(method: str, path: str, header: str, content: bytes = b"") -> bytes:
    """Return a request with one more line of header."""
    length = f"Content-Length: {len(content)}\r\nContent-Type: application/octet-stream\r\n" if content else ""
    return f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{header}\r\n{length}\r\n".encode() + content


def ask(url: str, wanted: Mapping[str, Iterable[bytes]], clients: int) -> dict[str, Answers]:
    """Send every request of each name in turn, by clients that wait for their answer before they ask again.

    All are asked over the same connections, so that they share how these fell to the worker processes: a worker that
    got 30 of 50 answers each half as often again, whatever it is asked for.
    """
    return asyncio.run(_ask_all(url, {name: list(requests) for name, requests in wanted.items()}, clients))


async def _ask_all(url: str, wanted: Mapping[str, Sequence[bytes]], clients: int) -> dict[str, Answers]:
    address, loop, found = urlsplit(url), asyncio.get_running_loop(), {}
    opened = [await loop.create_connection(_Client, address.hostname, address.port) for _ in range(clients)]
    for name, requests in wanted.items():
        shared = _Round(requests, loop.create_future())
        began, cpu = time.perf_counter(), time.process_time()
        for _, client in opened:
            client.ask(shared)
        await shared.done
        shared.answers.took_s, shared.answers.cpu_s = time.perf_counter() - began, time.process_time() - cpu
        found[name] = shared.answers
    for transport, _ in opened:
        transport.abort()
    return found
