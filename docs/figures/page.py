"""Take docs/img/page-fleet.png and page-wheelset.png of a running service. Run: python docs/figures/page.py URL#key=KEY."""  # noqa: INP001, E501 - a script, not a package; a command to copy

from __future__ import annotations

import shutil
import sys
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

IMAGES = Path(__file__).resolve().parent.parent / "img"
SIZE = {"width": 1440, "height": 740}
COLOURS = 256
SHOWN = "WS-1011"  # the wheelset of the demo that wears fastest
DRAWN_MS = 1500.0  # charts are drawn after their data have come


def main() -> None:
    """Take both."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport=SIZE, color_scheme="light")  # type: ignore[arg-type] # a dict of this shape
        page.goto(sys.argv[1])
        rows = page.locator("tbody tr[data-index]")
        rows.first.wait_for()
        _take(page, "page-fleet")
        rows.filter(has_text=SHOWN).first.focus()
        page.keyboard.press("Enter")
        page.locator("canvas").first.wait_for()
        _take(page, "page-wheelset")
        browser.close()


def _take(page: Page, name: str) -> None:
    page.wait_for_timeout(DRAWN_MS)
    taken = Image.open(BytesIO(page.screenshot()))
    taken.convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        IMAGES / f"{name}.png", optimize=True
    )


if __name__ == "__main__":
    main()
