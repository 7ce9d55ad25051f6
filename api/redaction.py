"""Passwords kept out of what is logged: those of this deployment, and whatever reads like one, or signs webhooks."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from urllib.parse import quote, quote_plus, unquote

HIDDEN = "***"
_IN_URL = re.compile(r"(?P<before>[a-zA-Z][a-zA-Z0-9+.-]*://[^\s:/@]*:)[^\s@]+(?=@)")
_NAMED = re.compile(r"(?P<before>\bpassword['\"]?\s*[=:]\s*)(?:'[^']*'|\\?\"[^\"]*\"|[^\s,;&)}]+)", re.IGNORECASE)
_WEBHOOK_SECRET = re.compile(r"\bwhsec_[A-Za-z0-9+/=_-]{4,}")
_SHORTEST = 4
"""Characters of a password from which on it is looked for as such; a shorter one would blot out common words."""


def password_in(url: str) -> str | None:
    """Return the password of a URL as it is written there; None without one."""
    authority = url.partition("://")[2]
    user, separator, _ = authority.rpartition("@")
    _, colon, password = user.partition(":")
    return password if separator and colon and password else None


@dataclass(frozen=True)
class Redactor:
    """Replaces passwords in a text.

    Attributes:
        secrets: Passwords of this deployment; each is found as it is, decoded, percent-encoded and escaped in JSON.
    """

    secrets: tuple[str, ...] = ()

    @classmethod
    def of_urls(cls, urls: Iterable[str | None]) -> Redactor:
        """Return the redactor of the passwords in these URLs."""
        return cls(tuple(found for url in urls if url for found in [password_in(url)] if found))

    @cached_property
    def _forms(self) -> tuple[str, ...]:
        forms: set[str] = set()
        for secret in self.secrets:
            for one in {secret, unquote(secret)}:
                forms |= {one, quote(one, safe=""), quote_plus(one), json.dumps(one)[1:-1], repr(one)[1:-1]}
        return tuple(sorted((form for form in forms if len(form) >= _SHORTEST), key=len, reverse=True))

    def __call__(self, text: str) -> str:
        """Return ``text`` without passwords."""
        for form in self._forms:
            text = text.replace(form, HIDDEN)
        if "://" in text:
            text = _IN_URL.sub(rf"\g<before>{HIDDEN}", text)
        if "password" in text.lower():
            text = _NAMED.sub(rf"\g<before>{HIDDEN}", text)
        if "whsec_" in text:
            text = _WEBHOOK_SECRET.sub(f"whsec_{HIDDEN}", text)
        return text
