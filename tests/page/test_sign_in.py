"""Keys on the page: asked for, taken once from the address; the scope that is missing; who acts is the key's owner."""

from __future__ import annotations

from collections.abc import Iterator

import api_fleet
import httpx
import pytest
from playwright.sync_api import Page, expect
from service_process import ServiceProcess, service_process

from api.access.keys import Wanted, make_key
from fleet_db.storage import SqlStorage

ROWS = "tbody tr[data-index]"


@pytest.fixture(scope="module")
def keyed_service(page_service: ServiceProcess, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """Yield a service that wants keys, over the same data as the open one."""
    data = page_service.file.parent / "data"
    with service_process(tmp_path_factory.mktemp("keyed"), DATA_DIR=str(data), ACCESS="keys") as running:
        yield running


@pytest.fixture
def page_of_keys(page: Page, keyed_service: ServiceProcess) -> Page:
    """Return a tab that may ask the service with keys."""
    tab = page.context.new_page()
    tab.goto(keyed_service.url)
    return tab


def token(storage: SqlStorage, owner: str, *scopes: str) -> str:
    with storage.write() as unit:
        wanted = Wanted(owner=owner, scopes=frozenset(scopes), fleets=None, expires_ns=None)
        _, made = make_key(unit, wanted, "test", api_fleet.RECORDED)
    return made


def test_a_key_is_asked_for_and_a_wrong_one_refused(page_of_keys: Page, stored: SqlStorage) -> None:
    box = page_of_keys.locator("dialog")
    expect(box).to_contain_text("Sign in")
    for given, refused in (("tw_wrong", True), (token(stored, "reader", "read"), False)):
        page_of_keys.fill("#key-field", given)
        page_of_keys.keyboard.press("Enter")
        if refused:
            expect(box.locator(".refused")).not_to_be_empty()
    expect(box).to_have_count(0)
    page_of_keys.locator(ROWS).first.wait_for()


def test_a_key_in_the_address_is_taken_once_and_its_owner_is_who_acts(
    page_of_keys: Page, keyed_service: ServiceProcess, stored: SqlStorage
) -> None:
    alert = api_fleet.raised(stored, "WS-011", "wheel_asymmetry")
    planner = token(stored, "m. planner", "read", "act")
    for given in (token(stored, "reader", "read"), planner):
        page_of_keys.goto("about:blank")
        page_of_keys.goto(f"{keyed_service.url}/#key={given}")
        page_of_keys.locator(ROWS).first.wait_for()
        assert given not in page_of_keys.url
        page_of_keys.goto(f"{keyed_service.url}/#/alerts/{alert.alert_id}")
        page_of_keys.locator('[data-act="acknowledge"]').click()
        page_of_keys.fill("#act-note", "seen on Monday")
        page_of_keys.locator("dialog button.main").click()
        if given != planner:
            expect(page_of_keys.locator("dialog .refused")).to_contain_text("scope 'act'")
            page_of_keys.keyboard.press("Escape")
    expect(page_of_keys.locator("dialog")).to_have_count(0)
    headers = {"Authorization": f"Bearer {planner}"}
    held = httpx.get(f"{keyed_service.url}/v1/alerts/{alert.alert_id}", headers=headers).json()
    assert held["acknowledged_by"] == "m. planner"
