"""Requests that write wait for the database on the event loop, and not for long; reads never wait for them.

A request that waits in a thread keeps the thread from those that read: two writers in a queue for a stuck one held up
everything on the embedded database, which has two threads.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from estimation.errors import BusyError

MOST_WAITING = 16
"""Requests that may wait for a slot; more are refused at once."""

PATIENCE_S = 3.0
"""How long a request waits for a slot, and in it for other processes that write."""


class WriterSlots:
    """Places for requests that write."""

    def __init__(self, at_once: int, patience_s: float) -> None:
        self._slots = asyncio.Semaphore(at_once)
        self._patience_s = patience_s
        self._most = at_once + MOST_WAITING
        self._present = 0

    @asynccontextmanager
    async def slot(self) -> AsyncIterator[None]:
        """Hold a place."""
        if self._present >= self._most:
            raise BusyError(f"{self._present} requests write or wait for it already")
        self._present += 1
        try:
            await self._acquire()
            try:
                yield
            finally:
                self._slots.release()
        finally:
            self._present -= 1

    async def _acquire(self) -> None:
        try:
            await asyncio.wait_for(self._slots.acquire(), self._patience_s)
        except TimeoutError:
            raise BusyError(f"other requests have been writing for {self._patience_s:g} s") from None
