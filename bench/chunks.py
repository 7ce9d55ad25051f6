"""Uploads of 1 MB from 16 clients on both databases: ``python -m bench chunks``.

Beside them files that are only written and forced to the disk. With ``--raw files s3`` also into a bucket of the tests'
S3 server, which shares machine and disk with it.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import os
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from bench.http_load import ask, request
from bench.report import Bench, Part, ResultTable, say
from bench.served import filled_database, served
from bench.services import DATABASES
from tests.s3_server import running_s3_server

WARM = 50
REACH_MS = 200.0
COLUMNS = (
    *("database", "raw", "processes", "p50 ms", "p99 ms", "worst ms", "chunks/s", "p99 / forced write", "reach", "met"),
)


def _parts(options: argparse.Namespace, _folder: Path) -> Iterator[Part]:
    chosen = itertools.product(options.raw, options.databases, options.workers)
    rows = [_upload_row(raw, database, workers, options) for raw, database, workers in chosen]
    yield (
        f"{options.count} chunks of {options.size:,} bytes from {options.clients} clients on loopback, each sending"
        " again as soon as it has its receipt; from the first byte sent to the answer read. File, directory and"
        " database are forced to the disk. Beside it: files of the same size that as many threads only write and"
        f" force to the same disk. Written {time.strftime('%Y-%m-%d')}."
    )
    yield ResultTable(COLUMNS, rows, (2, 3, 4, 5, 6, 7))


def _upload_row(raw: str, database: str, workers: int, options: argparse.Namespace) -> tuple[str, ...]:
    clients, size, count = options.clients, options.size, options.count
    with _raw_store(raw), filled_database(database) as (folder, url, key), served(folder, url, workers) as address:
        first = range(1 << 40, (1 << 40) + WARM)
        ask(address, {"warm": [_upload(_chunk(number, size), key) for number in first]}, clients)
        forced_ms = _forced_writes_ms(folder, _chunk(0, size), clients, count // 4)
        found = ask(address, {"all": [_upload(_chunk(number, size), key) for number in range(count)]}, clients)["all"]
    if set(found.statuses) != {201}:
        raise RuntimeError(f"not every chunk was stored: {dict(found.statuses)}")
    say(f"{database}, {raw}: CPU of the senders {found.cpu_s:.1f} s")
    p99 = found.percentile(99)
    return (
        database,
        raw,
        str(workers),
        f"{found.percentile(50):.0f}",
        f"{p99:.0f}",
        f"{max(found.latencies_ms):.0f}",
        f"{found.per_second:.0f}",
        f"{p99 / forced_ms:.1f}",
        f"< {REACH_MS:g} ms",
        "yes" if p99 < REACH_MS else "NO",
    )


def _chunk(number: int, size: int) -> bytes:
    """Return the bytes of a chunk; those of every number are others."""
    return number.to_bytes(8, "little") + np.random.default_rng(size).bytes(size - 8)


def _upload(content: bytes, key: str) -> bytes:
    digest = hashlib.sha256(content).hexdigest()
    return request("PUT", f"/v1/chunks/{digest}?vehicle=BENCH&format=blf", key, content)


def _forced_writes_ms(folder: Path, content: bytes, writers: int, count: int) -> float:
    """Return the p99, ms, of writing files of this content and forcing them to the disk, without a service."""

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
        return float(np.percentile(list(threads.map(write, range(count))), 99.0))


@contextmanager
def _raw_store(kind: str) -> Iterator[None]:
    """Let services that are started in the block keep raw recordings in files, or in a bucket of a server."""
    if kind == "files":
        yield
        return
    with running_s3_server() as server:
        given = server.environment("bench")
        os.environ.update(given)
        try:
            yield
        finally:
            for name in given:
                del os.environ[name]


main = Bench(
    "chunks",
    "Uploads of chunks",
    __doc__ or "",
    _parts,
    {
        "clients": (16, "that send"),
        "size": (1_000_000, "bytes of a chunk"),
        "count": (800, "chunks of a run"),
        "workers": ([1], "processes of the service, a run each"),
        "databases": (list(DATABASES), "that are written to", DATABASES),
        "raw": (["files"], "where chunks are kept", ("files", "s3")),
    },
).run
