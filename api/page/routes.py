"""``/`` and its assets: no other origin, no inline script; assets are immutable under the digest of all of them."""

from __future__ import annotations

import gzip
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from http import HTTPStatus
from importlib.resources import files
from pathlib import PurePosixPath

from fastapi import APIRouter, Request, Response
from starlette.exceptions import HTTPException

from api.answers import entity_tag

INDEX, ENTRY = "index.html", "main.js"
MEDIA_TYPES: Mapping[str, str] = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}
POLICY = (
    "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'"
)
"""Content Security Policy: everything from this origin, nothing inline."""
SECURITY: Mapping[str, str] = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
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
    found = {
        entry.name: entry.read_bytes()
        for entry in sorted(files("api.page").joinpath("assets").iterdir(), key=lambda entry: entry.name)
        if _suffix(entry.name) in MEDIA_TYPES
    }
    summed = hashlib.blake2b(digest_size=8)
    for name, content in found.items():
        summed.update(f"{name}\0{len(content)}\0".encode() + content)
    digest = summed.hexdigest()
    index = found.pop(INDEX).replace(b'"/assets/', f'"/assets/{digest}/'.encode())
    preloads = "".join(
        f'<link rel="modulepreload" href="/assets/{digest}/{name}">\n'
        for name in sorted(_imported(found, ENTRY) - {ENTRY})
    )
    index = index.replace(b"<!-- modules -->\n", preloads.encode())
    return Page(digest, _asset(INDEX, index), {name: _asset(name, content) for name, content in found.items()})


@router.get("/")
def get_page(request: Request) -> Response:
    """Return the page."""
    return _answer(request, page().index, "no-cache")


@router.get("/assets/{digest}/{name}")
def get_page_asset(request: Request, digest: str, name: str) -> Response:
    """Return a file of the page of this release."""
    found = page()
    if digest != found.digest or name not in found.assets:
        raise HTTPException(HTTPStatus.NOT_FOUND)
    return _answer(request, found.assets[name], FOR_A_YEAR)


def _answer(request: Request, asset: Asset, kept: str) -> Response:
    tag = entity_tag(asset.plain)
    headers = {**SECURITY, "Cache-Control": kept, "ETag": tag, "Vary": "Accept-Encoding"}
    if request.headers.get("if-none-match") in {tag, f"W/{tag}"}:
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    if "gzip" in request.headers.get("accept-encoding", ""):
        headers |= {"Content-Encoding": "gzip", "ETag": f"W/{tag}"}
        return Response(asset.compressed, headers=headers, media_type=asset.media_type)
    return Response(asset.plain, headers=headers, media_type=asset.media_type)


def _imported(found: Mapping[str, bytes], name: str) -> frozenset[str]:
    """Return a module and all that it imports to begin with, directly or not; without what is imported later."""
    modules: set[str] = set()
    waiting = [name]
    while waiting:
        module = waiting.pop()
        if module not in modules:
            modules.add(module)
            waiting += _IMPORT.findall(found[module].decode())
    return frozenset(modules)


def _asset(name: str, content: bytes) -> Asset:
    return Asset(MEDIA_TYPES[_suffix(name)], content, gzip.compress(content, 9, mtime=0))


def _suffix(name: str) -> str:
    return PurePosixPath(name).suffix
