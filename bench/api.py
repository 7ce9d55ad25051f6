"""Latencies of a large fleet's API, beside a bare endpoint of the same server: ``python -m bench api``."""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.http_load import Answers, ask, request
from bench.large_fleet import FleetSize
from bench.report import Bench, Part, ResultTable
from bench.served import SEED, filled_database, served
from bench.services import DATABASES

CLIENTS = 50
BARE = "bare"
COLUMNS = ("database", "endpoint", "p50 ms", "p99 ms", "requests/s", "kB", "p99 / bare", "reach", "met")


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


def _parts(options: argparse.Namespace, _folder: Path) -> Iterator[Part]:
    size, rows = FleetSize(vehicles=options.vehicles, days=options.days), list[tuple[str, ...]]()
    for database in options.databases:
        with filled_database(database, size) as (folder, url, key), served(folder, url) as address:
            rows += _measure(address, key, database, size, options)
    yield (
        f"{size.vehicles} vehicles, {size.wheelsets} wheelsets, {size.days} days of daily geometry (seed {SEED}). "
        f"uvicorn with 2 workers, {CLIENTS} clients on loopback that ask again as soon as they are answered. Medians "
        "over rounds in which every endpoint is asked in turn over the same connections; the bare one is `/healthz`."
    )
    yield ResultTable(COLUMNS, rows, (2, 3, 4, 5, 6))


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


main = Bench(
    "api",
    "The API under load",
    __doc__ or "",
    _parts,
    {
        "vehicles": (1000, "of 4 wheelsets each"),
        "days": (365, "of daily geometry"),
        "rounds": (5, "in which every endpoint is asked"),
        "asked": (1500, "requests of an endpoint in a round"),
        "databases": (list(DATABASES), "that are asked", DATABASES),
    },
).run
