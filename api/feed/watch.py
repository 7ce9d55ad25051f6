"""Waiting for news of the feed, and streams of it: one query an interval, and with news one read for each filter.

Whoever waits holds no thread and no database connection. What other processes commit is seen at the next look, too.
Events of each filter are kept for a while as they are sent, so that many clients of one filter cost one read.
"""

from __future__ import annotations

import asyncio
import logging
import signal
import time
from collections import Counter, deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from enum import StrEnum

import uvicorn
from prometheus_client.core import Metric
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse
from starlette.types import Message, Receive, Scope, Send

from api.access.gate import StreamPlaces
from api.access.key_ring import Caller
from api.feed.pages import FeedFilter, FeedPage, Place, read_page
from api.http_server import SEND_TIMEOUT_S
from api.measures import gauge
from api.problems import ProblemError
from api.schemas import alerts
from estimation.errors import TreadwatchError
from estimation.values.alerts import AlertEvent
from fleet_db.storage import SqlStorage


def ending() -> bool:
    """Return whether a signal has asked uvicorn to end.

    A server that makes processes of its own (``uvicorn --workers 2``) tells its applications only when the last
    connection is closed, which open streams delay. Its own handler of the signal knows it earlier.
    """
    server = getattr(signal.getsignal(signal.SIGTERM), "__self__", None)
    return isinstance(server, uvicorn.Server) and server.should_exit


INTERVAL_S = 0.2  # between two looks at the database, while somebody waits
KEPT = 1000  # events of a filter that are kept; who is further behind reads the database
AT_ONCE = 500  # events that one look takes in; the next ones with the next look
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Sent:
    """An event as a stream sends it."""

    place: Place
    text: bytes


@dataclass(slots=True)
class Channel:
    """What is new under one filter."""

    narrowed: FeedFilter
    storage: SqlStorage
    begin: int  # `kept` holds what matches above this number, up to `end`
    end: Place  # up to where has been looked
    kept: deque[Sent] = field(default_factory=deque)
    followers: int = 0

    def after(self, sequence: int) -> Sequence[Sent] | None:
        """Return what is new behind a number; None where the database must be read."""
        if sequence < self.begin:
            return None
        return [event for event in self.kept if event.place.sequence > sequence]

    def take(self, page: FeedPage) -> None:
        """Take news in, and let go what is too old."""
        self.kept.extend(Sent(Place(event.sequence, cursor), as_sent(event, cursor)) for event, cursor in page.events)
        self.end = page.end
        while len(self.kept) > KEPT:
            self.begin = self.kept.popleft().place.sequence


def as_sent(event: AlertEvent, cursor: str) -> bytes:
    """Return an event of the feed as an event of a stream (WHATWG HTML, server-sent events)."""
    return f"id: {cursor}\ndata: {alerts.event(event).model_dump_json(by_alias=True)}\n\n".encode()


class FeedWatch:
    """Looks for news while somebody waits for them; one an app."""

    def __init__(self, storage: Callable[[], SqlStorage | None], ending: Callable[[], bool]) -> None:
        self._storage = storage
        self._server_ends = ending
        self._channels: dict[FeedFilter, Channel] = {}
        self._looking: asyncio.Task[None] | None = None
        self._news = asyncio.Event()
        self._newest = 0
        self._stopped = False
        self.histories = 0

    @property
    def ended(self) -> bool:
        """Whether nobody should wait any more."""
        return self._stopped or self._server_ends()

    def stop(self) -> None:
        """Let all who wait go; to be called in the event loop."""
        self._stopped = True
        self._tell()

    @asynccontextmanager
    async def following(self, narrowed: FeedFilter, storage: SqlStorage, page: FeedPage) -> AsyncIterator[Channel]:
        """Yield what is new under a filter from a page on."""
        channel = self._channels.get(narrowed)
        if channel is None:
            channel = self._channels[narrowed] = Channel(narrowed, storage, page.newest.sequence, page.newest)
        channel.followers += 1
        self._newest = max(self._newest, page.newest.sequence)
        if self._looking is None or self._looking.done():
            self._looking = asyncio.create_task(self._look_while_followed())
        try:
            yield channel
        finally:
            channel.followers -= 1
            if channel.followers == 0 and self._channels.get(narrowed) is channel:
                del self._channels[narrowed]

    async def wait(self, timeout_s: float) -> bool:
        """Wait until there may be news, or for a time; return whether there may be."""
        try:
            async with asyncio.timeout(timeout_s):
                await self._news.wait()
        except TimeoutError:
            return False
        return True

    def _tell(self) -> None:
        self._news.set()
        self._news = asyncio.Event()

    async def _look_while_followed(self) -> None:
        while self._channels and not self._stopped:
            await asyncio.sleep(INTERVAL_S)
            if self._server_ends():
                self.stop()
                return
            try:
                await self._look()
            except TreadwatchError as error:
                _log.warning("the feed waits for the database: %s", error)

    async def _look(self) -> None:
        storage = self._storage()
        if storage is None:
            return
        newest_known = self._newest
        newest, pages = await run_in_threadpool(_news, storage, tuple(self._channels.values()))
        if newest < newest_known:  # the database was restored: cursors have to be looked at again
            self.histories += 1
            self._channels.clear()
        self._newest = newest if newest < newest_known else max(newest, self._newest)
        for channel, page in pages:
            channel.take(page)
        if pages or not self._channels:
            self._tell()


def _news(storage: SqlStorage, channels: Sequence[Channel]) -> tuple[int, Sequence[tuple[Channel, FeedPage]]]:
    with storage.read() as unit:
        newest = unit.feed_branches.newest_sequence()
    pages = []
    for channel in channels:
        if channel.end.sequence < newest:
            with channel.storage.read() as unit:
                pages.append((channel, read_page(unit, channel.narrowed, channel.end.sequence, AT_ONCE)))
    return newest, pages


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
HEARTBEAT_S = 15.0  # longest silence of a stream
LONGEST_S = 900.0  # a stream ends after this time; clients connect again
ASKED_EVERY_S = 15.0  # how often a stream asks whether its key would still be let in; else it ends
RETRY_MS = 2000  # until a client connects again, and a stream asks the database again
CATCH_UP = 200  # most events of one part


class EventStream(StreamingResponse):
    """An answer that goes on; a client that stops reading is disconnected, nothing is kept for it."""

    media_type = EVENT_STREAM

    def __init__(
        self, parts: AsyncIterator[bytes], headers: Mapping[str, str], held: Sequence[AbstractContextManager[None]]
    ) -> None:
        super().__init__(parts, headers=headers)
        self._held = held

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send until it ends or the client leaves."""
        with ExitStack() as stack:
            for held in self._held:
                stack.enter_context(held)
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
        """Yield whole events, or a comment that keeps the connection, until the stream ends."""
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
            return b"".join(event.text for event in part), part[-1].place
        return b"", channel.end if channel.end.sequence > place.sequence else place

    def _read(self, after_sequence: int) -> FeedPage:
        with self.storage.read() as unit:
            return read_page(unit, self.narrowed, after_sequence, CATCH_UP)


def _text(page: FeedPage) -> bytes:
    sent = b"".join(as_sent(event, cursor) for event, cursor in page.events)
    return sent or f": nothing yet\nid: {page.end.cursor}\n\n".encode()
