"""Who a bearer is: keys of the database, remembered for a few seconds, and tokens of an OpenID Connect provider."""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import time
import urllib.request
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import anyio.to_thread
import jwt
from anyio import CapacityLimiter

from api.access.keys import EVERYTHING, digest_of, prefix_of
from api.problems import invalid
from fleet_db.records import ApiKey
from fleet_db.storage import SqlStorage


@dataclass(frozen=True, slots=True)
class Caller:
    """The owner of a key or token.

    Args:
        name: Of the owner, as it is recorded with what is done; None where access is open.
        fleets: Codes of the fleets that are visible; None for all.
        identity: Of the key or token's subject, such as ``key 3fq2xh7a``: what limits and Idempotency-Keys belong to;
            None where access is open.
    """

    name: str | None
    scopes: frozenset[str]
    fleets: frozenset[str] | None
    identity: str | None = None

    @property
    def key_prefix(self) -> str | None:
        """Prefix of the key; None for a token and where access is open."""
        kind, _, rest = (self.identity or "").partition(" ")
        return rest if kind == "key" else None

    def acts_as(self, by: str | None, unnamed: str | None = None) -> str:
        """Return who is recorded as the actor: the owner of the key; where access is open, ``by`` or ``unnamed``."""
        if self.name is None and (by or unnamed) is not None:
            return by or str(unnamed)
        if self.name is None or by not in {None, self.name}:
            wrong = (
                "is required where access is open" if self.name is None else f"is not the key's owner, {self.name!r}"
            )
            raise invalid("#/by", wrong)
        return self.name


ANYONE = Caller(None, EVERYTHING, None)  # the caller of a service whose access is open


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
        read = self._known.get(digest)
        age_s = float("inf") if read is None else time.monotonic() - read.read_s
        if age_s >= AGAIN_S:
            reading = self._reading.get(digest)
            if reading is None:
                reading = self._reading[digest] = asyncio.ensure_future(self._read(prefix, digest))
                reading.add_done_callback(lambda task: self._ended(digest, task))
            if age_s >= AT_MOST_S:
                key = await asyncio.shield(reading)
                return key if key is not None and key.usable(now_ns) else None
        assert read is not None
        return read.key if read.key.usable(now_ns) else None

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


ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "EdDSA")
"""Signatures with public keys only: `none` proves nothing, and an HS key could be the public key itself."""
REFRESH_S = 60.0  # the published keys are fetched again at most this often
OLD_S = 3600.0  # after so long they are fetched again in any case: one may have been withdrawn
TIMEOUT_S = 5.0
LARGEST = 1 << 20  # bytes of published keys, at most
ALL_FLEETS = "*"
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Provider:
    """Which tokens are taken, and what of them says what.

    Args:
        keys: URL or file of the JSON Web Key Set.
        owner_claim, scopes_claim, fleets_claim: Names of the claims. Scopes are a list or a text with spaces. Fleets
            are a list, or `*` for all; a token without them sees none.
    """

    issuer: str
    audience: str
    keys: str
    owner_claim: str = "sub"
    scopes_claim: str = "scope"
    fleets_claim: str = "fleets"
    leeway_s: float = 30.0


@dataclass(slots=True)
class Tokens:
    """Checks tokens; for one event loop."""

    provider: Provider
    _keys: Mapping[str | None, jwt.PyJWK] = field(default_factory=dict)
    _fetched_s: float = float("-inf")

    async def find(self, token: str) -> Caller | None:
        """Return the caller that a token names; None where it is not to be believed, whatever the cause."""
        try:
            header = jwt.get_unverified_header(token)
            if header.get("alg") not in ALGORITHMS:
                return None
            key = await self._key(header.get("kid"))
            if key is None or header["alg"] != key.algorithm_name:
                return None
            claims = jwt.decode(
                token,
                key.key,
                algorithms=[header["alg"]],
                issuer=self.provider.issuer,
                audience=self.provider.audience,
                leeway=self.provider.leeway_s,
                options={"require": ["exp", "iss", "aud"]},
            )
        except (jwt.PyJWTError, ValueError, TypeError):
            return None
        return self._caller(claims)

    async def _key(self, identity: str | None) -> jwt.PyJWK | None:
        """Return a published key; an unknown one has the keys fetched again, at most once a minute."""
        age_s = time.monotonic() - self._fetched_s
        if age_s >= (OLD_S if identity in self._keys else REFRESH_S):
            self._fetched_s = time.monotonic()
            try:
                self._keys = await anyio.to_thread.run_sync(_published, self.provider.keys)
            except (OSError, ValueError, KeyError, TypeError) as error:
                _log.warning("the keys of the token issuer cannot be read: %s", type(error).__name__)
        return self._keys.get(identity)

    def _caller(self, claims: Mapping[str, Any]) -> Caller | None:
        provider = self.provider
        owner, subject = claims.get(provider.owner_claim), claims.get("sub")
        if not isinstance(owner, str) or not owner.strip() or not isinstance(subject, str):
            return None
        scopes = frozenset(_words(claims.get(provider.scopes_claim))) & EVERYTHING
        fleets = frozenset(_words(claims.get(provider.fleets_claim)))
        seen = None if ALL_FLEETS in fleets else fleets
        return Caller(owner, scopes, seen, f"token {provider.issuer} {subject}")


def _words(claim: object) -> Sequence[str]:
    """Return the texts of a claim that is a list, or one text with spaces."""
    if isinstance(claim, str):
        return claim.split()
    return [name for name in claim if isinstance(name, str)] if isinstance(claim, list) else []


def _published(place: str) -> Mapping[str | None, jwt.PyJWK]:
    if place.startswith(("https://", "http://")):
        with urllib.request.urlopen(place, timeout=TIMEOUT_S) as answer:  # noqa: S310 - the scheme is checked
            text = answer.read(LARGEST)
    else:
        text = Path(place).read_bytes()[:LARGEST]
    keys = [key for described in json.loads(text)["keys"] if (key := _signing_key(described)) is not None]
    return {key.key_id: key for key in keys}


def _signing_key(described: Mapping[str, Any]) -> jwt.PyJWK | None:
    """Return a public key that signs; None for one that encrypts, or is none that we know."""
    if described.get("use", "sig") != "sig":
        return None
    try:
        key = jwt.PyJWK.from_dict(dict(described))
    except jwt.PyJWTError:
        return None
    return key if key.algorithm_name in ALGORITHMS else None
