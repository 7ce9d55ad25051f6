"""The page on ``/docs``: Swagger UI from files that were installed with us, so that it needs no other origin."""

from __future__ import annotations

import re
from base64 import b64encode
from hashlib import sha256
from http import HTTPStatus
from importlib.resources import files

from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.openapi.docs import get_swagger_ui_html
from starlette.exceptions import HTTPException

from api.access.security_headers import PAGE_POLICY
from api.answers import answer_bytes

_INLINE = re.compile(rb"<script>(.*?)</script>", re.DOTALL)
_ASSETS = {
    "swagger-ui-bundle.js": "text/javascript; charset=utf-8",
    "swagger-ui.css": "text/css; charset=utf-8",
    "favicon-32x32.png": "image/png",
}
DOCUMENT = "/openapi.json"
router = APIRouter(include_in_schema=False)


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
    page.headers["Content-Security-Policy"] = _policy(bytes(page.body))
    return page


def _policy(page: bytes) -> str:
    """Return what the page may do: its own files, and the one script and the styles that stand in it."""
    scripts = (b64encode(sha256(script).digest()).decode() for script in _INLINE.findall(page))
    allowed = " ".join(f"'sha256-{digest}'" for digest in scripts)
    return f"{PAGE_POLICY}; script-src 'self' {allowed}; style-src 'self' 'unsafe-inline'"


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
