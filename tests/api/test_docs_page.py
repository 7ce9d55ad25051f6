"""The page on /docs, which must work without any other origin."""

from __future__ import annotations

import re
from urllib.parse import urljoin, urlparse

import httpx


def test_the_page_loads_everything_from_its_own_origin(client: httpx.Client) -> None:
    page = client.get("/docs")
    assert page.status_code == 200
    assert page.headers["content-type"].startswith("text/html")
    loaded = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    assert len(loaded) >= 3
    for reference in loaded:
        assert urlparse(urljoin("/docs", reference)).netloc == ""
        asset = client.get(reference)
        assert asset.status_code == 200
        assert len(asset.content) > 100
    assert "http://" not in page.text
    assert "https://" not in page.text
    assert re.search(r"""url: ['"]/openapi.json['"]""", page.text)


def test_the_page_is_a_swagger_ui_that_reads_openapi_3_1(client: httpx.Client) -> None:
    bundle = client.get("/docs/assets/swagger-ui-bundle.js")
    assert bundle.headers["content-type"].startswith("text/javascript")
    assert re.search(r"openapi:3\.1|3\\\.1", bundle.text)
    assert client.get("/docs/assets/../../api/settings.py").status_code == 404
    assert client.get("/docs/assets/swagger-ui.map").status_code == 404
