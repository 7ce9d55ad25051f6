"""Keys as their owners hold them: a public prefix by which they are found, and 256 random bits."""

from __future__ import annotations

import hashlib
import re
import secrets
from dataclasses import dataclass

_ALPHABET = "abcdefghijklmnopqrstuvwxyz234567"
_PREFIX_LENGTH = 8
_SECRET_BYTES = 32
_FORM = re.compile(r"tw_(?P<prefix>[a-z2-7]{8})_[A-Za-z0-9_-]{43}", re.ASCII)


@dataclass(frozen=True, slots=True)
class NewToken:
    """A key that was just made; ``text`` is shown once and never stored."""

    prefix: str
    text: str

    @property
    def digest(self) -> str:
        """What is stored of it."""
        return digest_of(self.text)


def new_token() -> NewToken:
    """Return a key that nobody has."""
    prefix = "".join(secrets.choice(_ALPHABET) for _ in range(_PREFIX_LENGTH))
    return NewToken(prefix, f"tw_{prefix}_{secrets.token_urlsafe(_SECRET_BYTES)}")


def prefix_of(token: str) -> str | None:
    """Return the prefix of a key; None where it has not the form of one."""
    found = _FORM.fullmatch(token)
    return None if found is None else found["prefix"]


def digest_of(token: str) -> str:
    """Return the SHA-256 of a key, hexadecimal; a slow hash would protect nothing more of 256 random bits."""
    return hashlib.sha256(token.encode()).hexdigest()
