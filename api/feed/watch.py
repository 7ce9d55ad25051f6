"""Waiting for news of the feed: one look at the database an interval, whatever the number of those who wait.

Whoever waits holds no thread and no connection. What others commit, also in other processes, is seen at the next look.
Events of each filter are kept for a while as they are sent, so that many clients of one filter cost one read.
"""

from __future__ import annotations

import asyncio
import logging
import signal
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import uvicorn
from starlette.concurrency import run_in_threadpool

from api.feed.pages import FeedFilter, FeedPage, Place, read_page
from api.schemas import alerts
from estimation.errors import TreadwatchError
from estimation.values.alerts import AlertEvent
from fleet_db.storage import SqlStorage


def ending() -> bool:
    """Return whether a signal has asked uvicorn to end.

    A server that makes processes of its own (``uvicorn --workers 2``) tells its applications only when the last
    connection is closed, for which those that stream would let it wait. It has its own handler of the signal.
    """
    server = getattr(signal.getsignal(signal.SIGTERM), "__self__", None)
    return isinstance(server, uvicorn.Server) and server.should_exit


INTERVAL_S = 0.2
"""Between two looks at the database, while somebody waits."""
KEPT = 1000
"""Events of a filter that are kept; who is further behind reads the database."""
AT_ONCE = 500
"""Events that one look takes in; the next ones with the next look."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Sent:
    """An event as a stream sends it."""

    place: Place
    text: bytes


@dataclass(slots=True)
class Channel:
    """What is new under one filter.

    Attributes:
        begin: All that matches and has a higher number is in ``kept``.
        end: Up to where has been looked.
    """

    narrowed: FeedFilter
    storage: SqlStorage
    begin: int
    end: Place
    kept: deque[Sent] = field(default_factory=deque)
    followers: int = 0

    def after(self, sequence: int) -> Sequence[Sent] | None:
        """Return what is new behind a number; None where the database must be read."""
        if sequence < self.begin:
            return None
        return [one for one in self.kept if one.place.sequence > sequence]

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
        known = self._newest
        newest, pages = await run_in_threadpool(_news, storage, tuple(self._channels.values()))
        if newest < known:  # the database was restored: cursors have to be looked at again
            self.histories += 1
            self._channels.clear()
        self._newest = newest if newest < known else max(newest, self._newest)
        for channel, page in pages:
            channel.take(page)
        if pages or not self._channels:
            self._tell()


def _news(storage: SqlStorage, channels: Sequence[Channel]) -> tuple[int, Sequence[tuple[Channel, FeedPage]]]:
    """Return the number of the newest event, and what is new in each channel."""
    with storage.read() as unit:
        newest = unit.feed_branches.newest_sequence()
    pages = []
    for channel in channels:
        if channel.end.sequence < newest:
            with channel.storage.read() as unit:
                pages.append((channel, read_page(unit, channel.narrowed, channel.end.sequence, AT_ONCE)))
    return newest, pages
