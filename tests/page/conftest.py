"""A really running ``treadwatch serve`` over a stored fleet, and Chromium: one server and one browser a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import api_fleet
import httpx
import page_fleet
import pytest
from chromium import chromium
from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page, Request, expect, sync_playwright
from service_process import ServiceProcess, service_process

from api.factory import open_store
from api.settings import Settings
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage

PATIENCE_MS = 60_000.0
expect.set_options(timeout=PATIENCE_MS)


@dataclass(frozen=True)
class Watched:
    """What must not happen on a page: errors of scripts, refusals of its policy, requests to other origins."""

    complaints: list[str] = field(default_factory=list)

    def watch(self, page: Page, origin: str) -> None:
        """Follow a page from its beginning."""
        page.on("console", lambda message: self._said(message))  # noqa: PLW0108 - playwright marks the object of a bound one
        page.on("pageerror", lambda error: self.complaints.append(f"error of a script: {error}"))
        page.on("request", lambda request: self._asked(request, origin))

    def _said(self, message: ConsoleMessage) -> None:
        if message.type in {"error", "warning"} and "Failed to load resource" not in message.text:
            self.complaints.append(f"{message.type} on the console: {message.text}")

    def _asked(self, request: Request, origin: str) -> None:
        address = urlsplit(request.url)
        if address.scheme not in {"data", "blob"} and f"{address.scheme}://{address.netloc}" != origin:
            self.complaints.append(f"request to another origin: {request.url}")


LENGTH_S = api_fleet.LENGTH / api_fleet.SECOND
"""Of the windows that are stored: once a recording is stored as well, no other may be set."""


@pytest.fixture(scope="session")
def page_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """Yield ``treadwatch serve`` over the fleet; tests that change something bring alerts of their own."""
    folder = tmp_path_factory.mktemp("page")
    settings = Settings(data_dir=folder / "data", window_length_s=LENGTH_S, _env_file=None)
    settings.data_dir.mkdir()
    upgrade(settings.url)
    storage = open_store(settings)
    page_fleet.populate(storage)
    storage.close()
    with service_process(folder, WINDOW_LENGTH_S=str(LENGTH_S)) as running:
        yield running


@pytest.fixture
def stored(page_service: ServiceProcess) -> Iterator[SqlStorage]:
    """Yield the storage of the service, which other processes write to as well."""
    settings = Settings(data_dir=page_service.file.parent / "data", window_length_s=LENGTH_S, _env_file=None)
    storage = open_store(settings)
    yield storage
    storage.close()


@pytest.fixture
def client(page_service: ServiceProcess) -> Iterator[httpx.Client]:
    """Yield a client of the service other than the page."""
    with httpx.Client(base_url=page_service.url, timeout=30.0) as made:
        yield made


@dataclass
class _Held:
    """The browser of this process while tests of this folder follow one another."""

    ending: ExitStack | None = None
    browser: Browser | None = None


_held = _Held()


@pytest.fixture
def browser() -> Browser:
    """Return Chromium, one for all tests of this folder that follow one another."""
    if _held.browser is None:
        _held.ending = ExitStack()
        playwright = _held.ending.enter_context(sync_playwright())
        _held.browser = playwright.chromium.launch(
            executable_path=chromium(), args=["--no-sandbox", "--disable-gpu", "--disable-extensions"]
        )
        _held.ending.callback(_held.browser.close)
    return _held.browser


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(nextitem: pytest.Item | None) -> None:
    """Close the browser before a test of another folder: its event loop runs in this thread."""
    if _held.ending is not None and (nextitem is None or nextitem.path.parent != Path(__file__).parent):
        _held.ending.close()
        _held.ending = _held.browser = None


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """Yield a fresh profile of a desktop."""
    made = browser.new_context(viewport={"width": 1440, "height": 900}, color_scheme="light")
    made.set_default_timeout(PATIENCE_MS)
    yield made
    made.close()


@pytest.fixture
def page(context: BrowserContext, page_service: ServiceProcess) -> Iterator[Page]:
    """Yield an empty tab; whatever a test does, nothing may go wrong in it unseen."""
    tab = context.new_page()
    watched = Watched()
    watched.watch(tab, page_service.url)
    yield tab
    assert watched.complaints == []
