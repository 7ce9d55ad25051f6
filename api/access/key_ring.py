"""Keys of the database, remembered for a few seconds, so that a request does not wait for a read of its key."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import re
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

import anyio.to_thread
from anyio import CapacityLimiter

from api.access.caller import EVERYTHING
from estimation.errors import NotFoundError, ParameterError
from fleet_db.access_records import ApiKey
from fleet_db.storage import SqlStorage, SqlUnitOfWork

_ALPHABET = "abcdefghijklmnopqrstuvwxyz234567"
_PREFIX_LENGTH = 8
_SECRET_BYTES = 32
_FORM = re.compile(r"tw_(?P<prefix>[a-z2-7]{8})_[A-Za-z0-9_-]{43}", re.ASCII)


def _new_token() -> str:
    prefix = "".join(secrets.choice(_ALPHABET) for _ in range(_PREFIX_LENGTH))
    return f"tw_{prefix}_{secrets.token_urlsafe(_SECRET_BYTES)}"


def prefix_of(token: str) -> str | None:
    """Return the prefix of a key; None where it has not the form of one."""
    found = _FORM.fullmatch(token)
    return None if found is None else found["prefix"]


def digest_of(token: str) -> str:
    """Return the SHA-256 of a key, hexadecimal; a slow hash would protect nothing more of 256 random bits."""
    return hashlib.sha256(token.encode()).hexdigest()


AGAIN_S = 2.5  # after so long a key is read again, beside the request that asks
AT_MOST_S = 5.0  # after so long a request waits for that read: a revoked key is refused after at most this
KEYS = 10_000  # keys that are remembered


@dataclass(slots=True)
class _Known:
    key: ApiKey
    read_s: float


@dataclass(slots=True)
class KeyRing:
    """The keys that were used lately; for one event loop."""

    storage: Callable[[], SqlStorage]
    _known: OrderedDict[str, _Known] = field(default_factory=OrderedDict)
    _reading: dict[str, asyncio.Task[ApiKey | None]] = field(default_factory=dict)
    _thread: CapacityLimiter | None = None

    def remembers(self, token: str) -> bool:
        """Return whether the key was good when it was read last."""
        return digest_of(token) in self._known

    async def find(self, token: str, now_ns: int) -> ApiKey | None:
        """Return the key that a token is; None where it is none, expired or revoked."""
        prefix = prefix_of(token)
        if prefix is None:
            return None
        digest = digest_of(token)
        known = self._known.get(digest)
        age_s = float("inf") if known is None else time.monotonic() - known.read_s
        if age_s >= AGAIN_S:
            reading = self._reading.get(digest)
            if reading is None:
                reading = self._reading[digest] = asyncio.ensure_future(self._read(prefix, digest))
                reading.add_done_callback(lambda task: self._ended(digest, task))
            if age_s >= AT_MOST_S:
                key = await asyncio.shield(reading)
                return key if key is not None and key.usable(now_ns) else None
        assert known is not None
        return known.key if known.key.usable(now_ns) else None

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


@dataclass(frozen=True, slots=True)
class Wanted:
    """A key that is to be made."""

    owner: str
    scopes: frozenset[str]
    fleets: frozenset[str] | None  # codes of the fleets that it sees; None for all
    expires_ns: int | None  # when it expires, ns UTC; None for never


def make_key(unit: SqlUnitOfWork, wanted: Wanted, by: str, now_ns: int) -> tuple[ApiKey, str]:
    """Store a new key and return it with its secret; a refusal names the field."""
    if not wanted.owner.strip():
        raise ParameterError("names nobody", field="owner")
    if not wanted.scopes or wanted.scopes - EVERYTHING:
        raise ParameterError(f"must be some of {', '.join(sorted(EVERYTHING))}", field="scopes")
    if wanted.expires_ns is not None and wanted.expires_ns <= now_ns:
        raise ParameterError("is not in the future", field="expires_at")
    if wanted.fleets is not None:
        known = {fleet.code for fleet in unit.registry.fleets()}
        for code in sorted(wanted.fleets - known):
            raise NotFoundError("fleet", code)
    token = _new_token()
    while unit.api_keys.find(prefix := str(prefix_of(token))) is not None:
        token = _new_token()
    made = ApiKey(prefix, digest_of(token), wanted.owner, wanted.scopes, wanted.fleets, now_ns, by, wanted.expires_ns)
    unit.api_keys.add(made)
    return made, token
