"""Around every request: request id, log line, measures, limits of size and time, the answer to unexpected errors."""

from __future__ import annotations

import asyncio
import re
import time
import uuid
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from http import HTTPMethod, HTTPStatus

import structlog
from fastapi import Request
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.guard import Access
from api.http_server import MAX_HEAD_BYTES, REQUESTS, is_upload
from api.metrics import RequestMeasures
from api.problems import ProblemError, from_error, problem_response
from api.settings import Settings
from api.uploads import CLOSING

ALWAYS_ANSWERED = "/healthz"
WITHOUT_DATABASE = (ALWAYS_ANSWERED, "/metrics")  # what is answered before the database has answered for the first time
OTHER = "other"
TURN = "treadwatch.turn"
_METHODS = frozenset(HTTPMethod)
_IDENTITY = re.compile(r"[A-Za-z0-9._-]{1,64}", re.ASCII)
_log = structlog.stdlib.get_logger("treadwatch.access")


def _identity(scope: Scope) -> str:
    given = Headers(scope=scope).get("x-request-id", "")
    return given if _IDENTITY.fullmatch(given) else uuid.uuid4().hex


Before = Callable[[int, MutableHeaders], Awaitable[None]]
"""What is done before an answer begins: with its status, and its headers, which it may add to."""


class _Answer:
    """The way back to the client: with the identity of the request, and closed to whoever is too late."""

    def __init__(self, send: Send, identity: str, before: Before) -> None:
        self._send = send
        self._before = before
        self._identity = identity
        self._late = False
        self.status: int | None = None

    async def send(self, message: Message) -> None:
        """Send what the application answers."""
        if not self._late:
            await self._pass_on(message)

    async def instead(self, message: Message) -> None:
        """Send another answer, after which the application's own is not sent any more."""
        self._late = True
        await self._pass_on(message)

    async def _pass_on(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
            headers = MutableHeaders(scope=message)
            headers["X-Request-Id"] = self._identity
            await self._before(message["status"], headers)
        await self._send(message)


class Turn:
    """The place of a request among those that are answered; one that waits for news gives it back meanwhile."""

    def __init__(self, count: Callable[[int], None]) -> None:
        self._count = count
        self._waited_s = 0.0
        self._began = time.monotonic()
        self.waiting = False

    @contextmanager
    def given_back(self) -> Iterator[None]:
        """Neither count the request nor its time."""
        self._count(-1)
        self.waiting, began = True, time.monotonic()
        try:
            yield
        finally:
            self._waited_s += time.monotonic() - began
            self.waiting = False
            self._count(1)

    def left_s(self, timeout_s: float) -> float:
        """Return how long the answer may still take; while it waits for news, how long until this is asked again."""
        left_s = timeout_s - (time.monotonic() - self._began - self._waited_s)
        return timeout_s if self.waiting else max(0.0, left_s)


def turn_of(scope: Scope) -> Turn:
    """Return the turn of the request of this scope."""
    turn: Turn = scope[TURN]
    return turn


class RequestContextMiddleware:
    """ASGI middleware; one instance an app."""

    def __init__(self, app: ASGIApp, measures: RequestMeasures, settings: Settings, access: Access) -> None:
        self.app = app
        self.access = access
        self.measures = measures
        self.settings = settings
        self._running = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; log and count its outcome."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        identity, began = _identity(scope), time.perf_counter()

        async def before(status: int, headers: MutableHeaders) -> None:
            self.access.protect(headers)
            await self.access.recorder.answered(scope, status, headers, identity)

        answer = _Answer(send, identity, before)
        with structlog.contextvars.bound_contextvars(request_id=identity):
            try:
                _refuse_large_head(scope)
                _refuse_without_database(scope)
                await self.access.gate.admit(scope)
                if not is_upload(scope):
                    within = (self.settings.body_timeout_s, self.settings.max_body_kb << 10)
                    receive = await with_body(scope, receive, *within)
                await self._run(scope, receive, answer)
            except Exception as error:
                if answer.status is not None:
                    raise
                problem = from_error(error)
                if problem.status == HTTPStatus.INTERNAL_SERVER_ERROR:
                    _log.error("request failed", path=scope["path"], exc_info=error)
                await problem_response(Request(scope), problem)(scope, receive, answer.instead)
            finally:
                took = time.perf_counter() - began
                status = HTTPStatus.INTERNAL_SERVER_ERROR if answer.status is None else answer.status
                method = scope["method"] if scope["method"] in _METHODS else OTHER
                # by the template of the route, not by wheelset
                template = getattr(scope.get("route"), "path_format", "unmatched")
                self.measures.observe(method, template, int(status), took)
                _log.info(
                    "request",
                    method=scope["method"],
                    path=scope["path"],
                    status=int(status),
                    duration_ms=round(took * 1000.0, 2),
                )

    async def _run(self, scope: Scope, receive: Receive, answer: _Answer) -> None:
        """Let the application answer; a thread that is late goes on, but the client does not wait for it."""
        if self._running >= REQUESTS and scope["path"] != ALWAYS_ANSWERED:
            detail = f"{REQUESTS} requests are being answered; try again"
            raise ProblemError(503, "overloaded", detail, headers={"Retry-After": "1"})
        turn = scope[TURN] = Turn(self._count)
        within_s = self.settings.request_timeout_s
        task = asyncio.ensure_future(self.app(scope, receive, answer.send))
        self._running += 1
        task.add_done_callback(self._ended)
        try:
            while not task.done() and answer.status is None and (left_s := turn.left_s(within_s)):
                await asyncio.wait({task}, timeout=left_s)
        except asyncio.CancelledError:
            task.cancel()
            raise
        if not task.done() and answer.status is None:
            detail = f"no answer within {within_s:g} s; what was asked for may still be done"
            raise ProblemError(503, "overloaded", detail, headers={"Retry-After": "5"})
        await task

    def _count(self, change: int) -> None:
        self._running += change

    def _ended(self, task: asyncio.Future[None]) -> None:
        self._running -= 1
        if not task.cancelled():
            task.exception()  # whoever still waits for the task has it; a late one is of no interest any more


def _refuse_without_database(scope: Scope) -> None:
    if scope["app"].state.services is None and scope["path"] not in WITHOUT_DATABASE:
        detail = "the database has not answered since the start of the service"
        raise ProblemError(503, "not-ready", detail, headers={"Retry-After": "5"}, reason_code="waits_for_database")


def _refuse_large_head(scope: Scope) -> None:
    size = len(scope["raw_path"]) + len(scope["query_string"])
    size += sum(len(name) + len(value) for name, value in scope["headers"])
    if size > MAX_HEAD_BYTES:
        detail = f"request line and headers: at most {MAX_HEAD_BYTES} bytes"
        raise ProblemError(431, "headers-too-large", detail, headers=CLOSING)


async def with_body(scope: Scope, receive: Receive, timeout_s: float, most_bytes: int) -> Receive:
    """Wait for the whole body and return ``receive`` that hands it over."""
    headers = Headers(scope=scope)
    announced = headers.get("content-length", "0")
    if announced == "0" and "transfer-encoding" not in headers:
        return receive
    if announced.isdecimal() and int(announced) > most_bytes:
        raise _too_large(most_bytes)
    body, more = bytearray(), True
    try:
        async with asyncio.timeout(timeout_s):
            while more:
                message = await receive()
                body += message.get("body", b"")
                more = message.get("more_body", False)
                if len(body) > most_bytes:
                    raise _too_large(most_bytes)
    except TimeoutError:
        detail = f"the body did not arrive within {timeout_s:g} s"
        raise ProblemError(408, "request-timeout", detail, headers=CLOSING) from None
    if message["type"] == "http.disconnect":
        raise ProblemError(408, "request-timeout", "the client left before the end of the body")
    handed_over = False

    async def hand_over() -> Message:
        nonlocal handed_over
        if handed_over:
            return await receive()  # only the end of the connection can follow
        handed_over = True
        return {"type": "http.request", "body": bytes(body), "more_body": False}

    return hand_over


def _too_large(most_bytes: int) -> ProblemError:
    return ProblemError(413, "content-too-large", f"limit max_body_kb: at most {most_bytes} bytes", headers=CLOSING)


class _EndOfHeadersError(OSError):
    """The headers have been sent: what would follow, perhaps for ever, is not wanted."""


class HeadMiddleware:
    """ASGI middleware inside that of the request's context, so that log and measures keep the method that was asked."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer HEAD with the headers of GET; pass everything else on."""
        if scope["type"] != "http" or scope["method"] != HTTPMethod.HEAD:
            await self.app(scope, receive, send)
            return
        inner = {**scope, "method": HTTPMethod.GET.value}
        ended = False

        async def send_headers(message: Message) -> None:
            nonlocal ended
            if message["type"] == "http.response.start":
                await send(message)
            elif not ended:
                ended = True
                await send({"type": "http.response.body", "body": b"", "more_body": False})
            if ended and message.get("more_body", False):
                raise _EndOfHeadersError

        try:
            await self.app(inner, receive, send_headers)
        except _EndOfHeadersError:
            pass
        finally:
            if "route" in inner:
                scope["route"] = inner["route"]
