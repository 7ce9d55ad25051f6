"""``python -m bench api``: latencies of a large fleet's API, beside a bare endpoint of the same server."""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from api.factory import open_store
from api.settings import Settings
from bench.api.fleet import FleetSize, populate
from bench.api.fuzz import fuzz
from bench.api.load import Percentiles, ask
from bench.api.servers import new_key, served
from bench.results_page import markdown_table, write_page
from fleet_db.migrate import upgrade
from tests.postgres_server import SAFE, stoppable_server

SEED = 2010
CLIENTS = 50
ROUNDS = 5
ASKED = 1500
"""Requests of one endpoint in one round."""
BARE = "bare"
COLUMNS = ("database", "endpoint", "p50 ms", "p99 ms", "requests/s", "kB", "p99 / bare", "reach", "met")


@dataclass(frozen=True)
class Endpoint:
    """What is asked for, and how much longer than the bare endpoint its p99 may take; None where nothing is set."""

    name: str
    template: str
    reach: float | None

    def paths(self, size: FleetSize, random: np.random.Generator, count: int) -> list[str]:
        """Return the paths of a round; each names a wheelset drawn from all."""
        return [
            self.template.format(serial=size.serial(int(one))) for one in random.integers(size.wheelsets, size=count)
        ]


ENDPOINTS = (
    Endpoint(BARE, "/healthz", None),
    Endpoint("trend", "/v1/wheelsets/{serial}/trend", 3.0),
    Endpoint("alert list", "/v1/alerts?open=true", 3.0),
    Endpoint("feed page", "/v1/alerts/feed", 3.0),
    Endpoint("worklist of all, sorted", "/v1/wheelsets?sort=distance_to_limit", 6.0),
)


def main(arguments: Sequence[str]) -> int:
    """Fill both databases, ask, print and write the page; return 1 where a figure falls short."""
    options = _options(arguments)
    if options.fuzz:
        return fuzz(options.fuzz, SEED, Path(options.report))
    size = FleetSize(vehicles=options.vehicles, days=options.days)
    console = Console()
    rows: list[tuple[str, ...]] = []
    for database in options.databases:
        with _database(database) as (folder, url):
            console.print(f"{database}: filling, {size.wheelsets} wheelsets, {size.days} days")
            took, key = _fill(folder, url, size)
            console.print(f"{database}: filled in {took:.0f} s")
            with served(folder, url) as address:
                rows += _measure(address, key, database, size, options.rounds, options.asked, console)
    if options.write_docs:
        page = _page(size, rows)
        console.print(f"wrote {page}", soft_wrap=True)
    return 0 if all(row[-1] != "NO" for row in rows) else 1


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench api", description=__doc__)
    parser.add_argument("--vehicles", type=int, default=1000, help="of 4 wheelsets each")
    parser.add_argument("--days", type=int, default=365, help="of daily geometry")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--asked", type=int, default=ASKED, help="requests of an endpoint in a round")
    parser.add_argument("--databases", nargs="+", default=["sqlite", "postgresql"], choices=["sqlite", "postgresql"])
    parser.add_argument("--fuzz", type=int, default=0, metavar="SECONDS", help="run schemathesis instead, for so long")
    parser.add_argument("--report", default="schemathesis-report", help="folder of its report")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/api.md")
    return parser.parse_args(arguments)


@contextmanager
def _database(kind: str) -> Iterator[tuple[Path, str | None]]:
    """Yield a data folder and the URL of an empty database of this kind; None for the file in the folder."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-bench-") as name:
        if kind == "sqlite":
            yield Path(name), None
            return
        with stoppable_server(SAFE) as server:
            yield Path(name), server.url


def _fill(folder: Path, url: str | None, size: FleetSize) -> tuple[float, str]:
    """Fill a database; return how long it took, in seconds, and the header line with a key."""
    settings = Settings(data_dir=folder, database_url=url, _env_file=None)
    upgrade(settings.url)
    storage = open_store(settings)
    try:
        return populate(storage, size, SEED, time.time_ns()), new_key(storage)
    finally:
        storage.close()


def _measure(
    address: str, key: str, database: str, size: FleetSize, rounds: int, asked: int, console: Console
) -> list[tuple[str, ...]]:
    """Return one row an endpoint: the medians over rounds in which every endpoint is asked in turn."""
    random = np.random.default_rng(SEED)
    found: dict[str, list[Percentiles]] = {endpoint.name: [] for endpoint in ENDPOINTS}
    for number in range(rounds + 1):
        wanted = {endpoint.name: endpoint.paths(size, random, asked) for endpoint in ENDPOINTS}
        for name, seen in ask(address, wanted, CLIENTS, [key]).items():
            if seen.refused:
                raise RuntimeError(f"{name}: {seen.refused} of {asked} answers are refusals")
            if number:  # the first round warms caches
                found[name].append(seen)
    rows = [_row(database, endpoint, found) for endpoint in ENDPOINTS]
    for row in rows:
        console.print("  ".join(f"{title} {cell}" for title, cell in zip(COLUMNS[1:], row[1:], strict=True)))
    return rows


def _row(database: str, endpoint: Endpoint, found: Mapping[str, Sequence[Percentiles]]) -> tuple[str, ...]:
    own = found[endpoint.name]
    ratio = statistics.median(one.p99_ms / bare.p99_ms for one, bare in zip(own, found[BARE], strict=True))
    met = "" if endpoint.reach is None else ("yes" if ratio <= endpoint.reach else "NO")
    figures: dict[str, Any] = {
        name: statistics.median(getattr(one, name) for one in own)
        for name in ("p50_ms", "p99_ms", "per_second", "mean_bytes")
    }
    return (
        database,
        endpoint.name,
        f"{figures['p50_ms']:.1f}",
        f"{figures['p99_ms']:.1f}",
        f"{figures['per_second']:.0f}",
        f"{figures['mean_bytes'] / 1000:.1f}",
        f"{ratio:.2f}",
        "" if endpoint.reach is None else f"at most {endpoint.reach:g}",
        met,
    )


def _page(size: FleetSize, rows: Sequence[tuple[str, ...]]) -> Path:
    words = (
        f"{size.vehicles} vehicles, {size.wheelsets} wheelsets, {size.days} days of daily geometry (seed {SEED}). "
        f"uvicorn with 2 workers, {CLIENTS} clients on loopback that ask again as soon as they are answered. Medians "
        "over rounds in which every endpoint is asked in turn over the same connections; the bare one is `/healthz`."
    )
    body = [
        words,
        markdown_table(COLUMNS, rows, right=(2, 3, 4, 5, 6)),
    ]
    return write_page("api", "The API under load", "make bench-api", body)
