"""One example of each problem that an operation may answer with."""

from __future__ import annotations

from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from api.problems import PROBLEM_MEDIA_TYPE, TYPES

DETAILS: Mapping[str, str] = {
    "not-found": "no wheelset 'WS-9999'",
    "invalid-request": "query #/limit: Input should be less than or equal to 1000",
    "invalid-cursor": "this cursor belongs to another list or another filter; start again without it",
    "cursor-of-another-database": "the cursor is of another database: read what is open now, then follow `next`",
    "conflict": "alert 7 is closed",
    "precondition-required": "send the ETag of the resource as If-Match",
    "precondition-failed": "the resource has changed; read it again",
    "idempotency-key-reused": "this Idempotency-Key was used for another request; use a new one",
    "history-purged": "replaced results are kept from 2026-01-01T00:00:00Z on, see the retention",
    "not-acceptable": "offered: application/json",
    "unsupported-media-type": "send application/json",
    "digest-mismatch": "the body has another sha256 than its path",
    "content-too-large": "at most 1048576 bytes",
    "headers-too-large": "request line and headers: at most 16384 bytes",
    "request-timeout": "the body did not arrive within 30 s",
    "unauthenticated": "send a valid key or token: Authorization: Bearer ...",
    "forbidden": "this needs the scope 'act'",
    "foreign-origin": "pages of https://elsewhere.example may not change anything here",
    "unknown-host": "name the host in TREADWATCH_HOSTS",
    "too-many-requests": "limit requests_per_s: at most 50 requests a second of a key; try again",
    "overloaded": "100 requests are being answered; try again",
    "not-ready": "the database does not answer",
    "internal-error": "the failure has been logged",
}
_OF_STATUS: Mapping[str, str] = {
    "400": "invalid-cursor",
    "401": "unauthenticated",
    "403": "forbidden",
    "404": "not-found",
    "406": "not-acceptable",
    "408": "request-timeout",
    "409": "conflict",
    "410": "history-purged",
    "412": "precondition-failed",
    "413": "content-too-large",
    "415": "unsupported-media-type",
    "422": "invalid-request",
    "428": "precondition-required",
    "429": "too-many-requests",
    "431": "headers-too-large",
    "500": "internal-error",
    "503": "not-ready",
}
_FEED = ("poll_alert_feed", "stream_alert_feed")
_POINTED = [{"in": "query", "pointer": "#/limit", "detail": "Input should be less than or equal to 1000"}]


def describe_problems(path: str, operation: dict[str, Any]) -> None:
    """Give every problem of an operation an example.

    Args:
        path: Template of the operation's path.
    """
    for status, response in operation["responses"].items():
        content = response.get("content", {}).get(PROBLEM_MEDIA_TYPE)
        if content is not None:
            content.setdefault("example", _example(path, status, operation["operationId"]))


def _example(path: str, status: str, name: str) -> dict[str, Any]:
    kind = "cursor-of-another-database" if name in _FEED and status == "409" else _OF_STATUS.get(status)
    example: dict[str, Any] = {
        "type": "about:blank" if kind is None else f"urn:treadwatch:problem:{kind}",
        "title": HTTPStatus(int(status)).phrase if kind is None else TYPES[kind],
        "status": int(status),
        "instance": path.replace("{", "").replace("}", ""),
    }
    if kind is not None:
        example["detail"] = DETAILS[kind]
    if kind == "invalid-request":
        example["errors"] = _POINTED
    return example
