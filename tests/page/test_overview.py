"""The fleet on the page: ranking and reasons as the API has them, filters, keys, text that is only text, states."""

from __future__ import annotations

import csv
import io
import re

import httpx
import page_fleet
from playwright.sync_api import Locator, Page, Route, expect
from service_process import ServiceProcess

from estimation.values.alerts import Urgency
from estimation.values.quantities import Status

ROWS = "tbody tr[data-index]"
MOST_DRAWN = 60
"""Rows in the document, however many the fleet has."""


A4_LANDSCAPE_PX = 1032  # between the margins


def opened(page: Page, service: ServiceProcess, query: str = "") -> Locator:
    """Open the overview; return its rows."""
    page.goto(f"{service.url}/#/{query}")
    rows = page.locator(ROWS)
    rows.first.wait_for()
    return rows


def serials(page: Page) -> list[str]:
    return page.locator(f"{ROWS} .c-serial a").all_inner_texts()


def test_wheelsets_are_ranked_by_urgency_each_with_its_reason(
    page: Page, page_service: ServiceProcess, client: httpx.Client
) -> None:
    rows = opened(page, page_service)
    wanted = client.get("/v1/wheelsets", params={"sort": "urgency", "limit": 12}).json()["items"]
    assert serials(page)[:12] == [item["serial"] for item in wanted]
    for index, item in enumerate(wanted):
        expect(rows.nth(index).locator(".c-why")).to_have_text(
            "; ".join(one["text"] for one in item["state"]["reasons"])
        )
    assert wanted[0]["state"]["urgency"] == "probably_over"
    expect(rows.first.locator(".badge").first).to_have_text("probably over")


def test_an_estimate_has_its_interval_and_an_unknown_one_no_number(page: Page, page_service: ServiceProcess) -> None:
    rows = opened(page, page_service)
    known = rows.filter(has=page.get_by_text("WS-002", exact=True)).locator(".c-conicity")
    assert re.search(r"0\.\d{3}.*\n.*0\.\d{3} to 0\.\d{3}", known.inner_text()), known.inner_text()
    expect(known.locator("svg")).to_have_attribute("aria-label", re.compile(r"from 0\.\d+ to 0\.\d+, limit 0\.400"))
    unknown = rows.filter(has=page.get_by_text("WS-009", exact=True)).locator(".c-conicity")
    expect(unknown).to_contain_text("not estimated")
    assert re.search(r"\d", unknown.inner_text()) is None
    assert unknown.locator(".bar, .value").count() == 0


def test_old_data_are_marked_with_their_age(page: Page, page_service: ServiceProcess) -> None:
    rows = opened(page, page_service, "?urgency=due")
    cell = rows.filter(has=page.get_by_text("WS-000", exact=True)).locator(".c-data")
    assert re.fullmatch(r"(\d+ d|[\d.]+ years) ago\s+old", cell.inner_text())


def test_filters_narrow_the_list_and_stay_in_the_address(
    page: Page, page_service: ServiceProcess, client: httpx.Client
) -> None:
    opened(page, page_service)
    page.select_option('select[name="urgency"]', "probably_over")
    page.fill('input[name="vehicle"]', "V-1")
    page.press('input[name="vehicle"]', "Enter")
    wanted = client.get("/v1/wheelsets?urgency=probably_over&vehicle=V-1&sort=urgency").json()["items"]
    expect(page.locator(ROWS)).to_have_count(len(wanted))
    assert serials(page) == [item["serial"] for item in wanted]
    assert "urgency=probably_over" in page.url
    page.reload()
    expect(page.locator(ROWS)).to_have_count(len(wanted))
    page.select_option('select[name="status"]', "invalid")
    expect(page.locator('[data-state="empty"]')).to_contain_text("No wheelset fits these filters")


def test_a_vehicle_that_is_none_is_an_error_in_the_words_of_the_api(page: Page, page_service: ServiceProcess) -> None:
    page.goto(f"{page_service.url}/#/?vehicle=V-99")
    expect(page.locator('[data-state="error"]')).to_contain_text("V-99")


def test_choices_are_those_of_the_api(page: Page, page_service: ServiceProcess) -> None:
    opened(page, page_service)
    for name in ("urgency", "status", "alert_kind"):  # they are read beside the rows, which do not wait for them
        expect(page.locator(f'select[name="{name}"] option').nth(1)).to_be_attached()

    def choices(name: str) -> set[str]:
        values = page.locator(f'select[name="{name}"] option').evaluate_all("options => options.map(o => o.value)")
        return set(values) - {""}

    assert choices("urgency") == set(Urgency)
    assert choices("status") == set(Status)
    document = httpx.get(f"{page_service.url}/openapi.json").json()
    listed = document["paths"]["/v1/wheelsets"]["get"]["parameters"]
    kinds = next(one for one in listed if one["name"] == "alert_kind")["schema"]["anyOf"][0]["enum"]
    assert choices("alert_kind") == set(kinds)


def test_a_head_sorts_and_sorts_the_other_way(page: Page, page_service: ServiceProcess, client: httpx.Client) -> None:
    opened(page, page_service)
    head = page.locator("thead th.c-mileage")
    for sort, direction in (("-mileage", "descending"), ("mileage", "ascending")):
        head.get_by_role("button").click()
        expect(head).to_have_attribute("aria-sort", direction)
        wanted = client.get("/v1/wheelsets", params={"sort": sort, "limit": 5}).json()["items"]
        expect(page.locator(f"{ROWS} .c-serial a").first).to_have_text(wanted[0]["serial"])
        assert serials(page)[:5] == [item["serial"] for item in wanted]


def test_keys_move_through_the_rows_and_open_one(page: Page, page_service: ServiceProcess) -> None:
    rows = opened(page, page_service)
    rows.first.focus()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowUp")
    expect(rows.nth(1)).to_be_focused()
    serial = serials(page)[1]
    page.keyboard.press("Enter")
    page.wait_for_url(f"**/#/wheelsets/{serial}")
    page.go_back()
    rows.first.wait_for()
    rows.first.focus()
    page.keyboard.press("End")  # what follows is read as it comes into sight
    expect(page.locator(".view-head .quiet")).not_to_contain_text("of more")
    focused = page.locator(f"{ROWS}:focus")
    expect(focused).to_have_count(1)
    assert int(focused.get_attribute("data-index") or 0) > MOST_DRAWN


def test_a_view_that_was_left_while_its_files_were_read_does_not_cover_the_next(
    page: Page, page_service: ServiceProcess
) -> None:
    held: list[Route] = []

    def hold(request: Route) -> None:
        held.append(request)

    page.route("**/wheelset.js", hold)
    rows = opened(page, page_service)
    page.evaluate("serial => { location.hash = `#/wheelsets/${serial}`; history.back(); }", serials(page)[0])
    page.wait_for_timeout(1000.0)  # longer than a view may take before it is shown as loading
    expect(rows.first).to_be_visible()
    assert held
    for request in held:
        request.continue_()


def test_many_rows_are_read_as_they_are_scrolled_and_few_are_drawn(
    page: Page, page_service: ServiceProcess, client: httpx.Client
) -> None:
    rows = opened(page, page_service)
    everyone = len(client.get("/v1/wheelsets?limit=1000").json()["items"])
    count = page.locator(".view-head .quiet")
    expect(count).to_contain_text("of more")
    shown = 60
    while shown < everyone:  # a page more each time that the end comes into sight
        page.locator(".scroller").evaluate("scroller => scroller.scrollTo(0, scroller.scrollHeight)")
        shown = min(shown + 100, everyone)
        expect(count).to_contain_text(re.compile(rf"^{shown} "))
    expect(count).to_have_text(f"{everyone} wheelsets")
    page.locator(".scroller").evaluate("scroller => scroller.scrollTo(0, scroller.scrollHeight)")
    expect(rows.last).to_have_attribute("data-index", str(everyone - 1))
    assert rows.count() < MOST_DRAWN
    expect(page.locator("table.rows")).to_have_attribute("aria-rowcount", str(everyone + 1))


def test_names_with_markup_and_unseen_characters_are_text(page: Page, page_service: ServiceProcess) -> None:
    opened(page, page_service, "?urgency=not_mounted&sort=serial")
    shown = page.locator(f"{ROWS} .c-serial a")
    expect(shown.nth(0)).to_have_text(page_fleet.MARKUP)
    expect(shown.nth(1)).to_have_text(page_fleet.FORMULA)
    assert page.locator("main img").count() == 0
    assert page.title() == "Fleet \u2013 treadwatch"
    page.goto(f"{page_service.url}/#/?urgency=not_mounted&sort=-serial")
    expect(shown.filter(has_text="WS\ufffd-7\ufffd")).to_have_count(1)


def test_the_whole_list_is_saved_as_a_table(page: Page, page_service: ServiceProcess, client: httpx.Client) -> None:
    opened(page, page_service)
    with page.expect_download() as download:
        page.get_by_role("button", name="Save as CSV").click()
    rows = list(csv.DictReader(io.StringIO(download.value.path().read_text())))
    items = client.get("/v1/wheelsets?limit=1000&sort=urgency").json()["items"]
    assert len(rows) == len(items)
    assert f"'{page_fleet.FORMULA}" in {row["serial"] for row in rows}


def test_a_list_that_cannot_be_read_again_is_marked_with_its_age(page: Page, page_service: ServiceProcess) -> None:
    page.clock.install()
    rows = opened(page, page_service)
    page.route("**/v1/**", lambda route: route.abort())
    page.clock.fast_forward(61_000)
    notice = page.locator('[data-state="stale"]')
    expect(notice).to_contain_text("Not up to date")
    expect(page.locator("#notice")).to_contain_text("does not answer")
    assert rows.count() > 10
    page.unroute("**/v1/**")
    page.clock.fast_forward(61_000)
    expect(notice).to_have_count(0)
    expect(page.locator("#notice")).to_be_hidden()


def test_paper_shows_the_rows_that_were_read_and_no_controls(page: Page, page_service: ServiceProcess) -> None:
    rows = opened(page, page_service)
    on_screen = rows.count()
    page.emulate_media(media="print")
    expect(page.locator("header.top")).to_be_hidden()
    expect(page.locator("form.filters")).to_be_hidden()
    expect(rows).to_have_count(60)
    assert on_screen < 60
    expect(page.locator(".printed-cut")).to_have_text("The first 60 rows. The table saved as CSV has all.")
    assert page.pdf()[:5] == b"%PDF-"
    page.emulate_media(media="screen")
    expect(rows).to_have_count(on_screen)


def test_paper_says_why_and_by_when_across_a_page_of_a4(page: Page, page_service: ServiceProcess) -> None:
    rows = opened(page, page_service)
    page.set_viewport_size({"width": A4_LANDSCAPE_PX, "height": 700})
    page.emulate_media(media="print")
    expect(rows).to_have_count(60)
    first = rows.first
    for column, least in (("why", 150), ("conicity", 220), ("distance", 120), ("limitdate", 95), ("data", 75)):
        box = first.locator(f".c-{column}").bounding_box()
        assert box is not None, column
        assert box["width"] >= least, column
    assert page.evaluate("document.documentElement.scrollWidth") <= A4_LANDSCAPE_PX


def test_paper_shows_the_first_rows_of_a_table_of_thousands_and_says_so(
    page: Page, page_service: ServiceProcess
) -> None:
    opened(page, page_service)
    page.evaluate(
        """async () => {
            const main = document.querySelector('script[type="module"]').src;
            const { table } = await import(new URL("./table.js", main));
            const columns = [{ name: "n", label: "n", cell: (row) => String(row) }];
            const made = table({ columns, label: "thousands", keyOf: (row) => row });
            document.querySelector("main").replaceChildren(made);
            made.setRows(Array.from({ length: 4000 }, (_, place) => place));
        }"""
    )
    rows = page.get_by_label("thousands").locator("tr[data-index]")
    cut = page.locator(".printed-cut")
    expect(cut).to_be_hidden()
    page.emulate_media(media="print")
    expect(rows).to_have_count(500)
    expect(cut).to_have_text("The first 500 rows. The table saved as CSV has all.")
    page.emulate_media(media="screen")
    expect(cut).to_be_hidden()
