"""The page on ``/``, Swagger UI on ``/docs``: no other origin; assets are immutable under the digest of all."""

from __future__ import annotations

import gzip
import hashlib
import re
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from http import HTTPStatus
from importlib.resources import files
from pathlib import PurePosixPath

from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.openapi.docs import get_swagger_ui_html
from starlette.exceptions import HTTPException

from api.access.guard import PAGE_POLICY
from api.answers import answer_bytes, entity_tag

INDEX, ENTRY = "index.html", "main.js"
MEDIA_TYPES: Mapping[str, str] = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}
FOR_A_YEAR = "public, max-age=31536000, immutable"
_IMPORT = re.compile(r'^import .*from "\./([\w.]+)";$', re.MULTILINE)
router = APIRouter(include_in_schema=False)


@dataclass(frozen=True, slots=True)
class Asset:
    """A file as it is sent: plain and compressed."""

    media_type: str
    plain: bytes
    compressed: bytes


@dataclass(frozen=True, slots=True)
class Page:
    """The page and its assets; ``digest`` is in the path of every asset, so that one page never mixes two releases."""

    digest: str
    index: Asset
    assets: Mapping[str, Asset]


@cache
def page() -> Page:
    """Return the files of the page, read and compressed once a process."""
    contents = {
        entry.name: entry.read_bytes()
        for entry in sorted(files("api.page").joinpath("assets").iterdir(), key=lambda entry: entry.name)
        if _suffix(entry.name) in MEDIA_TYPES
    }
    summed = hashlib.blake2b(digest_size=8)
    for name, content in contents.items():
        summed.update(f"{name}\0{len(content)}\0".encode() + content)
    digest = summed.hexdigest()
    index = contents.pop(INDEX).replace(b'"/assets/', f'"/assets/{digest}/'.encode())
    preloads = "".join(
        f'<link rel="modulepreload" href="/assets/{digest}/{name}">\n'
        for name in sorted(_imported(contents, ENTRY) - {ENTRY})
    )
    index = index.replace(b"<!-- modules -->\n", preloads.encode())
    return Page(digest, _asset(INDEX, index), {name: _asset(name, content) for name, content in contents.items()})


@router.get("/")
def get_page(request: Request) -> Response:
    """Return the page."""
    return _answer(request, page().index, "no-cache")


@router.get("/assets/{digest}/{name}")
def get_page_asset(request: Request, digest: str, name: str) -> Response:
    """Return a file of the page of this release."""
    current = page()
    if digest != current.digest or name not in current.assets:
        raise HTTPException(HTTPStatus.NOT_FOUND)
    return _answer(request, current.assets[name], FOR_A_YEAR)


def _answer(request: Request, asset: Asset, kept: str) -> Response:
    tag = entity_tag(asset.plain)
    headers = {"Cache-Control": kept, "ETag": tag, "Vary": "Accept-Encoding"}
    if request.headers.get("if-none-match") in {tag, f"W/{tag}"}:
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    if "gzip" in request.headers.get("accept-encoding", ""):
        headers |= {"Content-Encoding": "gzip", "ETag": f"W/{tag}"}
        return Response(asset.compressed, headers=headers, media_type=asset.media_type)
    return Response(asset.plain, headers=headers, media_type=asset.media_type)


def _imported(contents: Mapping[str, bytes], name: str) -> frozenset[str]:
    """Return a module and all that it imports to begin with, directly or not; without what is imported later."""
    modules: set[str] = set()
    waiting = [name]
    while waiting:
        module = waiting.pop()
        if module not in modules:
            modules.add(module)
            waiting += _IMPORT.findall(contents[module].decode())
    return frozenset(modules)


def _asset(name: str, content: bytes) -> Asset:
    return Asset(MEDIA_TYPES[_suffix(name)], content, gzip.compress(content, 9, mtime=0))


def _suffix(name: str) -> str:
    return PurePosixPath(name).suffix


_INLINE = re.compile(rb"<script>(.*?)</script>", re.DOTALL)
_ASSETS = {
    "swagger-ui-bundle.js": "text/javascript; charset=utf-8",
    "swagger-ui.css": "text/css; charset=utf-8",
    "favicon-32x32.png": "image/png",
}
DOCUMENT = "/openapi.json"


@router.get("/docs")
async def get_docs(request: Request) -> Response:
    """Return the page."""
    app: FastAPI = request.app
    page = get_swagger_ui_html(
        openapi_url=DOCUMENT,
        title=app.title,
        swagger_js_url="/docs/assets/swagger-ui-bundle.js",
        swagger_css_url="/docs/assets/swagger-ui.css",
        swagger_favicon_url="/docs/assets/favicon-32x32.png",
        swagger_ui_parameters={"tryItOutEnabled": True, "displayRequestDuration": True, "defaultModelsExpandDepth": 0},
    )
    scripts = (b64encode(sha256(script).digest()).decode() for script in _INLINE.findall(bytes(page.body)))
    allowed = " ".join(f"'sha256-{digest}'" for digest in scripts)
    page.headers["Content-Security-Policy"] = (
        f"{PAGE_POLICY}; script-src 'self' {allowed}; style-src 'self' 'unsafe-inline'"
    )
    return page


@router.get(DOCUMENT)
async def get_document(request: Request) -> Response:
    """Return the committed document; the framework's own would lack what is added to it."""
    return answer_bytes(request, request.app.state.document)


@router.get("/docs/assets/{name}")
def get_docs_asset(name: str) -> Response:
    """Return a file of the page."""
    if name not in _ASSETS:
        raise HTTPException(HTTPStatus.NOT_FOUND)
    content = files("fastapi_swagger").joinpath("resources", name).read_bytes()
    return Response(content, media_type=_ASSETS[name], headers={"Cache-Control": "public, max-age=3600"})
