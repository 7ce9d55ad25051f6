"""Keys of the REST API: their form, what they allow, and how one is made."""

from __future__ import annotations

import hashlib
import re
import secrets
from dataclasses import dataclass

from estimation.errors import NotFoundError, ParameterError
from fleet_db.records import ApiKey
from fleet_db.storage import SqlUnitOfWork

EVERYTHING = frozenset({"read", "act", "ingest", "admin"})
NOBODY_NAMED = "anyone"  # who makes a key where access is open

_ALPHABET = "abcdefghijklmnopqrstuvwxyz234567"
_PREFIX_LENGTH = 8
_SECRET_BYTES = 32
_FORM = re.compile(r"tw_(?P<prefix>[a-z2-7]{8})_[A-Za-z0-9_-]{43}", re.ASCII)


def _new_token() -> str:
    prefix = "".join(secrets.choice(_ALPHABET) for _ in range(_PREFIX_LENGTH))
    return f"tw_{prefix}_{secrets.token_urlsafe(_SECRET_BYTES)}"


def prefix_of(token: str) -> str | None:
    """Return the prefix of a key; None where it has not the form of one."""
    form = _FORM.fullmatch(token)
    return None if form is None else form["prefix"]


def digest_of(token: str) -> str:
    """Return the SHA-256 of a key, hexadecimal; a slow hash would protect nothing more of 256 random bits."""
    return hashlib.sha256(token.encode()).hexdigest()


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
        on_file = {fleet.code for fleet in unit.registry.fleets()}
        for code in sorted(wanted.fleets - on_file):
            raise NotFoundError("fleet", code)
    token = _new_token()
    while unit.api_keys.find(prefix := str(prefix_of(token))) is not None:
        token = _new_token()
    made = ApiKey(prefix, digest_of(token), wanted.owner, wanted.scopes, wanted.fleets, now_ns, by, wanted.expires_ns)
    unit.api_keys.add(made)
    return made, token
