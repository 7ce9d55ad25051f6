"""Which requests are uploads: their bodies are not gathered before the route begins."""

from __future__ import annotations

from starlette.types import Scope

FOLDER = "/v1/chunks/"


def is_upload(scope: Scope) -> bool:
    """Return whether a request sends a chunk."""
    return bool(scope["method"] == "PUT" and scope["path"].startswith(FOLDER))
