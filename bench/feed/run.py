"""Both questions on both databases, with two worker processes."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from rich.console import Console

from api.factory import open_store
from bench.api.servers import WORKERS, new_key, served
from bench.feed import exactly_once, latency
from bench.feed.events import populate, settings_of
from bench.report import BenchRow
from bench.results_page import markdown_table, write_page
from fleet_db.migrate import upgrade
from tests.postgres_server import SAFE, stoppable_server

WRITERS, POLLERS, STEPS = 8, 4, 250
CLIENTS, EVENTS = 200, 40
REACH_S = 1.0
COLUMNS = ("database", "what", "measured", "reach", "met")


def main(arguments: Sequence[str]) -> int:
    """Run both; return 1 where one falls short."""
    parser = argparse.ArgumentParser("python -m bench feed", description="Who misses an event, and how late it comes.")
    parser.add_argument("--database", choices=("sqlite", "postgresql"), help="only this one")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/feed.md")
    options = parser.parse_args(arguments)
    console, rows = Console(), []
    for database in ("sqlite", "postgresql") if options.database is None else (options.database,):
        for row in _of(database):
            console.print(f"{database}: {row.what}: {row.measured} (reach {row.reach})", highlight=False)
            rows.append((database, row.what, row.measured, row.reach, "yes" if row.met else "NO"))
    if options.write_docs:
        command = "python -m bench feed --write-docs"
        console.print(f"wrote {write_page('feed', 'The feed', command, [markdown_table(COLUMNS, rows)])}")
    return 0 if all(row[-1] == "yes" for row in rows) else 1


def _of(database: str) -> Iterator[BenchRow]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if database == "sqlite":
            yield from rows(folder, None)
            return
        with stoppable_server(SAFE) as server:
            yield from rows(folder, server.url)


def rows(folder: Path, database_url: str | None) -> Iterator[BenchRow]:
    """Yield what was measured on one database.

    Args:
        database_url: An empty database; None for SQLite in the folder.
    """
    settings = settings_of(folder, database_url)
    upgrade(settings.url)
    with closing(open_store(settings)) as storage:
        populate(storage, WRITERS + 1)
        key = new_key(storage)
        with served(folder, database_url) as url:
            delays = latency.measured_s(url, key, folder, database_url, clients=CLIENTS, writer=WRITERS, events=EVENTS)
            p50, p99, most = np.percentile(delays, [50, 99, 100])
            yield BenchRow(
                f"{CLIENTS} streams of {WORKERS} workers, {EVENTS} commits of another process: time after the commit",
                f"p50 {p50:.2f} s, p99 {p99:.2f} s, most {most:.2f} s",
                f"most < {REACH_S:g} s",
                bool(most < REACH_S),
            )
            sizes = {"writers": WRITERS, "pollers": POLLERS, "steps": STEPS}
            found = exactly_once.run(url, key, folder, database_url, storage, **sizes)
    wrong = (found.missed, found.doubled, found.out_of_order)
    yield BenchRow(
        f"{WRITERS} writers, {POLLERS} pollers, {found.events} events, {found.kills} kills of pollers",
        f"{wrong[0]} missed, {wrong[1]} doubled, {wrong[2]} out of order",
        "0, 0, 0",
        not any(wrong),
    )
