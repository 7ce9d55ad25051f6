"""Cold loads, scrolling and sorting of the overview, beside two workers of the service on the same machine."""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright
from rich.console import Console

from api.factory import open_store
from api.settings import Settings
from bench.api.fleet import FleetSize, populate
from bench.api.servers import new_key, served
from bench.page.browsing import Visit, scrolled, sorted_by, visited
from bench.report import BenchRow
from bench.results_page import markdown_table, write_page
from fleet_db.migrate import upgrade
from tests.page.chromium import chromium

SEED = 2010
LOADS = 9
CONTENT_S, SENT_KB, FRAME_MS = 1.0, 500.0, 50.0
SHARE_OF_LONG = 0.01
"""Frames that may be long: those in which the garbage collector or another process ran."""
PAUSE_MS = 60.0
SORTED_BY = "conicity"
COLUMNS = ("what", "measured", "reach", "met")


def main(arguments: Sequence[str]) -> int:
    """Fill a database, visit, print and write the page; return 1 where a figure falls short."""
    options = _options(arguments)
    size = FleetSize(vehicles=options.vehicles, days=options.days)
    console, rows = Console(), []
    with tempfile.TemporaryDirectory(prefix="treadwatch-bench-") as name:
        folder = Path(name)
        key = _filled(folder, size)
        console.print(f"filled: {size.wheelsets} wheelsets")
        with served(folder, None) as url, _browser() as browser:
            for row in measured(browser, f"{url}/#key={key}", size.wheelsets, options.loads):
                console.print(f"{row.what}: {row.measured} (reach {row.reach})", highlight=False, soft_wrap=True)
                rows.append((row.what, row.measured, row.reach, "yes" if row.met else "NO"))
    if options.write_docs:
        words = (
            f"{size.vehicles} vehicles, {size.wheelsets} wheelsets; SQLite, 2 workers, Chromium on the same machine."
        )
        body = [words, markdown_table(COLUMNS, rows)]
        console.print(f"wrote {write_page('page', 'The page with a large fleet', 'make bench-page', body)}")
    return 0 if all(row[-1] == "yes" for row in rows) else 1


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser("python -m bench page", description=__doc__)
    parser.add_argument("--vehicles", type=int, default=1000, help="of 4 wheelsets each")
    parser.add_argument("--days", type=int, default=30, help="of daily geometry, which the overview does not read")
    parser.add_argument("--loads", type=int, default=LOADS, help="cold loads")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/page.md")
    return parser.parse_args(arguments)


def _filled(folder: Path, size: FleetSize) -> str:
    settings = Settings(data_dir=folder, _env_file=None)
    upgrade(settings.url)
    with closing(open_store(settings)) as storage:
        populate(storage, size, SEED, time.time_ns())
        return new_key(storage).removeprefix("Authorization: Bearer ")


@contextmanager
def _browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox", "--disable-gpu"])
        yield launched
        launched.close()


def measured(browser: Browser, address: str, wheelsets: int, loads: int) -> Iterator[BenchRow]:
    """Yield what was measured in a browser.

    Args:
        loads: How often it is loaded from a cold cache, after one that warms the service.
    """
    visits: list[Visit] = []
    for number in range(loads + 1):
        with visited(browser, address) as (_, visit):
            if number:
                visits.append(visit)
    seconds = [visit.content_ms / 1000.0 for visit in visits]
    middle = statistics.median(seconds)
    yield BenchRow(
        f"content of the overview, {loads} cold loads",
        f"median {middle:.2f} s, most {max(seconds):.2f} s",
        f"median < {CONTENT_S:g} s",
        middle < CONTENT_S,
    )
    sent = max(visits, key=lambda visit: sum(visit.sent_bytes.values())).sent_bytes
    largest = sorted(sent.items(), key=lambda item: -item[1])[:3]
    kilobytes = sum(sent.values()) / 1000.0
    yield BenchRow(
        "sent until then, compressed, with headers",
        f"{kilobytes:.0f} kB; most of it {', '.join(f'{name} {size / 1000.0:.0f} kB' for name, size in largest)}",
        f"< {SENT_KB:g} kB",
        kilobytes < SENT_KB,
    )
    with visited(browser, address) as (page, _):
        yield _smooth(f"scrolling through {wheelsets} rows", scrolled(page, wheelsets, PAUSE_MS))
        yield _smooth(f"sorting by {SORTED_BY}", sorted_by(page, SORTED_BY))


def _smooth(what: str, frames_ms: Sequence[float]) -> BenchRow:
    long = [one for one in frames_ms if one > FRAME_MS]
    return BenchRow(
        what,
        f"{len(frames_ms)} frames, {len(long)} longer than {FRAME_MS:g} ms, longest {max(frames_ms):.0f} ms",
        f"at most {100.0 * SHARE_OF_LONG:g} % longer",
        len(long) <= max(1, SHARE_OF_LONG * len(frames_ms)),
    )
