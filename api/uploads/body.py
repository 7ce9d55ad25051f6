"""The body of an upload, in pieces of bounded size and within limits of size and time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from http import HTTPStatus

from starlette.datastructures import Headers
from starlette.types import Receive

from api.problems import ProblemError

PIECE_BYTES = 1 << 20
"""What is gathered in memory before it is written."""
DRAIN_S = 2.0
"""How long the rest of a refused body is read, so that its sender reads the answer and not a broken connection."""
CLOSING = {"Connection": "close"}


@dataclass(frozen=True, slots=True)
class BodyLimits:
    """Size in bytes, time in all and time without a byte, in seconds."""

    most_bytes: int
    total_s: float
    pause_s: float


class UploadBody:
    """The body of one request."""

    def __init__(self, headers: Headers, receive: Receive, limits: BodyLimits) -> None:
        self._headers = headers
        self._receive = receive
        self._limits = limits
        self.whole = False

    def announced_bytes(self) -> int:
        """Return how large it may get: what its sender says, or the limit where it does not."""
        announced = self._headers.get("content-length", "")
        if not announced.isdecimal():
            return self._limits.most_bytes
        if int(announced) > self._limits.most_bytes:
            raise too_large(self._limits.most_bytes)
        return int(announced)

    async def pieces(self) -> AsyncIterator[bytearray]:
        """Yield it."""
        held, size, until = bytearray(), 0, time.monotonic() + self._limits.total_s
        while not self.whole:
            left_s = min(self._limits.pause_s, until - time.monotonic())
            try:
                async with asyncio.timeout(max(left_s, 0.0)):
                    message = await self._receive()
            except TimeoutError:
                raise ProblemError(408, "request-timeout", "the body did not arrive in time", headers=CLOSING) from None
            self.whole = not message.get("more_body", False)
            if message["type"] == "http.disconnect":
                raise ProblemError(408, "request-timeout", "the client left before the end of the body")
            body = message.get("body", b"")
            size += len(body)
            if size > self._limits.most_bytes:
                raise too_large(self._limits.most_bytes)
            held += body
            if len(held) >= PIECE_BYTES:
                yield held
                held = bytearray()
        if held:
            yield held

    async def drain(self) -> None:
        """Read what is left of it for a moment; not where its sender waits for leave to send."""
        if self._headers.get("expect", "").lower() == "100-continue":
            return
        size = 0
        try:
            async with asyncio.timeout(DRAIN_S):
                while not self.whole and size <= self._limits.most_bytes:
                    message = await self._receive()
                    size += len(message.get("body", b""))
                    self.whole = not message.get("more_body", False)
        except TimeoutError:
            return


def too_large(most_bytes: int) -> ProblemError:
    """Return the refusal of a body that is too large."""
    detail = f"limit max_chunk_mb: a chunk has at most {most_bytes} bytes"
    return ProblemError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "content-too-large", detail, headers=CLOSING)
