"""The feed as server-sent events, and the places for those who wait for news."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from enum import StrEnum

from prometheus_client.core import Metric
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse
from starlette.types import Message, Receive, Scope, Send

from api.access.caller import Caller
from api.access.rates import StreamPlaces
from api.feed.pages import FeedFilter, FeedPage, Place, read_page
from api.feed.watch import Channel, FeedWatch, as_sent
from api.http_server import SEND_TIMEOUT_S
from api.measures import gauge
from api.problems import ProblemError
from estimation.errors import TreadwatchError
from fleet_db.storage import SqlStorage

TRY_AGAIN = {"Retry-After": "10"}


class Waits(StrEnum):
    """How a client waits."""

    STREAM = "stream"
    LONG_POLL = "long_poll"


class WaitingPlaces:
    """Counts who waits, refuses who would be too many, and shows it to Prometheus."""

    def __init__(self, limit: int, of_keys: StreamPlaces) -> None:
        self._limit = limit
        self._of_keys = of_keys
        self._waiting: Counter[Waits] = Counter()

    @contextmanager
    def held(self, how: Waits, caller: Caller) -> Iterator[None]:
        """Hold a place."""
        if sum(self._waiting.values()) >= self._limit:
            detail = f"limit max_streams: {self._limit} clients wait for news; try again"
            raise ProblemError(503, "overloaded", detail, headers=TRY_AGAIN)
        with self._of_keys.place(caller):
            self._waiting[how] += 1
            try:
                yield
            finally:
                self._waiting[how] -= 1

    def measures(self) -> list[Metric]:
        """Return how many wait now, for Prometheus."""
        waiting = {how.value: self._waiting[how] for how in Waits}
        return [gauge("treadwatch_feed_waiting", "Clients that wait for news of the feed.", "how", waiting)]


EVENT_STREAM = "text/event-stream"
HEARTBEAT_S = 15.0
"""Longest silence of a stream."""
LONGEST_S = 900.0
"""A stream ends after this time; clients connect again."""
ASKED_EVERY_S = 15.0
"""How often a stream asks whether its key would still be let in; else it ends."""
RETRY_MS = 2000
"""How long a client waits until it connects again."""
CATCH_UP = 200
"""Events of one read of a stream that is behind."""
_log = logging.getLogger(__name__)


class EventStream(StreamingResponse):
    """An answer that goes on; a client that does not read is left, nothing is kept for it."""

    media_type = EVENT_STREAM

    def __init__(
        self, parts: AsyncIterator[bytes], headers: Mapping[str, str], held: Sequence[AbstractContextManager[None]]
    ) -> None:
        super().__init__(parts, headers=headers)
        self._held = held

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send until it ends or the client leaves."""
        with ExitStack() as stack:
            for one in self._held:
                stack.enter_context(one)
            await super().__call__(scope, receive, send)

    async def stream_response(self, send: Send) -> None:
        """Send what there is, each part within a time."""

        async def send_in_time(message: Message) -> None:
            async with asyncio.timeout(SEND_TIMEOUT_S):
                await send(message)

        try:
            await super().stream_response(send_in_time)
        except TimeoutError:
            _log.warning("a client of the feed does not read its stream; it is closed")


@dataclass(slots=True)
class FeedStream:
    """One client's stream."""

    watch: FeedWatch
    narrowed: FeedFilter
    storage: SqlStorage
    good: Callable[[], Awaitable[bool]]
    clock_s: Callable[[], float] = time.monotonic

    async def parts(self, page: FeedPage) -> AsyncIterator[bytes]:
        """Yield what is sent, one or more whole events at a time, until the stream ends."""
        ends, history = self.clock_s() + LONGEST_S, self.watch.histories
        yield b"retry: %d\n: the feed of alerts\n\n" % RETRY_MS + _text(page)
        async with self.watch.following(self.narrowed, self.storage, page) as channel:
            place, silent_since = page.end, self.clock_s()
            asked = silent_since
            while not self.watch.ended and history == self.watch.histories and self.clock_s() < ends:
                if self.clock_s() - asked >= ASKED_EVERY_S:
                    if not await self.good():
                        return
                    asked = self.clock_s()
                part, place = await self._next(channel, place)
                if part:
                    yield part
                    silent_since = self.clock_s()
                elif self.clock_s() - silent_since >= HEARTBEAT_S:
                    yield f": still here\nid: {place.cursor}\n\n".encode()
                    silent_since = self.clock_s()
                else:
                    due = min(silent_since + HEARTBEAT_S, asked + ASKED_EVERY_S)
                    await self.watch.wait(max(0.0, due - self.clock_s()))

    async def _next(self, channel: Channel, place: Place) -> tuple[bytes, Place]:
        """Return what is to be sent now and where it ends; nothing where all has been sent."""
        news = channel.after(place.sequence)
        if news is None:
            try:
                page = await run_in_threadpool(self._read, place.sequence)
            except TreadwatchError as error:
                _log.warning("a stream of the feed waits for the database: %s", error)
                await asyncio.sleep(RETRY_MS / 1000)
                return b"", place
            return _text(page) if page.events else b"", page.end
        if news:
            part = news[:CATCH_UP]
            return b"".join(one.text for one in part), part[-1].place
        return b"", channel.end if channel.end.sequence > place.sequence else place

    def _read(self, after_sequence: int) -> FeedPage:
        with self.storage.read() as unit:
            return read_page(unit, self.narrowed, after_sequence, CATCH_UP)


def _text(page: FeedPage) -> bytes:
    """Return events with the cursor of the last, or the cursor alone."""
    sent = b"".join(as_sent(event, cursor) for event, cursor in page.events)
    return sent or f": nothing yet\nid: {page.end.cursor}\n\n".encode()
