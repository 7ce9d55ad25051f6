"""Cold loads, scrolling and sorting of the overview, beside two workers of the service: ``python -m bench page``."""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from playwright.sync_api import Browser, CDPSession, Page, sync_playwright

from bench.large_fleet import FleetSize
from bench.report import Bench, BenchRow, Part, printed, row_table
from bench.served import filled_database, served
from tests.page.chromium import chromium

CONTENT_S, SENT_KB, FRAME_MS = 1.0, 500.0, 50.0
SHARE_OF_LONG = 0.01
"""Frames that may be long: those in which the garbage collector or another process ran."""

PAUSE_MS = 60.0
SORTED_BY = "conicity"
FIRST_ROW = "tbody tr[data-index]"
PATIENCE_MS = 60_000.0
SCROLLED_PX = 900  # one turn of a wheel, about a screen of rows
_WATCH = """
window.seen = { content: null, frames: [], last: null };
new MutationObserver((_, observer) => {
  if (document.querySelector("tbody tr[data-index]") === null) return;
  observer.disconnect();
  requestAnimationFrame(() => { window.seen.content = performance.now(); });
}).observe(document, { childList: true, subtree: true });
const frame = (now) => {
  if (window.seen.last !== null) window.seen.frames.push(now - window.seen.last);
  window.seen.last = now;
  requestAnimationFrame(frame);
};
requestAnimationFrame(frame);
"""


@dataclass(frozen=True, slots=True)
class Visit:
    """A visit from a cold cache."""

    content_ms: float  # from the beginning of the navigation to the frame with the first rows
    sent_bytes: Mapping[str, int]  # over the network until then, with headers, by the last part of the path


@contextmanager
def visited(browser: Browser, address: str) -> Iterator[tuple[Page, Visit]]:
    """Open the page in a fresh profile; yield it, and what was measured until its rows were there."""
    context = browser.new_context(viewport={"width": 1440, "height": 900})
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    sent = _counted(context.new_cdp_session(page))
    page.add_init_script(_WATCH)
    page.goto(address)
    page.locator(FIRST_ROW).first.wait_for()
    page.wait_for_function("window.seen.content !== null")
    page.wait_for_load_state("networkidle")
    yield page, Visit(float(page.evaluate("window.seen.content")), dict(sent))
    context.close()


def _counted(session: CDPSession) -> Mapping[str, int]:
    names: dict[str, str] = {}
    sent: dict[str, int] = {}

    def asked(event: Mapping[str, object]) -> None:
        request = event["request"]
        assert isinstance(request, dict)
        names[str(event["requestId"])] = str(request["url"]).split("?")[0].split("#")[0].rsplit("/", 1)[-1] or "/"

    def received(event: Mapping[str, object]) -> None:
        name = names.get(str(event["requestId"]), "?")
        sent[name] = sent.get(name, 0) + int(float(str(event["encodedDataLength"])))

    session.on("Network.requestWillBeSent", asked)
    session.on("Network.loadingFinished", received)
    session.send("Network.enable")
    return sent


def scrolled(page: Page, rows: int, pause_ms: float) -> list[float]:
    """Scroll through all rows; return how long each frame took, in ms."""
    page.mouse.move(700, 500)
    page.evaluate("window.seen.frames = []")
    while not _at_the_end(page, rows):
        page.mouse.wheel(0, SCROLLED_PX)
        page.wait_for_timeout(pause_ms)
    return _frames(page)


def _at_the_end(page: Page, rows: int) -> bool:
    last = page.locator(FIRST_ROW).last.get_attribute("data-index", timeout=PATIENCE_MS)
    return last is not None and int(last) == rows - 1


def sorted_by(page: Page, column: str) -> list[float]:
    """Sort by a column; return how long each frame took until other rows were there, in ms."""
    page.evaluate("window.seen.frames = []")
    head = page.locator(f"thead .c-{column} button")
    before = page.locator(FIRST_ROW).first.get_attribute("data-key")
    head.click()
    page.wait_for_function(
        "(before) => { const row = document.querySelector('tbody tr[data-index]');"
        " return row !== null && row.dataset.index === '0' && row.dataset.key !== before; }",
        arg=before,
    )
    return _frames(page)


def _frames(page: Page) -> list[float]:
    return [float(one) for one in page.evaluate("window.seen.frames")]


def _parts(options: argparse.Namespace, _folder: Path) -> Iterator[Part]:
    size = FleetSize(vehicles=options.vehicles, days=options.days)
    with filled_database("sqlite", size) as (folder, _, key), served(folder, None) as url, _browser() as browser:
        token = key.removeprefix("Authorization: Bearer ")
        rows = printed(_measured(browser, f"{url}/#key={token}", size.wheelsets, options.loads))
    yield f"{size.vehicles} vehicles, {size.wheelsets} wheelsets; SQLite, 2 workers, Chromium on the same machine."
    yield row_table(rows)


@contextmanager
def _browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox", "--disable-gpu"])
        yield launched
        launched.close()


def _measured(browser: Browser, address: str, wheelsets: int, loads: int) -> Iterator[BenchRow]:
    """Yield what was measured in a browser; one load more warms the service."""
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


main = Bench(
    "page",
    "The page with a large fleet",
    __doc__ or "",
    _parts,
    {
        "vehicles": (1000, "of 4 wheelsets each"),
        "days": (30, "of daily geometry, which the overview does not read"),
        "loads": (9, "cold loads"),
    },
).run
