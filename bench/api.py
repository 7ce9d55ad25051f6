"""The service over HTTP: ``python -m bench api`` or ``chunks``.

``api``: latencies of a large fleet's API, beside a bare endpoint of the same server; with ``--fuzz SECONDS``
schemathesis against the running service instead, all checks: what it finds is printed as it prints it.

``chunks``: uploads of 1 MB from 16 clients on both databases, beside files that are only written and forced to the
disk. With ``--raw files s3`` also into a bucket of the tests' S3 server, which shares machine and disk with it.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from api.access.keys import EVERYTHING, Wanted, make_key
from api.factory import open_store
from api.settings import Settings
from bench.http_load import Answers, ask, request
from bench.large_fleet import FleetSize, populate
from bench.report import Part, ResultTable, ended, say
from bench.services import DATABASES, START_S, answers, environment_of, free_port, new_database, started_program, until
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage
from tests.api import populated_fleet
from tests.s3_server import running_s3_server

WORKERS = 2
GENEROUS = {
    "log_level": "warning",
    "requests_per_s": 1e6,
    "requests_burst": 1_000_000,
    "streams_per_key": 1000,
    "failed_keys_per_minute": 6e4,
    "docs": "open",
}
SEED, CLIENTS, ROUNDS, ASKED = 2010, 50, 5, 1500  # requests of one endpoint in one round
BARE = "bare"
COLUMNS = ("database", "endpoint", "p50 ms", "p99 ms", "requests/s", "kB", "p99 / bare", "reach", "met")
SENDERS, SIZE, COUNT, WARM = 16, 1_000_000, 800, 50
REACH_MS = 200.0
CHUNK_COLUMNS = (
    *("database", "raw", "processes", "p50 ms", "p99 ms", "worst ms", "chunks/s", "p99 / forced write", "reach", "met"),
)
SCHEMATHESIS = Path(__file__).with_name("schemathesis.toml")


def new_key(storage: SqlStorage) -> str:
    """Make a key that may everything, and return the header line that carries it."""
    wanted = Wanted(owner="bench", scopes=EVERYTHING, fleets=None, expires_ns=None)
    with storage.write() as unit:
        _, token = make_key(unit, wanted, "bench", time.time_ns())
    return f"Authorization: Bearer {token}"


@contextmanager
def served(folder: Path, database_url: str | None, workers: int = WORKERS) -> Iterator[str]:
    """Yield the URL of a running service over a migrated database; None for SQLite in the folder."""
    port = free_port()
    settings = Settings.model_validate({"data_dir": folder, "database_url": database_url, **GENEROUS})
    command = ["-m", "uvicorn", "--factory", "api.asgi:app", "--port", str(port), "--workers", str(workers)]
    command += ["--no-access-log", "--log-level", "warning"]
    environment = environment_of(settings) | {"TREADWATCH_ACCESS": "keys"}  # also where it is open for the bench itself
    process = started_program(command, environment, folder / "service.log")
    url = f"http://127.0.0.1:{port}"
    try:
        if until(lambda: answers(f"{url}/readyz") or process.poll() is not None, START_S) is None or process.poll():
            raise RuntimeError((folder / "service.log").read_text())
        yield url
    finally:
        process.terminate()
        process.wait(30)


@contextmanager
def filled_database(kind: str, size: FleetSize | None = None) -> Iterator[tuple[Path, str | None, str]]:
    """Yield folder and URL of a migrated database, with a large fleet where its size is given, and a key."""
    with new_database(kind) as (folder, url):
        settings = Settings(data_dir=folder, database_url=url, _env_file=None)
        upgrade(settings.url)
        with closing(open_store(settings)) as storage:
            if size is not None:
                took = populate(storage, size, SEED, time.time_ns())
                say(f"{kind}: {size.wheelsets} wheelsets, {size.days} days, filled in {took:.0f} s")
            key = new_key(storage)
        yield folder, url, key


@dataclass(frozen=True)
class Endpoint:
    """What is asked for, and how much longer than the bare endpoint its p99 may take; None where nothing is set."""

    name: str
    template: str
    reach: float | None

    def requests(self, size: FleetSize, random: np.random.Generator, count: int, key: str) -> list[bytes]:
        """Return the requests of a round; each names a wheelset drawn from all."""
        serials = (size.serial(int(one)) for one in random.integers(size.wheelsets, size=count))
        return [request("GET", self.template.format(serial=serial), key) for serial in serials]


ENDPOINTS = (
    Endpoint(BARE, "/healthz", None),
    Endpoint("trend", "/v1/wheelsets/{serial}/trend", 3.0),
    Endpoint("alert list", "/v1/alerts?open=true", 3.0),
    Endpoint("feed page", "/v1/alerts/feed", 3.0),
    Endpoint("worklist of all, sorted", "/v1/wheelsets?sort=distance_to_limit", 6.0),
)


def main(arguments: Sequence[str]) -> int:
    """Fill both databases, ask, print and write the page; return 1 where a figure falls short."""
    parser = argparse.ArgumentParser(prog="python -m bench api", description=__doc__)
    parser.add_argument("--vehicles", type=int, default=1000, help="of 4 wheelsets each")
    parser.add_argument("--days", type=int, default=365, help="of daily geometry")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--asked", type=int, default=ASKED, help="requests of an endpoint in a round")
    parser.add_argument("--databases", nargs="+", default=list(DATABASES), choices=DATABASES)
    parser.add_argument("--fuzz", type=int, default=0, metavar="SECONDS", help="run schemathesis instead, for so long")
    parser.add_argument("--report", default="schemathesis-report", help="folder of its report")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/api.md")
    options = parser.parse_args(arguments)
    if options.fuzz:
        return _fuzz(options.fuzz, Path(options.report))
    size, rows = FleetSize(vehicles=options.vehicles, days=options.days), list[tuple[str, ...]]()
    for database in options.databases:
        with filled_database(database, size) as (folder, url, key), served(folder, url) as address:
            rows += _measure(address, key, database, size, options)
    words = (
        f"{size.vehicles} vehicles, {size.wheelsets} wheelsets, {size.days} days of daily geometry (seed {SEED}). "
        f"uvicorn with 2 workers, {CLIENTS} clients on loopback that ask again as soon as they are answered. Medians "
        "over rounds in which every endpoint is asked in turn over the same connections; the bare one is `/healthz`."
    )
    parts: list[Part] = [words, ResultTable(COLUMNS, rows, (2, 3, 4, 5, 6))]
    return ended(parts, "api", "The API under load", "make bench-api" if options.write_docs else None)


def _measure(
    address: str, key: str, database: str, size: FleetSize, options: argparse.Namespace
) -> list[tuple[str, ...]]:
    """Return one row an endpoint: the medians over rounds in which every endpoint is asked in turn."""
    random = np.random.default_rng(SEED)
    found: dict[str, list[Answers]] = {endpoint.name: [] for endpoint in ENDPOINTS}
    for number in range(options.rounds + 1):
        wanted = {endpoint.name: endpoint.requests(size, random, options.asked, key) for endpoint in ENDPOINTS}
        for name, seen in ask(address, wanted, CLIENTS).items():
            if max(seen.statuses) >= 300:
                raise RuntimeError(f"{name}: answers are refusals: {dict(seen.statuses)}")
            if number:  # the first round warms caches
                found[name].append(seen)
    return [_row(database, endpoint, found) for endpoint in ENDPOINTS]


def _row(database: str, endpoint: Endpoint, found: Mapping[str, Sequence[Answers]]) -> tuple[str, ...]:
    own, median = found[endpoint.name], statistics.median
    ratio = median(one.percentile(99) / bare.percentile(99) for one, bare in zip(own, found[BARE], strict=True))
    return (
        database,
        endpoint.name,
        f"{median(one.percentile(50) for one in own):.1f}",
        f"{median(one.percentile(99) for one in own):.1f}",
        f"{median(one.per_second for one in own):.0f}",
        f"{median(one.mean_kb for one in own):.1f}",
        f"{ratio:.2f}",
        "" if endpoint.reach is None else f"at most {endpoint.reach:g}",
        "" if endpoint.reach is None else ("yes" if ratio <= endpoint.reach else "NO"),
    )


def _fuzz(seconds: int, report: Path) -> int:
    """Ask whatever the document allows and forbids; return how schemathesis ended, 0 where it found nothing."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-fuzz-") as name:
        settings = Settings(data_dir=Path(name), _env_file=None)
        upgrade(settings.url)
        with closing(open_store(settings)) as storage:
            populated_fleet.populate(storage)
            key = new_key(storage)
        with served(Path(name), None, workers=1) as url:
            command = [sys.executable, "-m", "schemathesis.cli", "--config-file", str(SCHEMATHESIS)]
            command += ["run", f"{url}/openapi.json", "--checks", "all"]
            command += ["--max-time", str(seconds), "--seed", str(SEED), "--continue-on-failure"]
            command += ["--report", "junit", "--report-dir", str(report), "--suppress-health-check", "all"]
            # its configuration reads the key there, and its libraries warn
            own = {"PYTHONWARNINGS": "ignore", "TREADWATCH_KEY": key.removeprefix("Authorization: Bearer ")}
            return subprocess.run(command, check=False, env={**os.environ, **own}).returncode  # noqa: S603 - ours


@dataclass(frozen=True, slots=True)
class ChunkBench:
    """Uploads of chunks."""

    name: str = "chunks"

    def run(self, arguments: Sequence[str]) -> int:
        """Send, print and write the page; return 1 where p99 falls short."""
        parser = argparse.ArgumentParser(prog="python -m bench chunks", description=__doc__)
        parser.add_argument("--clients", type=int, default=SENDERS)
        parser.add_argument("--size", type=int, default=SIZE, help="bytes of a chunk")
        parser.add_argument("--count", type=int, default=COUNT, help="chunks of a run")
        parser.add_argument("--workers", type=int, nargs="+", default=[1], help="processes of the service, a run each")
        parser.add_argument("--databases", nargs="+", default=list(DATABASES), choices=DATABASES)
        parser.add_argument("--raw", nargs="+", default=["files"], choices=["files", "s3"], help="where they are kept")
        parser.add_argument("--write-docs", action="store_true", help="write docs/results/chunks.md")
        options = parser.parse_args(arguments)
        chosen = itertools.product(options.raw, options.databases, options.workers)
        rows = [_upload_row(raw, database, workers, options) for raw, database, workers in chosen]
        words = (
            f"{options.count} chunks of {options.size:,} bytes from {options.clients} clients on loopback, each sending"
            " again as soon as it has its receipt; from the first byte sent to the answer read. File, directory and"
            " database are forced to the disk. Beside it: files of the same size that as many threads only write and"
            f" force to the same disk. Written {time.strftime('%Y-%m-%d')}."
        )
        parts: list[Part] = [words, ResultTable(CHUNK_COLUMNS, rows, (2, 3, 4, 5, 6, 7))]
        command = "python -m bench chunks --write-docs" if options.write_docs else None
        return ended(parts, "chunks", "Uploads of chunks", command)


BENCHES = (ChunkBench(),)


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
