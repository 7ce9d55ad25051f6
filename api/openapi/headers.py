"""Headers in the OpenAPI document: what answers carry, and what requests must."""

from __future__ import annotations

from collections.abc import Mapping
from http import HTTPMethod
from typing import Any

RESPONSE_HEADERS: Mapping[str, str] = {
    "Allow": "The methods of this path.",
    "Cache-Control": "`no-cache`: keep it, and ask with `If-None-Match` before it is used again.",
    "ETag": "Of this representation; for `If-None-Match`, and for `If-Match` of changes.",
    "Idempotency-Replayed": "`true` where the first answer under this `Idempotency-Key` is sent again.",
    "Link": 'The next page, `rel="next"`; absent on the last page of a list.',
    "Location": "The path of what was created.",
    "Retry-After": "Seconds after which to try again.",
    "Vary": "`Accept`: another media type is another representation.",
    "WWW-Authenticate": "How to authenticate (RFC 6750).",
    "X-Accel-Buffering": "`no`: proxies hand each part on at once.",
    "X-Request-Id": "Name of this request in the log; that of the request's own `X-Request-Id` where it sent one.",
}
_REPRESENTATION = ("ETag", "Cache-Control", "Vary")
_STREAM = ("Cache-Control", "X-Accel-Buffering")
_OF_STATUS: Mapping[str, tuple[str, ...]] = {
    "200": _REPRESENTATION,
    "201": (*_REPRESENTATION, "Location"),
    "202": (*_REPRESENTATION, "Location"),
    "304": _REPRESENTATION,
    "401": ("WWW-Authenticate",),
    "405": ("Allow",),
    "412": ("ETag",),
    "429": ("Retry-After",),
    "503": ("Retry-After",),
}
_PAGED = "next_cursor"
IF_MATCH = "If-Match"


def describe_headers(method: str, operation: dict[str, Any], schemas: Mapping[str, Any]) -> None:
    """Add to an operation the headers of its answers, and that ``If-Match`` is required where it is taken.

    The service answers a request without it with 428 rather than with 422, so the route itself cannot require it.
    """
    for parameter in operation.get("parameters", ()):
        if parameter["name"] == IF_MATCH:
            parameter["required"] = True
            parameter["schema"] = {"type": "string", "title": IF_MATCH, "examples": ['"9f86d081884c7d65"']}
    for status, response in operation["responses"].items():
        names = {"X-Request-Id", *_OF_STATUS.get(status, ())}
        if "text/event-stream" in response.get("content", {}):
            names = {"X-Request-Id", *_STREAM}
        if status.startswith("2") and method.upper() == HTTPMethod.POST:
            names.add("Idempotency-Replayed")
        if status == "200" and _is_page(response, schemas):
            names.add("Link")
        described = response.setdefault("headers", {})
        for name in sorted(names):
            described.setdefault(name, {"$ref": f"#/components/headers/{name}"})


def components() -> dict[str, Any]:
    """Return the headers as components of the document."""
    return {name: {"description": text, "schema": {"type": "string"}} for name, text in RESPONSE_HEADERS.items()}


def _is_page(response: Mapping[str, Any], schemas: Mapping[str, Any]) -> bool:
    reference = response.get("content", {}).get("application/json", {}).get("schema", {}).get("$ref", "")
    return _PAGED in schemas.get(reference.rsplit("/", maxsplit=1)[-1], {}).get("properties", {})
