"""Every view: light, dark, on a tablet; track sections with band, versions and reasons; operation."""

from __future__ import annotations

import re
import time

import httpx
import measured_fleet
import pytest
from playwright.sync_api import Page, expect
from service_process import ServiceProcess

from estimation.values.reasons import Reason, ReasonCode
from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.storage import SqlStorage

VIEWS = (
    "#/",
    "#/plan",
    "#/alerts",
    "#/alerts/1",
    "#/tracks",
    "#/tracks/S-1",
    "#/tracks/S-3",
    "#/accuracy",
    "#/operation",
)
TABLET = {"width": 1024, "height": 768}


@pytest.mark.parametrize("place", VIEWS)
def test_a_view_fits_a_tablet_in_both_themes_without_a_complaint(
    page: Page, page_service: ServiceProcess, place: str
) -> None:
    page.set_viewport_size(TABLET)  # type: ignore[arg-type]
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        page.goto(f"{page_service.url}/{place}")
        expect(page.locator("main h1")).to_be_visible()
        expect(page.locator('[data-state="loading"]')).to_have_count(0)
        assert page.locator('[data-state="error"]').count() == 0
        assert page.evaluate("document.documentElement.scrollWidth") <= TABLET["width"]


def test_a_section_shows_its_alignment_with_band_versions_and_the_last_run(
    page: Page, page_service: ServiceProcess
) -> None:
    page.goto(f"{page_service.url}/#/tracks/S-3")
    charts = page.locator("figure.chart")
    expect(charts).to_have_count(2)
    expect(charts.first.locator("canvas")).to_be_visible()
    numbers = charts.first.locator("details")
    numbers.locator("summary").click()
    # version 3: 1.5 mm halved three times, std 0.5 mm
    expect(numbers.locator("tbody tr").first).to_have_text("00.19\u22120.791.17")
    page.locator("main").get_by_text("Gauge deviation: not on file").wait_for()
    versions = page.locator("section", has_text="Versions, the newest first").last.locator("tbody tr")
    assert [text.split("\t")[0] for text in versions.all_inner_texts()] == ["3", "2", "1"]
    expect(page.locator("main")).to_contain_text("no: agrees with no other")
    expect(page.locator("main")).to_contain_text("2: the sensor reports a fault")


def test_a_section_without_an_alignment_says_why(page: Page, page_service: ServiceProcess) -> None:
    page.goto(f"{page_service.url}/#/tracks/S-2")
    expect(page.locator('[data-state="empty"]')).to_contain_text("the passes are too alike")
    assert page.locator("canvas").count() == 0


def test_operation_shows_jobs_silence_and_what_is_held(
    page: Page, page_service: ServiceProcess, client: httpx.Client
) -> None:
    page.goto(f"{page_service.url}/#/operation")
    jobs = page.get_by_label("Jobs")
    expect(jobs.locator("tbody tr")).to_have_count(len(client.get("/v1/jobs").json()["items"]))
    expect(jobs).to_contain_text("6 estimated")
    expect(jobs).to_contain_text("overdue")
    held = client.get("/v1/quarantine?state=held").json()["items"]
    quarantine = page.get_by_label("Quarantine")
    expect(quarantine.locator("tbody tr")).to_have_count(len(held))
    expect(quarantine).to_contain_text(held[0]["reason"])
    expect(page.get_by_label("Silent vehicles")).to_contain_text("V-0")
    jobs.get_by_role("link", name="estimate windows").click()
    expect(page.locator("main tbody tr")).to_have_count(7)


def test_a_vehicle_whose_newest_recordings_are_all_rejected_comes_first(
    page: Page, page_service: ServiceProcess, stored: SqlStorage
) -> None:
    now_ns, hour_ns = time.time_ns(), 3600 * 10**9
    wrong = Reason(ReasonCode.LOG_DAMAGED, "of another bus")
    kept = [("V-8", 5, None), ("V-9", 4, None), ("V-9", 3, wrong), ("V-9", 2, wrong)]
    with stored.write() as unit:
        for number, (vehicle, ago, reason) in enumerate(kept):
            at_ns, state = now_ns - ago * hour_ns, ChunkState.DECODED if reason is None else ChunkState.REJECTED
            frames = 80 if reason is None else 0
            digest = f"{number:02x}" * 32
            unit.chunks.put(
                ChunkRecord(digest, vehicle, ".blf", 1, state, reason, at_ns, at_ns + 1, frames, {}, at_ns, at_ns)
            )
    page.goto(f"{page_service.url}/#/operation")
    lines = page.get_by_label("Receiving").locator("tbody tr")
    expect(lines.first).to_contain_text(re.compile(r"V-9\s*2 h ago\s*the last 2 rejected\s*80\s*of another bus"))
    expect(lines.nth(1)).to_contain_text(re.compile(r"V-8\s*5 h ago\s*decoded\s*80"))


def test_accuracy_counts_the_intervals_that_cover_and_lists_every_measurement(
    page: Page, page_service: ServiceProcess, client: httpx.Client
) -> None:
    found = client.get("/v1/accuracy?limit=500").json()
    page.goto(f"{page_service.url}/#/accuracy")
    summary = page.get_by_label("Do the intervals cover?")
    expect(summary).to_contain_text("1 of 2 50 %[6 %, 94 %]")
    z = found["coverage"]["everything"]["z_rms_1"]
    expect(summary).to_contain_text(f"z rms, all comparisons{z:.2f}")
    expect(page.get_by_label("z over time", exact=True).locator("canvas").first).to_be_visible()
    rows = page.get_by_label("Measurements").locator("tbody tr")
    expect(rows).to_have_count(len(found["measurements"]))
    expect(rows.filter(has_text=measured_fleet.SERIAL).first).to_contain_text("covered")
    expect(rows.filter(has_text=measured_fleet.OTHER).first).to_contain_text("not covered")
    expect(rows.filter(has_text=measured_fleet.BARE).first).to_contain_text("not compared")
    expect(page.get_by_label("Estimated against measured").locator("canvas").first).to_be_visible()
    page.locator('select[name="fleet"]').select_option("=beta")
    expect(rows).to_have_count(len(client.get("/v1/accuracy?fleet=%3Dbeta").json()["measurements"]))
    rows.first.get_by_role("link").click()
    expect(page.locator("main h1")).to_be_visible()
