"""Alerts on the page: what led to them, acknowledge, shelve, unshelve as the API then has it, conflicts, news."""

from __future__ import annotations

import api_fleet
import httpx
import pytest
from playwright.sync_api import Locator, Page, expect
from service_process import ServiceProcess

from estimation.alerts.rule_book import ALERT_RULES
from estimation.values.alerts import Alert
from fleet_db.storage import SqlStorage

ROWS = "tbody tr[data-index]"


@pytest.fixture
def raised(stored: SqlStorage) -> Alert:
    """Return an alert of the test's own."""
    return api_fleet.raised(stored, "WS-011", fleet="=beta")


def row_of(page: Page, alert: Alert) -> Locator:
    return page.locator(ROWS).filter(has=page.locator(f'a[href="#/alerts/{alert.alert_id}"]'))


def choose(page: Page, tab: str) -> None:
    page.locator(f'[data-tab="{tab}"]').click()


def confirm(page: Page, **fields: str) -> None:
    box = page.locator("dialog")
    for name, value in fields.items():
        box.locator(f"#act-{name}").fill(value)
    box.locator("button.main").click()


def test_an_alert_is_acknowledged_shelved_and_brought_back(
    page: Page, page_service: ServiceProcess, client: httpx.Client, raised: Alert
) -> None:
    path = f"/v1/alerts/{raised.alert_id}"
    page.goto(f"{page_service.url}/#/alerts")
    row = row_of(page, raised)
    expect(row).to_contain_text("conicity limit")
    expect(row).to_contain_text("V-2, axle 4")
    row.get_by_role("button", name="Acknowledge").click()
    confirm(page, note="<b>planned</b>", by="m. planner")
    expect(row.locator(".c-state")).to_contain_text(
        "by m. planner"
    )  # it stays, and says so, until another tab is chosen
    assert client.get(path).json()["acknowledged_by"] == "m. planner"
    choose(page, "acknowledged")
    expect(row).to_contain_text("by m. planner")

    row.get_by_role("button", name="Shelve").click()
    expect(page.locator("#act-by")).to_have_value("m. planner")
    page.select_option("#act-days", "14")
    confirm(page, reason="lathe is busy")
    expect(page.locator("dialog")).to_have_count(0)
    held = client.get(path).json()
    assert (held["display_state"], held["shelved_reason"]) == ("shelved", "lathe is busy")
    choose(page, "shelved")
    expect(row).to_contain_text("lathe is busy")

    row.get_by_role("button", name="Bring back").click()
    confirm(page, note="the lathe is free")
    expect(row.locator(".c-state")).to_contain_text("acknowledged")
    choose(page, "open")
    expect(row).to_have_count(0)
    assert client.get(path).json()["display_state"] == "acknowledged"
    events = [one["event"] for one in client.get(f"{path}/events").json()["items"]]
    assert events == ["raised", "acknowledged", "shelved", "unshelved"]

    page.goto(f"{page_service.url}/#/alerts/{raised.alert_id}")
    expect(page.locator("main")).to_contain_text("<b>planned</b>")
    page.keyboard.press("Escape")
    page.wait_for_url("**/#/alerts")


def test_closed_alerts_say_when_and_why(
    page: Page, page_service: ServiceProcess, client: httpx.Client, stored: SqlStorage
) -> None:
    for _ in range(2):  # the second closes the first
        api_fleet.raised(stored, "WS-009", "no_data", fleet="=beta")
    page.goto(f"{page_service.url}/#/alerts")
    page.locator(ROWS).first.wait_for()
    choose(page, "closed")
    closed = [one for one in client.get("/v1/alerts?limit=1000").json()["items"] if one["closed_at"] is not None]
    assert closed
    expect(page.locator(ROWS)).to_have_count(len(closed))
    newest = max(closed, key=lambda one: one["closed_at"])
    expect(page.locator(f"{ROWS} .c-state").first).to_contain_text(newest["close_reason"])
    assert page.locator(f"{ROWS} button").count() == 0


def test_what_has_changed_meanwhile_is_shown_and_not_overwritten(
    page: Page, page_service: ServiceProcess, client: httpx.Client, raised: Alert
) -> None:
    path = f"/v1/alerts/{raised.alert_id}"
    page.goto(f"{page_service.url}/#/alerts")
    row_of(page, raised).get_by_role("button", name="Acknowledge").click()
    page.locator("dialog").wait_for()
    tag = client.get(path).headers["etag"]
    other = client.post(f"{path}/acknowledge", json={"by": "somebody else"}, headers={"If-Match": tag})
    assert other.status_code == 200
    confirm(page, by="m. planner")
    refused = page.locator("dialog .refused")
    expect(refused).to_contain_text("has changed since you opened it: now acknowledged, acknowledged by somebody else")
    assert client.get(path).json()["acknowledged_by"] == "somebody else"
    confirm(page)
    expect(refused).to_contain_text("already acknowledged by somebody else")
    page.keyboard.press("Escape")
    expect(page.locator("dialog")).to_have_count(0)


def test_a_new_alert_appears_by_itself(page: Page, page_service: ServiceProcess, stored: SqlStorage) -> None:
    with page.expect_response(lambda response: "after=latest" in response.url):  # the feed is followed from its end
        page.goto(f"{page_service.url}/#/alerts?kind=hunting")
    expect(page.locator('[data-state="empty"]')).to_contain_text("No open alert")
    new = api_fleet.raised(stored, "WS-010", "hunting")
    expect(row_of(page, new)).to_contain_text("WS-010")


def test_kinds_are_those_of_the_rules(page: Page, page_service: ServiceProcess) -> None:
    page.goto(f"{page_service.url}/#/alerts")
    kinds = page.locator('select[name="kind"] option')
    kinds.nth(1).wait_for(state="attached")
    assert kinds.evaluate_all("options => options.map(o => o.value)")[1:] == [rule.kind for rule in ALERT_RULES]
