"""What every view shares: the files and their weight, the policy, the theme, the keyboard, the search, states."""

from __future__ import annotations

import gzip
import re

import httpx
import pytest
from playwright.sync_api import BrowserContext, Page, Route, expect
from service_process import ServiceProcess

MOST_BYTES = 500_000
FOR_EVER = "public, max-age=31536000, immutable"


def test_page_and_assets_are_compressed_small_and_kept(page_service: ServiceProcess) -> None:
    with httpx.Client(base_url=page_service.url, headers={"Accept-Encoding": "gzip"}) as client:
        index = client.get("/")
        assert index.headers["cache-control"] == "no-cache"
        assert index.headers["content-security-policy"].startswith("default-src 'self';")
        assert "unsafe" not in index.headers["content-security-policy"]
        names = re.findall(r'(?:src|href)="(/assets/[^"]+)"', index.text)
        assert len(set(names)) > 10
        weight = len(gzip.compress(index.content))
        for name in set(names):
            asset = client.get(name)
            assert (asset.status_code, asset.headers["cache-control"]) == (200, FOR_EVER)
            assert asset.headers["content-encoding"] == "gzip"
            weight += int(asset.headers["content-length"])
            held = client.get(name, headers={"If-None-Match": asset.headers["etag"]})
            assert (held.status_code, held.content) == (304, b"")
        assert weight < MOST_BYTES / 2
        assert client.get("/", headers={"If-None-Match": index.headers["etag"]}).status_code == 304
        plain = client.get("/", headers={"Accept-Encoding": "identity"})
        assert "content-encoding" not in plain.headers
        assert plain.text == index.text
        digest = names[0].split("/")[2]
        for missing in (f"/assets/{digest}/none.js", "/assets/0000/app.css", f"/assets/{digest}/..%2F__init__.py"):
            assert client.get(missing).status_code == 404
        assert "Copyright (c)" in client.get(f"/assets/{digest}/uPlot.LICENSE.txt").text
        assert client.head("/").status_code == 200


def test_nothing_on_the_page_is_inline(page_service: ServiceProcess) -> None:
    index = httpx.get(page_service.url).text
    assert re.findall(r"<script(?![^>]*\bsrc=)", index) == []
    assert re.findall(r"<style|\sstyle=|\son\w+=", index) == []


def test_the_policy_is_in_force(context: BrowserContext, page_service: ServiceProcess) -> None:
    page = context.new_page()  # not the one of which nothing may be said on the console
    page.goto(page_service.url)
    outcome = page.evaluate(
        """() => new Promise(resolve => {
            addEventListener('securitypolicyviolation', event => resolve(event.effectiveDirective));
            const script = document.createElement('script');
            script.textContent = 'window.ran = true';
            document.body.append(script);
            setTimeout(() => resolve('ran'), 2000);
        })"""
    )
    assert outcome == "script-src-elem"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_theme_follows_the_system_until_another_is_chosen(
    page: Page, page_service: ServiceProcess, scheme: str
) -> None:
    page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
    page.goto(page_service.url)
    root, other = page.locator("html"), {"light": "dark", "dark": "light"}[scheme]
    expect(root).to_have_attribute("data-theme", scheme)
    page.click("#theme")
    expect(root).to_have_attribute("data-theme", other)
    page.reload()
    expect(root).to_have_attribute("data-theme", other)
    shade = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (int(re.findall(r"\d+", shade)[0]) < 128) == (other == "dark")


def test_keys_lead_to_the_search_and_explain_themselves(page: Page, page_service: ServiceProcess) -> None:
    page.goto(page_service.url)
    page.locator("tbody tr[data-index]").first.wait_for()
    page.keyboard.press("/")
    expect(page.locator("#search-field")).to_be_focused()
    page.keyboard.press("Escape")
    expect(page.locator("#search-field")).not_to_be_focused()
    page.keyboard.press("?")
    expect(page.locator("dialog")).to_contain_text("find a wheelset or a vehicle")
    page.keyboard.press("Escape")
    expect(page.locator("dialog")).to_have_count(0)


def test_search_finds_a_wheelset_and_a_vehicle_or_says_that_there_is_none(
    page: Page, page_service: ServiceProcess
) -> None:
    page.goto(page_service.url)
    for wanted, place in (("WS-003", "#/wheelsets/WS-003"), ("V-1", "#/?vehicle=V-1")):
        page.fill("#search-field", wanted)
        page.press("#search-field", "Enter")
        page.wait_for_function("wanted => location.hash === wanted", arg=place)
    page.fill("#search-field", "nothing")
    page.press("#search-field", "Enter")
    page.wait_for_function("() => document.getElementById('search-field').validationMessage.includes('nothing')")


def test_an_unknown_address_is_said_to_be_none(page: Page, page_service: ServiceProcess) -> None:
    page.goto(f"{page_service.url}/#/nowhere")
    expect(page.locator('[data-state="error"]')).to_contain_text("no such view")


def test_a_view_that_is_refused_says_why_and_tries_again(page: Page, page_service: ServiceProcess) -> None:
    def refuse(route: Route) -> None:
        problem = {
            "type": "urn:treadwatch:problem:not-ready",
            "title": "Not ready",
            "detail": "no database",
            "status": 503,
        }
        route.fulfill(status=503, json=problem, content_type="application/problem+json")

    page.route("**/v1/wheelsets**", refuse)
    page.goto(page_service.url)
    failed = page.locator('[data-state="error"]')
    expect(failed).to_contain_text("no database")
    expect(failed).to_contain_text("waiting for its database")
    page.unroute("**/v1/wheelsets**")
    failed.get_by_role("button", name="Try again").click()
    page.locator("tbody tr[data-index]").first.wait_for()
