"""Bearer tokens of an OpenID Connect provider: signed JWTs, checked against the provider's published keys."""

from __future__ import annotations

import json
import logging
import time
import urllib.request
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import anyio.to_thread
import jwt

from api.access.caller import EVERYTHING, Caller

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
    return [one for one in claim if isinstance(one, str)] if isinstance(claim, list) else []


def _published(place: str) -> Mapping[str | None, jwt.PyJWK]:
    if place.startswith(("https://", "http://")):
        with urllib.request.urlopen(place, timeout=TIMEOUT_S) as answer:  # noqa: S310 - the scheme is checked
            text = answer.read(LARGEST)
    else:
        text = Path(place).read_bytes()[:LARGEST]
    keys = [key for one in json.loads(text)["keys"] if (key := _signing_key(one)) is not None]
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
