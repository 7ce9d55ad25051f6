"""The turning plan on the page: visits and reasons as the API gives them, parameters as a form, paper, a table."""

from __future__ import annotations

import csv
import io
import json

import httpx
import pytest
from playwright.sync_api import Page, expect
from service_process import ServiceProcess

ROWS = "tbody tr[data-index]"
PATH = "/v1/plans/reprofiling"


@pytest.fixture
def plan(page: Page, page_service: ServiceProcess, client: httpx.Client) -> list[dict[str, object]]:
    """Open the plan; return its lines as the API has them."""
    page.goto(f"{page_service.url}/#/plan")
    page.locator(ROWS).first.wait_for()
    items: list[dict[str, object]] = client.get(PATH).json()["items"]
    return items


def test_each_wheelset_is_shown_with_visit_and_reason(page: Page, plan: list[dict[str, object]]) -> None:
    assert [row.get_attribute("data-key") for row in page.locator(ROWS).all()] == [one["wheelset"] for one in plan]
    assert page.locator(f"{ROWS} .c-why").all_inner_texts() == [one["reason"] for one in plan]
    visits = [(one["vehicle"], one["visit"]) for one in plan]
    firsts = [place for place, visit in enumerate(visits) if place == 0 or visits[place - 1] != visit]
    marked = page.locator(f"{ROWS}.first-of-visit")
    assert [int(row.get_attribute("data-index") or -1) for row in marked.all()] == firsts
    assert plan[0]["turn_by"] is not None
    expect(page.locator(ROWS).first.locator(".c-turnby")).to_have_text("now")
    expect(page.locator(".view-head")).to_contain_text("to the lathe")
    page.locator(ROWS).first.focus()
    page.keyboard.press("Enter")
    page.wait_for_url(f"**/#/wheelsets/{plan[0]['wheelset']}")


def test_parameters_stay_in_the_address_and_reach_the_plan_and_its_table(
    page: Page, plan: list[dict[str, object]], client: httpx.Client
) -> None:
    wanted = {"vehicle": "V-0", "nominal_radii": "true", "cut_mm": "3", "minimum_radius_mm": "436"}
    page.fill('input[name="vehicle"]', wanted["vehicle"])
    page.select_option('select[name="nominal_radii"]', wanted["nominal_radii"])
    for name in ("cut_mm", "minimum_radius_mm"):
        page.fill(f'input[name="{name}"]', wanted[name])
    page.keyboard.press("Enter")
    lines = client.get(PATH, params=wanted).json()["items"]
    assert json.dumps(lines) != json.dumps([one for one in plan if one["vehicle"] == "V-0"])
    expect(page.locator(ROWS)).to_have_count(len(lines))
    expect(page.locator(f"{ROWS} .badge", has_text="replace")).to_have_count(
        sum(one["cause"] == "replace" for one in lines)
    )
    assert all(f"{name}={value}" in page.url for name, value in wanted.items())
    with page.expect_download() as download:
        page.get_by_role("button", name="Save as CSV").click()
    saved = list(csv.DictReader(io.StringIO(download.value.path().read_text())))
    assert [row["wheelset"] for row in saved] == [one["wheelset"] for one in lines]
    page.emulate_media(media="print")
    expect(page.locator("form.filters")).to_be_hidden()
    expect(page.locator(ROWS)).to_have_count(len(lines))


def test_a_number_out_of_range_is_not_sent_and_a_vehicle_that_is_none_is_an_error(
    page: Page, plan: list[dict[str, object]]
) -> None:
    page.fill('input[name="cut_mm"]', "-1")
    page.press('input[name="cut_mm"]', "Enter")
    assert page.locator('input[name="cut_mm"]').evaluate("field => field.validity.rangeUnderflow")
    assert "cut_mm" not in page.url
    expect(page.locator(ROWS)).to_have_count(len(plan))
    page.fill('input[name="cut_mm"]', "")
    page.fill('input[name="vehicle"]', "V-99")
    page.press('input[name="vehicle"]', "Enter")
    expect(page.locator('[data-state="error"]')).to_contain_text("V-99")
    expect(page.locator(ROWS)).to_have_count(0)
