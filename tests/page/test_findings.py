"""What other methods say of a wheelset and of rails is shown beside the geometry, never instead of it."""

from __future__ import annotations

import re

import api_fleet as fleet
import httpx
from playwright.sync_api import Page, expect
from service_process import ServiceProcess

SERIAL = fleet.WHEELSETS[0]


def panel(page: Page, service: ServiceProcess, place: str, title: str) -> str:
    page.goto(f"{service.url}/#/{place}")
    shown = page.locator("section.panel", has=page.locator("h2", has_text=re.compile(f"^{title}$")))
    shown.wait_for()
    return re.sub(r"\s+", " ", shown.inner_text())


def test_a_wheelset_shows_its_signature_beside_its_geometry_and_where_they_disagree(
    page: Page, page_service: ServiceProcess, client: httpx.Client
) -> None:
    found = client.get(f"/v1/wheelsets/{SERIAL}/signature").json()
    shown = panel(page, page_service, f"wheelsets/{SERIAL}", "Second opinions")
    assert found["equivalent_conicity_at_3_mm_1"]["value"] == 0.3125
    assert "0.313" in shown
    assert f"{found['library_wheelsets']} wheelsets of known conicity" in shown
    assert ("methods disagree" in shown) is found["compared"]["disagree"]
    for one in found["used_entries"]:
        expect(page.get_by_role("link", name=one["wheelset"], exact=True)).to_be_visible()


def test_a_wheelset_that_no_other_method_has_looked_at_says_so(page: Page, page_service: ServiceProcess) -> None:
    shown = panel(page, page_service, f"wheelsets/{fleet.WHEELSETS[3]}", "Second opinions")
    assert "No other method has looked at this wheelset yet." in shown


def test_a_section_shows_its_friction_and_its_rails(
    page: Page, page_service: ServiceProcess, client: httpx.Client
) -> None:
    friction = client.get("/v1/track-sections/S-1/adhesion").json()
    shown = panel(page, page_service, "tracks/S-1", "Friction")
    assert f"{friction['windows']} windows" in shown
    assert "low adhesion at 150 to 200 m" in shown
    assert "left out vehicle C-9 shows 0.44 times the 1/friction" in shown
    rails = client.get("/v1/track-sections/S-1/rails").json()
    shown = panel(page, page_service, "tracks/S-1", "Rails")
    assert f"{rails['periods'][-1]['n_wheelsets']} wheelsets" in shown
    assert ("limit exceeded" in shown) is bool(rails["limit_exceeded"])


def test_a_section_of_which_nothing_is_found_says_so(page: Page, page_service: ServiceProcess) -> None:
    assert "No pass has shown the friction" in panel(page, page_service, "tracks/S-2", "Friction")
    assert "have not been parted here yet" in panel(page, page_service, "tracks/S-2", "Rails")
