"""Clients that send chunks one after the other, each over a connection of its own, and the time of each upload."""

from __future__ import annotations

import asyncio
import hashlib
import os
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

HEAD_END = b"\r\n\r\n"


@dataclass(frozen=True)
class Uploaded:
    """Uploads of one run: latencies in ms from the first byte sent to the answer read, and what was answered.

    ``cpu_s`` is the processor time of the senders in this process.
    """

    p50_ms: float
    p99_ms: float
    worst_ms: float
    per_second: float
    statuses: dict[int, int]
    cpu_s: float


def chunk(number: int, size_bytes: int) -> bytes:
    """Return the bytes of a chunk; those of every number are others.

    Args:
        size_bytes: At least 8.
    """
    return number.to_bytes(8, "little") + np.random.default_rng(size_bytes).bytes(size_bytes - 8)


def upload_all(address: str, header: str, chunks: Sequence[bytes], clients: int) -> Uploaded:
    """Send chunks from several clients at the same time, each chunk once.

    Args:
        clients: How many send at the same time.
    """
    requests = [_request(content, header) for content in chunks]  # digests are made before the clock starts
    return asyncio.run(_upload_all(address, requests, clients))


def forced_writes_ms(folder: Path, content: bytes, writers: int, count: int) -> tuple[float, float]:
    """Return median and p99, ms, of writing files of this content and forcing them to the disk, without a service.

    Args:
        writers: Threads that write at the same time.
        count: Files in all.
    """

    def write(_number: int) -> float:
        began = time.perf_counter()
        handle, name = tempfile.mkstemp(dir=folder)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        took = time.perf_counter() - began
        Path(name).unlink()
        return took * 1000.0

    with ThreadPoolExecutor(writers) as threads:
        found = list(threads.map(write, range(count)))
    return float(np.median(found)), float(np.percentile(found, 99.0))


def _request(content: bytes, header: str) -> bytes:
    digest = hashlib.sha256(content).hexdigest()
    head = (
        f"PUT /v1/chunks/{digest}?vehicle=BENCH&format=blf HTTP/1.1\r\nHost: 127.0.0.1\r\n{header}\r\n"
        f"Content-Type: application/octet-stream\r\nContent-Length: {len(content)}"
    )
    return head.encode() + HEAD_END + content


async def _upload_all(address: str, requests: Sequence[bytes], clients: int) -> Uploaded:
    parts = urlsplit(address)
    left = list(reversed(requests))
    latencies: list[float] = []
    statuses: dict[int, int] = {}

    async def send() -> None:
        reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
        while left:
            request = left.pop()
            began = time.perf_counter()
            writer.write(request)
            await writer.drain()
            status = await _answer(reader)
            latencies.append((time.perf_counter() - began) * 1000.0)
            statuses[status] = statuses.get(status, 0) + 1
        writer.close()

    began, cpu = time.perf_counter(), time.process_time()
    await asyncio.gather(*(send() for _ in range(clients)))
    took, cpu = time.perf_counter() - began, time.process_time() - cpu
    p50, p99 = np.percentile(latencies, [50.0, 99.0])
    return Uploaded(float(p50), float(p99), max(latencies), len(latencies) / took, statuses, cpu)


async def _answer(reader: asyncio.StreamReader) -> int:
    head = (await reader.readuntil(HEAD_END)).decode()
    size = next(int(line.split(":")[1]) for line in head.splitlines() if line.lower().startswith("content-length:"))
    await reader.readexactly(size)
    return int(head.split(" ", 2)[1])
