"""A planner's Monday: find the wheelset due first, see why, acknowledge; ``treadwatch feed --follow`` says so."""

from __future__ import annotations

import json
import subprocess
import sys

import api_fleet
import httpx
from playwright.sync_api import Page, expect
from service_process import COMMAND, ServiceProcess

from fleet_db.storage import SqlStorage

ROWS = "tbody tr[data-index]"


def test_a_planner_finds_what_is_due_first_and_acknowledges_it(
    page: Page, page_service: ServiceProcess, client: httpx.Client, stored: SqlStorage
) -> None:
    due = client.get("/v1/wheelsets?sort=urgency&limit=1").json()["items"][0]
    alert = api_fleet.raised(stored, due["serial"], fleet=due["fleet"])
    cursor = client.get("/v1/alerts/feed?after=latest&limit=1").json()["next_cursor"]
    options = ["feed", "--follow", "--json", "--after", cursor, "--url", page_service.url]
    with subprocess.Popen([sys.executable, "-c", COMMAND, *options], stdout=subprocess.PIPE, text=True) as feed:
        page.goto(page_service.url)
        first = page.locator(ROWS).first
        expect(first.locator(".c-serial a")).to_have_text(due["serial"])
        expect(first.locator(".c-why")).to_have_text("; ".join(one["text"] for one in due["state"]["reasons"]))
        first.focus()
        page.keyboard.press("Enter")
        line = page.locator(".alert-line").filter(has=page.locator(f'a[href="#/alerts/{alert.alert_id}"]'))
        line.get_by_role("button", name="Acknowledge").click()
        page.fill("#act-note", "to the lathe on Thursday")
        page.fill("#act-by", "m. planner")
        page.keyboard.press("Enter")
        expect(page.locator("dialog")).to_have_count(0)
        assert feed.stdout is not None
        event = json.loads(feed.stdout.readline())
        feed.terminate()
    assert (event["event"], event["actor"], event["note"]) == ("acknowledged", "m. planner", "to the lathe on Thursday")
    assert event["alert"]["wheelset"] == due["serial"]
