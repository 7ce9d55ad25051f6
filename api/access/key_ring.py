"""Keys of the database, remembered for a few seconds, so that a request does not wait for a read of its key."""

from __future__ import annotations

import asyncio
import hmac
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

import anyio.to_thread
from anyio import CapacityLimiter

from api.access.tokens import digest_of, prefix_of
from fleet_db.access_records import ApiKey
from fleet_db.storage import SqlStorage

AGAIN_S = 2.5
"""After so long a key is read again, beside the request that asks."""
AT_MOST_S = 5.0
"""After so long a request waits for that read: a revoked key is refused after at most this."""
KEYS = 10_000
"""Keys that are remembered."""


@dataclass(slots=True)
class _Known:
    key: ApiKey
    read_s: float


@dataclass(slots=True)
class KeyRing:
    """The keys that were used lately; for one event loop.

    Args:
        storage: Returns the storage of all fleets.
    """

    storage: Callable[[], SqlStorage]
    _known: OrderedDict[str, _Known] = field(default_factory=OrderedDict)
    _reading: dict[str, asyncio.Task[ApiKey | None]] = field(default_factory=dict)
    _thread: CapacityLimiter | None = None

    def remembers(self, token: str) -> bool:
        """Return whether the key was good when it was read last."""
        return digest_of(token) in self._known

    async def find(self, token: str, now_ns: int) -> ApiKey | None:
        """Return the key that a token is; None where it is none, expired or revoked.

        Args:
            now_ns: Our time, ns UTC.

        Raises:
            StorageError: The key has to be read, and the database cannot be reached.
        """
        prefix = prefix_of(token)
        if prefix is None:
            return None
        digest = digest_of(token)
        known = self._known.get(digest)
        age_s = float("inf") if known is None else time.monotonic() - known.read_s
        if age_s >= AGAIN_S:
            reading = self._read_again(prefix, digest)
            if age_s >= AT_MOST_S:
                key = await asyncio.shield(reading)
                return key if key is not None and key.usable(now_ns) else None
        assert known is not None
        return known.key if known.key.usable(now_ns) else None

    def _read_again(self, prefix: str, digest: str) -> asyncio.Task[ApiKey | None]:
        """Return the one running read of a key."""
        running = self._reading.get(digest)
        if running is None:
            running = self._reading[digest] = asyncio.ensure_future(self._read(prefix, digest))
            running.add_done_callback(lambda task: self._ended(digest, task))
        return running

    def _ended(self, digest: str, task: asyncio.Task[ApiKey | None]) -> None:
        del self._reading[digest]
        if not task.cancelled():
            task.exception()  # whoever waits for it has it; without one, the next request reads again

    async def _read(self, prefix: str, digest: str) -> ApiKey | None:
        began_s = time.monotonic()
        if self._thread is None:
            self._thread = CapacityLimiter(2)  # of its own: reads of lists may hold all others for seconds

        def load() -> ApiKey | None:
            with self.storage().read() as unit:
                return unit.api_keys.find(prefix)

        key = await anyio.to_thread.run_sync(load, limiter=self._thread)
        if key is None or not hmac.compare_digest(key.digest, digest) or key.revoked_ns is not None:
            self._known.pop(digest, None)
            return None
        self._known[digest] = _Known(key, began_s)
        self._known.move_to_end(digest)
        if len(self._known) > KEYS:
            self._known.popitem(last=False)
        return key
