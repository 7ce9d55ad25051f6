"""Clients that ask again as soon as they are answered, over connections that stay open."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
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


def request(method: str, path: str, header: str, content: bytes = b"") -> bytes:
    """Return a request with one more line of header."""
    length = f"Content-Length: {len(content)}\r\nContent-Type: application/octet-stream\r\n" if content else ""
    return f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{header}\r\n{length}\r\n".encode() + content


def ask(url: str, wanted: Mapping[str, Iterable[bytes]], clients: int) -> dict[str, Answers]:
    """Send every request of each name in turn, by clients that wait for their answer before they ask again.

    All are asked over the same connections, so that they share how these fell to the worker processes: a worker that
    got 30 of 50 answers each half as often again, whatever it is asked for.
    """
    return asyncio.run(_ask_all(url, wanted, clients))


async def _ask_all(url: str, wanted: Mapping[str, Iterable[bytes]], clients: int) -> dict[str, Answers]:
    address, found = urlsplit(url), {name: Answers() for name in wanted}
    opened = [await asyncio.open_connection(address.hostname, address.port, limit=1 << 20) for _ in range(clients)]
    for name, requests in wanted.items():
        answers, left = found[name], iter(requests)
        began, cpu = time.perf_counter(), time.process_time()
        await asyncio.gather(*(_client(*connection, left, answers) for connection in opened))
        answers.took_s, answers.cpu_s = time.perf_counter() - began, time.process_time() - cpu
    for _, writer in opened:
        writer.transport.abort()
    return found


async def _client(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, left: Iterator[bytes], answers: Answers
) -> None:
    """Ask what is left, one request after the other; the server must send Content-Length."""
    for content in left:
        began = time.perf_counter()
        writer.write(content)
        head = (await reader.readuntil(HEAD_END)).lower()
        length = int(head.partition(b"content-length:")[2].split(b"\r\n", 1)[0] or b"0")
        await reader.readexactly(length)
        answers.latencies_ms.append(1000.0 * (time.perf_counter() - began))
        answers.statuses[int(head[9:12])] += 1
        answers.bytes_ += len(head) + length
