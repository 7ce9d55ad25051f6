"""A new deployment: every view of an empty database says what is missing, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect
from service_process import ServiceProcess, service_process

from api.settings import Settings
from fleet_db.migrate import upgrade

SAYS = {
    "#/": (
        "No wheelset is registered yet.",
        "treadwatch registry load FILE",
        "treadwatch ingest FILE",
        "treadwatch demo",
    ),
    "#/plan": ("No wheelset has to be turned within this horizon.",),
    "#/alerts": ("No open alert.",),
    "#/tracks": ("No track section is registered.",),
    "#/accuracy": ("No measured profile is on file.",),
    "#/operation": ("No vehicle has sent anything yet.", "Nothing is held", "No recording has been received yet."),
}


@pytest.fixture(scope="module")
def page_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """Yield a service over a database without a record."""
    folder = tmp_path_factory.mktemp("empty")
    settings = Settings(data_dir=folder / "data", _env_file=None)
    settings.data_dir.mkdir()
    upgrade(settings.url)
    with service_process(folder) as running:
        yield running


@pytest.mark.parametrize("place", SAYS)
def test_an_empty_database_says_what_is_missing(page: Page, page_service: ServiceProcess, place: str) -> None:
    page.goto(f"{page_service.url}/{place}")
    expect(page.locator("main h1")).to_be_visible()
    for text in SAYS[place]:
        expect(page.locator("main")).to_contain_text(text)
    expect(page.locator('[data-state="loading"]')).to_have_count(0)
    assert page.locator('[data-state="error"]').count() == 0
    assert "undefined" not in page.locator("main").inner_text()
    assert "NaN" not in page.locator("main").inner_text()
