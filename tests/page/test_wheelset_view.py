"""A wheelset's view and its printed sheet: what is drawn is what the API gives, and what is unknown is absent."""

from __future__ import annotations

import re
from typing import Any

import api_fleet as fleet
import httpx
import page_fleet
import pytest
from playwright.sync_api import Locator, Page, expect
from service_process import ServiceProcess

SERIAL = fleet.WHEELSETS[0]


def opened(page: Page, service: ServiceProcess, serial: str, view: str = "") -> Locator:
    page.goto(f"{service.url}/#/wheelsets/{serial}{view}")
    shown = page.locator(".sheet" if view else ".wheelset")
    shown.wait_for()
    return shown


def got(service: ServiceProcess, path: str) -> Any:  # noqa: ANN401 - JSON
    return httpx.get(f"{service.url}{path}").raise_for_status().json()


def numbers(view: Locator, chart: str, series: str) -> list[list[str]]:
    """Return the rows of one series in the table of numbers of a chart, which is what the chart was given."""
    found = view.locator(f'[data-chart="{chart}"]')
    if found.locator(".numbers table").count() == 0:
        found.locator(".numbers summary").click()
        found.locator(".numbers table").first.wait_for()
    table = found.locator(".numbers table").filter(has=view.page.locator("caption", has_text=series))
    return [row.locator("td").all_inner_texts() for row in table.locator("tbody tr").all()]


def drawn(view: Locator, chart: str) -> bool:
    """Return whether anything but one colour is on the canvas of a chart."""
    canvas = view.locator(f'[data-chart="{chart}"] canvas')
    canvas.wait_for()
    script = """canvas => {
        const seen = new Set();
        const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
        for (let i = 0; i < data.length; i += 4) seen.add(data.slice(i, i + 4).join());
        return seen.size > 5;
    }"""
    return bool(canvas.evaluate(script))


def text(value: float | None, digits: int = 3) -> str:
    return "unknown" if value is None else f"{value:,.{digits}f}".replace("-", "\u2212")


def test_conicity_and_radii_are_drawn_as_the_api_gives_them(page: Page, page_service: ServiceProcess) -> None:
    view = opened(page, page_service, SERIAL)
    geometry = got(page_service, f"/v1/wheelsets/{SERIAL}/geometry")
    expected = []
    for one in geometry["conicity_by_amplitude"]:
        found = one["equivalent_conicity_1"]
        low, high = found["interval_95"] or (None, None)
        expected.append([f"{one['amplitude_mm']:g}", text(found["value"]), text(low), text(high)])
    assert numbers(view, "conicity", "estimate") == expected
    assert expected[2][1] == "unknown", "3 mm is not covered: it is a gap, not a zero"
    expect(view.locator('[data-chart="conicity"] .absent')).to_contain_text("amplitude not covered: 3.00 to 3.00 mm")
    radii = geometry["bins"]["rolling_radius_difference_mm"]
    assert [row[1] for row in numbers(view, "rolling_radius_difference_mm", "estimate")] == [
        text(value) for value in radii["value"]
    ]
    absent = view.locator('[data-chart="rolling_radius_difference_mm"] .absent').first
    expect(absent).to_contain_text("too few samples: 1 of 4 bins; contact jump: 1 of 4 bins")
    design = got(page_service, f"/v1/wheelsets/{SERIAL}/contact")["contact"]["conicity_by_amplitude"]
    assert [row[1] for row in numbers(view, "conicity", "design P8")] == [
        text(one["equivalent_conicity_1"]["value"]) for one in design
    ]
    assert all(drawn(view, chart) for chart in ("conicity", "rolling_radius_difference_mm", "trend-mileage"))
    assert view.locator('[data-chart="occupancy"] rect').count() == 4
    assert view.locator('[data-chart="occupancy"] rect.absent-bin').count() == 2


def test_the_trend_has_its_fan_and_the_forecast_in_words(page: Page, page_service: ServiceProcess) -> None:
    view = opened(page, page_service, SERIAL)
    trend = got(page_service, f"/v1/wheelsets/{SERIAL}/trend")
    points = numbers(view, "trend-mileage", "points of the trend")
    assert [row[1] for row in points] == [text(value) for value in trend["points"]["value_1"]]
    assert points[-1][2:] == ["unknown", "unknown"], "the last has no standard deviation"
    fan = numbers(view, "trend-mileage", "p50")
    assert fan[-1] == ["22,001", text(0.4)]
    assert numbers(view, "trend-mileage", "p90") == [], "beyond the horizon: no line"
    expect(view.locator('[data-panel="summary"]')).to_contain_text(
        "in 11,000 km (80 %: 8,000 km to beyond the horizon)"
    )
    expect(view.locator('[data-panel="events"]')).to_contain_text("reprofiled")


def test_what_was_measured_is_beside_the_estimate_and_alerts_can_be_acted_on(
    page: Page, page_service: ServiceProcess
) -> None:
    view = opened(page, page_service, SERIAL)
    measured = view.locator('[data-panel="measured"]')
    expect(measured).to_contain_text("nothing was estimated since")
    expect(measured).to_contain_text("no measures of flange and tread")
    expect(measured.locator("td.right").first).to_have_text("unknown")  # cones have no flange
    alerts = view.locator('[data-panel="alerts"]')
    expect(alerts.locator(".alert-line").first).to_contain_text("Turn the wheelset, or measure its profiles.")
    expect(alerts.get_by_role("button", name="Acknowledge").first).to_be_visible()
    expect(view.locator('[data-panel="quality"]')).to_contain_text("30 windows from 2025-06-15")
    expect(view.locator('[data-panel="fit"]')).to_contain_text("4 mm is not covered")


def test_a_wheelset_without_data_says_so_and_one_that_is_none_too(page: Page, page_service: ServiceProcess) -> None:
    view = opened(page, page_service, fleet.NO_DATA_YET)
    notice = view.locator('[data-panel="reasons"]')
    expect(notice).to_contain_text("Nothing has been estimated of this wheelset yet.")
    expect(notice).to_contain_text("it runs under no vehicle, and no window of it has been received")
    expect(notice).to_contain_text("Register its mounting.")
    expect(view).to_contain_text("There is no trend yet")
    expect(view).to_contain_text("No profile of this wheelset has been measured")
    expect(view).to_contain_text("No window of data has been received yet.")
    assert view.locator('[data-chart="trend-mileage"]').count() == 0
    page.goto(f"{page_service.url}/#/wheelsets/none")
    expect(page.locator('[data-state="error"]')).to_contain_text("It does not exist")


@pytest.mark.parametrize("width", [1440, 390])
def test_a_wheelset_whose_windows_are_refused_says_why_and_what_to_do(
    page: Page, page_service: ServiceProcess, width: int
) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    view = opened(page, page_service, page_fleet.REFUSED)
    notice = view.locator('[data-panel="reasons"]')
    because = got(page_service, f"/v1/wheelsets/{page_fleet.REFUSED}/geometry")["unestimated_because"]
    rows = [row.locator("td").all_inner_texts() for row in notice.locator("tbody tr").all()]
    assert [(row[0], row[1]) for row in rows] == [("3", "refused"), ("1", "pending"), ("1", "refused")]
    for row, one in zip(rows, because["reasons"], strict=True):
        assert one["reason"] in row[2], "as it is, not as markup"
        assert row[3] == one["what_to_do"]
    expect(notice).to_contain_text(because["what_to_do"])
    expect(notice).to_contain_text("Its newest 5 windows since 2025-06-15 are counted: 4 refused, 1 pending.")
    assert view.locator('[data-chart="trend-mileage"]').count() == 0
    assert page.evaluate("document.documentElement.scrollWidth") == width, "nothing is cut off"


def test_the_sheet_is_one_page_of_a4_with_the_whole_life(page: Page, page_service: ServiceProcess) -> None:
    view = opened(page, page_service, SERIAL, "/sheet")
    for expected in ("Wheelset WS-000", "V-0, axle 1", "9,000 km", "conicity limit", "Measured profiles"):
        expect(view).to_contain_text(expected)
    assert drawn(view, "trend-mileage")
    widths = view.evaluate("node => [node.clientWidth, node.scrollWidth]")
    assert widths[0] >= widths[1], "nothing is cut off"
    pdf = page.pdf(prefer_css_page_size=True)
    assert len(re.findall(rb"/Type\s*/Page\b", pdf)) == 1
    ((width, height),) = re.findall(rb"/MediaBox\s*\[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    assert (round(float(width)), round(float(height))) == (595, 842)
