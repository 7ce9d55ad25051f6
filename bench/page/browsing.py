"""One visit to the page, measured inside the browser."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from playwright.sync_api import Browser, CDPSession, Page

FIRST_ROW = "tbody tr[data-index]"
PATIENCE_MS = 60_000.0
SCROLLED_PX = 900
"""One turn of a wheel, about a screen of rows."""
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
    """A visit from a cold cache.

    Args:
        content_ms: From the beginning of the navigation to the frame with the first rows.
        sent_bytes: What came over the network until then, compressed, with headers, by the last part of its path.
    """

    content_ms: float
    sent_bytes: Mapping[str, int]


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
    """Return what every request receives, as it comes in."""
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
    """Scroll through all rows; return how long each frame took, in ms.

    Args:
        rows: How many there are; scrolling ends at the last.
    """
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
