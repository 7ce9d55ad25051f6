"""Times as people read them in messages."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_SECOND = 1_000_000_000


def utc_text(t_ns: int) -> str:
    """Return a time in UTC, to the second where it is a whole one.

    Args:
        t_ns: ns since 1970, UTC.
    """
    seconds, rest = divmod(t_ns, _SECOND)
    decimals = f".{rest:09d}".rstrip("0") if rest else ""
    return f"{(_EPOCH + timedelta(seconds=seconds)).strftime('%Y-%m-%dT%H:%M:%S')}{decimals}Z"
