"""Around every request: request id, log line, metrics, limit of the body, and the answer to unexpected errors."""

from __future__ import annotations

import re
import time
import uuid
from collections.abc import MutableMapping
from http import HTTPStatus
from typing import Any

import structlog
from fastapi import Request
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.metrics import RequestMeasures
from api.problems import from_error, problem_response

MAX_BODY_BYTES = 1 << 20
TOO_LARGE = 413
_IDENTITY = re.compile(r"[A-Za-z0-9._-]{1,64}", re.ASCII)
_log = structlog.stdlib.get_logger("treadwatch.access")


def _identity(scope: Scope) -> str:
    given = Headers(scope=scope).get("x-request-id", "")
    return given if _IDENTITY.fullmatch(given) else uuid.uuid4().hex


def _route(scope: Scope) -> str:
    """Return the route's template, so that measures are counted by route and not by wheelset."""
    return getattr(scope.get("route"), "path_format", "unmatched")


class RequestContextMiddleware:
    """ASGI middleware; one instance an app."""

    def __init__(self, app: ASGIApp, measures: RequestMeasures) -> None:
        self.app = app
        self.measures = measures

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; log and count its outcome."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        identity, began = _identity(scope), time.perf_counter()
        seen: MutableMapping[str, Any] = {}

        async def send_with_id(message: Message) -> None:
            if message["type"] == "http.response.start":
                seen["status"] = message["status"]
                MutableHeaders(scope=message)["X-Request-Id"] = identity
            await send(message)

        with structlog.contextvars.bound_contextvars(request_id=identity):
            try:
                await self.app(scope, limit_body(scope, receive), send_with_id)
            except Exception as error:
                if "status" in seen:
                    raise
                _log.error("request failed", path=scope["path"], exc_info=error)
                await problem_response(Request(scope), from_error(error))(scope, receive, send_with_id)
            finally:
                took = time.perf_counter() - began
                status = int(seen.get("status", HTTPStatus.INTERNAL_SERVER_ERROR))
                self.measures.observe(scope["method"], _route(scope), status, took)
                _log.info(
                    "request",
                    method=scope["method"],
                    path=scope["path"],
                    status=status,
                    duration_ms=round(took * 1000.0, 2),
                )


def limit_body(scope: Scope, receive: Receive) -> Receive:
    """Return ``receive`` that refuses a body above the limit, whether ``Content-Length`` announces it or not."""
    size = 0
    announced = Headers(scope=scope).get("content-length", "0")

    async def limited() -> Message:
        nonlocal size
        message = await receive()
        size += len(message.get("body", b""))
        if size > MAX_BODY_BYTES or (announced.isdecimal() and int(announced) > MAX_BODY_BYTES):
            raise HTTPException(TOO_LARGE, f"at most {MAX_BODY_BYTES} bytes")
        return message

    return limited
