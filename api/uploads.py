"""Chunks that are sent over HTTP: streamed to the disk, never held whole; refused while too much waits."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from http import HTTPStatus
from typing import TypeVar

from starlette.datastructures import Headers
from starlette.types import Receive

from api.problems import ProblemError, ProblemItem
from estimation.errors import PassingFaultError, StorageError
from fleet_db.raw import IncomingFile, RawStore
from ingest.intake.backlog import BacklogWatch, Limit
from ingest.receipts import Arrival, Chunk, ChunkStorage, ReceiptGroup, Stored

PIECE_BYTES = 1 << 20  # what is gathered in memory before it is written
DRAIN_S = 2.0
"""How long the rest of a refused body is read, so that its sender reads the answer and not a broken connection."""
CLOSING = {"Connection": "close"}


@dataclass(frozen=True, slots=True)
class UploadLimits:
    """Size of a chunk in bytes, how many are received at the same time, time of one in all and without a byte, s."""

    most_bytes: int
    at_once: int
    total_s: float
    pause_s: float


class UploadBody:
    """The body of one request."""

    def __init__(self, headers: Headers, receive: Receive, limits: UploadLimits) -> None:
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
            raise _too_large(self._limits.most_bytes)
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
                raise _too_large(self._limits.most_bytes)
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


def _too_large(most_bytes: int) -> ProblemError:
    detail = f"limit max_chunk_mb: a chunk has at most {most_bytes} bytes"
    return ProblemError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "content-too-large", detail, headers=CLOSING)


ResultT = TypeVar("ResultT")
THREADS = 8  # that write and force chunks to the disk
TRY_AGAIN_S = {Limit.CHUNKS: 30, Limit.BYTES: 30, Limit.DISK: 60}  # what a sender that is refused waits, by the limit
UPLOADS_FULL, NO_STORAGE = "uploads", "storage"


class Taken(StrEnum):
    """How an upload ended."""

    STORED = "stored"
    KNOWN = "known"
    REFUSED = "refused"  # by what it is: too large, another digest, of another vehicle
    BROKEN_OFF = "broken_off"
    BEHIND = "behind"  # 503, to be sent again


class Uploads:
    """Takes uploads."""

    def __init__(self, raw: RawStore, storage: ChunkStorage, backlog: BacklogWatch, limits: UploadLimits) -> None:
        self._raw = raw
        self._group = ReceiptGroup(storage, most_waiting=limits.at_once)
        self._threads = ThreadPoolExecutor(THREADS, thread_name_prefix="upload")
        self._limits = limits
        self.backlog = backlog
        self.opened = False  # there is something to close
        self.running = 0
        self.ended: Counter[Taken] = Counter()
        self.refused: Counter[str] = Counter()
        self.bytes_stored = 0

    def close(self) -> None:
        """Commit what waits, and end."""
        self._group.close()
        self._threads.shutdown()

    async def take(self, headers: Headers, receive: Receive, digest: str, chunk: Chunk) -> Stored:
        """Store the body of a request as a chunk and return its committed receipt.

        Raises:
            ProblemError: 413, 408, 422 (another digest), 503 (too much waits, or the raw store takes nothing now).
            ConflictError: The same chunk was received from another vehicle, or deleted.
            StorageError: The database cannot be reached: nothing is stored.
        """
        body = UploadBody(headers, receive, self._limits)
        self.opened = True
        self.running += 1
        try:
            stored = await self._take(body, digest, chunk)
        except Exception as error:
            self.ended[_outcome(error)] += 1
            await body.drain()
            if isinstance(error, PassingFaultError):
                raise self._behind(NO_STORAGE, "the raw store takes nothing now", TRY_AGAIN_S[Limit.DISK]) from error
            raise
        finally:
            self.running -= 1
        self.ended[Taken.KNOWN if stored.known else Taken.STORED] += 1
        self.bytes_stored += 0 if stored.known else stored.record.size_bytes
        return stored

    async def _take(self, body: UploadBody, digest: str, chunk: Chunk) -> Stored:
        size = body.announced_bytes()
        if self.running > self._limits.at_once:
            raise self._behind(UPLOADS_FULL, f"{self._limits.at_once} chunks are being received", 1)
        ask = self.backlog.behind
        behind = ask(size) if self.backlog.fresh else await self._in_thread(ask, size)
        if behind is not None:
            raise self._behind(behind.limit.value, behind.text, TRY_AGAIN_S[behind.limit])
        incoming = self._raw.incoming(chunk.suffix)  # nothing of it is on the disk yet
        try:
            async for piece in body.pieces():
                await self._in_thread(_write, incoming, piece, digest if body.whole else None)
            _require_digest(incoming, digest)
            if not incoming.finished:  # the last piece did not say that it was
                await self._in_thread(incoming.finish)
            return await asyncio.wrap_future(self._group.put(Arrival(incoming, chunk)))
        except BaseException:
            await asyncio.shield(self._in_thread(incoming.discard))
            raise

    def _behind(self, limit: str, detail: str, after_s: int) -> ProblemError:
        self.refused[limit] += 1
        return ProblemError(
            HTTPStatus.SERVICE_UNAVAILABLE,
            "overloaded",
            f"{detail}; nothing of this chunk is stored, send it again later",
            headers={"Retry-After": str(after_s)},
        )

    async def _in_thread(self, work: Callable[..., ResultT], *given: object) -> ResultT:
        return await asyncio.get_running_loop().run_in_executor(self._threads, work, *given)


def _write(incoming: IncomingFile, piece: bytearray, last_of: str | None) -> None:
    """Write a piece; behind the last one of a file that has the digest, force it to the disk in the same turn."""
    incoming.write(piece)
    if last_of is not None and incoming.digest == last_of:
        incoming.finish()


def _outcome(error: Exception) -> Taken:
    if isinstance(error, PassingFaultError | StorageError):
        return Taken.BEHIND
    if isinstance(error, ProblemError):
        if error.status == HTTPStatus.SERVICE_UNAVAILABLE:
            return Taken.BEHIND
        return Taken.BROKEN_OFF if error.status == HTTPStatus.REQUEST_TIMEOUT else Taken.REFUSED
    return Taken.REFUSED


def _require_digest(incoming: IncomingFile, digest: str) -> None:
    if incoming.digest == digest and incoming.size_bytes:
        return
    wrong = f"has the sha256 {incoming.digest}" if incoming.size_bytes else "is empty"
    detail = f"the body {wrong}; nothing of it is stored"
    item = ProblemItem(part="path", pointer="#/sha256", detail=detail)
    raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, "digest-mismatch", detail, [item])
