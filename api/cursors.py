"""Opaque cursors of lists: where the last page ended, bound to the list and its filter."""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Mapping

import orjson

from api.problems import ProblemError

_DIGEST_LENGTH = 12
INT64 = 2**63
Key = str | int | list[float | int | str | None]


def _digest(operation: str, filters: Mapping[str, object]) -> str:
    listed = orjson.dumps(
        [operation, sorted((name, str(value)) for name, value in filters.items() if value is not None)]
    )
    return hashlib.sha256(listed).hexdigest()[:_DIGEST_LENGTH]


def encode(operation: str, filters: Mapping[str, object], key: Key) -> str:
    """Return the cursor that stands behind ``key`` in this list under this filter."""
    raw = orjson.dumps([_digest(operation, filters), key])
    return base64.urlsafe_b64encode(raw).decode().rstrip("=")


def refused(detail: str = "this is no cursor of this list") -> ProblemError:
    """Return the problem of a cursor that cannot be used."""
    return ProblemError(400, "invalid-cursor", detail)


def _unpack(cursor: str) -> tuple[str, object]:
    try:
        raw = base64.b64decode(cursor + "=" * (-len(cursor) % 4), altchars=b"-_", validate=True)
        digest, key = orjson.loads(raw)
    except (binascii.Error, ValueError, TypeError):
        raise refused("this is no cursor of this service") from None
    return str(digest), key


def decode_number(operation: str, filters: Mapping[str, object], cursor: str | None) -> int | None:
    """Return the key of a list that is ordered by a number, as :func:`decode` does."""
    return number_of(decode(operation, filters, cursor))


def number_of(key: object) -> int | None:
    """Return the key of a list that is ordered by a number; None at its beginning."""
    if key is None:
        return None
    if isinstance(key, int) and is_number(key):
        return key
    raise refused()


def is_number(key: float) -> bool:
    """Return whether a number may be a key: it is one, and a database can hold it."""
    return not isinstance(key, bool) and -INT64 <= key < INT64


def decode_text(operation: str, filters: Mapping[str, object], cursor: str | None) -> str | None:
    """Return the key of a list that is ordered by a text, as :func:`decode` does."""
    key = decode(operation, filters, cursor)
    if key is not None and (not isinstance(key, str) or "\0" in key):
        raise refused()
    return key


def decode(operation: str, filters: Mapping[str, object], cursor: str | None) -> object:
    """Return the key in a cursor, of any form; None at the beginning of a list."""
    if cursor is None:
        return None
    digest, key = _unpack(cursor)
    if digest != _digest(operation, filters):
        raise refused("this cursor belongs to another list or another filter; start again without it")
    if key is None:
        raise refused()
    return key
