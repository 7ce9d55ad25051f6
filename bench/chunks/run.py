"""Uploads of 1 MB from 16 clients on both databases, beside files that are only written and forced to the disk.

With ``--raw files s3`` also into a bucket of the tests' S3 server, which shares machine and disk with the service.
"""

from __future__ import annotations

import argparse
import itertools
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console

from api.factory import open_store
from api.settings import Settings
from bench.api.servers import new_key, served
from bench.chunks.sending import Uploaded, chunk, forced_writes_ms, upload_all
from bench.results_page import markdown_table, write_page
from fleet_db.migrate import upgrade
from tests.postgres_server import SAFE, stoppable_server
from tests.s3_server import running_s3_server

CLIENTS, SIZE, COUNT, WARM = 16, 1_000_000, 800, 50
REACH_MS = 200.0
COLUMNS = (
    "database",
    "raw",
    "processes",
    "p50 ms",
    "p99 ms",
    "worst ms",
    "chunks/s",
    "p99 / forced write",
    "reach",
    "met",
)


def main(arguments: Sequence[str]) -> int:
    """Send, print and write the page; return 1 where p99 falls short."""
    parser = argparse.ArgumentParser(prog="python -m bench chunks", description=__doc__)
    parser.add_argument("--clients", type=int, default=CLIENTS)
    parser.add_argument("--size", type=int, default=SIZE, help="bytes of a chunk")
    parser.add_argument("--count", type=int, default=COUNT, help="chunks of a run")
    parser.add_argument("--workers", type=int, nargs="+", default=[1], help="processes of the service, a run each")
    parser.add_argument("--databases", nargs="+", default=["sqlite", "postgresql"], choices=["sqlite", "postgresql"])
    parser.add_argument("--raw", nargs="+", default=["files"], choices=["files", "s3"], help="where chunks are kept")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/chunks.md")
    options = parser.parse_args(arguments)
    console, rows = Console(), []
    for raw, database, workers in itertools.product(options.raw, options.databases, options.workers):
        with _raw(raw):
            found, forced = measure(database, workers, options.clients, options.size, options.count)
        rows.append(_row(database, raw, workers, found, forced))
        line = "  ".join(f"{title} {cell}" for title, cell in zip(COLUMNS, rows[-1], strict=True))
        console.print(f"{line}  answers {found.statuses}  CPU of the senders {found.cpu_s:.1f} s", soft_wrap=True)
    if options.write_docs:
        console.print(f"wrote {_page(rows, options.clients, options.size, options.count)}", soft_wrap=True)
    return 0 if all(row[-1] == "yes" for row in rows) else 1


def measure(
    database: str, workers: int = 1, clients: int = CLIENTS, size: int = SIZE, count: int = COUNT
) -> tuple[Uploaded, float]:
    """Return the uploads of one run, and the p99 in ms of files that are only written and forced to the same disk.

    Args:
        database: ``sqlite`` or ``postgresql``.
        clients, size, count: Senders at the same time, bytes of a chunk, chunks in all.
    """
    with _database(database) as (folder, url):
        settings = Settings(data_dir=folder, database_url=url, _env_file=None)
        upgrade(settings.url)
        storage = open_store(settings)
        try:
            key = new_key(storage)
        finally:
            storage.close()
        with served(folder, url, workers) as address:
            upload_all(address, key, [chunk(-number - 1 + (1 << 40), size) for number in range(WARM)], clients)
            _, forced = forced_writes_ms(folder, chunk(0, size), clients, count // 4)
            found = upload_all(address, key, [chunk(number, size) for number in range(count)], clients)
        if set(found.statuses) != {201}:
            raise RuntimeError(f"not every chunk was stored: {found.statuses}")
        return found, forced


def _row(database: str, raw: str, workers: int, found: Uploaded, forced: float) -> tuple[str, ...]:
    return (
        database,
        raw,
        str(workers),
        f"{found.p50_ms:.0f}",
        f"{found.p99_ms:.0f}",
        f"{found.worst_ms:.0f}",
        f"{found.per_second:.0f}",
        f"{found.p99_ms / forced:.1f}",
        f"< {REACH_MS:g} ms",
        "yes" if found.p99_ms < REACH_MS else "NO",
    )


@contextmanager
def _raw(kind: str) -> Iterator[None]:
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


@contextmanager
def _database(kind: str) -> Iterator[tuple[Path, str | None]]:
    with tempfile.TemporaryDirectory(prefix="treadwatch-bench-") as name:
        if kind == "sqlite":
            yield Path(name), None
            return
        with stoppable_server(SAFE) as server:
            yield Path(name), server.url


def _page(rows: Sequence[tuple[str, ...]], clients: int, size: int, count: int) -> Path:
    words = (
        f"{count} chunks of {size:,} bytes from {clients} clients on loopback, each sending again as soon as it has "
        "its receipt; from the first byte sent to the answer read. File, directory and database are forced to the "
        "disk. Beside it: files of the same size that as many threads only write and force to the same disk. Written "
        f"{time.strftime('%Y-%m-%d')}."
    )
    body = [words, markdown_table(COLUMNS, rows, right=(2, 3, 4, 5, 6, 7))]
    return write_page("chunks", "Uploads of chunks", "python -m bench chunks --write-docs", body)
