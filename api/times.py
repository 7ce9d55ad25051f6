"""Times at the edge: RFC 3339 in UTC outside, int64 nanoseconds inside; nothing is lost between the two."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, WithJsonSchema

from estimation.values.arrays import IntArray
from estimation.values.reasons import EPOCH, utc_text
from estimation.values.units import SECOND_NS

_SHAPE = re.compile(r"(\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?([Zz]|[+-]\d\d:\d\d)", re.ASCII)
_INT64 = 2**63


to_rfc3339 = utc_text
"""Nanoseconds since the epoch as RFC 3339 in UTC, with as many decimals as the time has."""


def times_to_rfc3339(times_ns: IntArray) -> list[str]:
    """Return each of many times (n,), ns above -2^63, as :func:`to_rfc3339` does, in a tenth of its time."""
    texts = np.datetime_as_string(np.asarray(times_ns, np.int64).view("datetime64[ns]"), unit="ns").tolist()
    return [f"{text.rstrip('0').rstrip('.')}Z" for text in texts]


def from_rfc3339(text: object) -> int:
    """Return nanoseconds since the epoch; ValueError where it is no RFC 3339, has no offset, or is beyond 64 bits."""
    match = _SHAPE.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        raise ValueError("must be a time as in RFC 3339 with its offset, such as 2026-01-31T12:00:00Z")
    whole, decimals, offset = match.groups()
    try:
        moment = datetime.fromisoformat(whole.upper() + offset.upper())
        since = moment - EPOCH
    except (ValueError, OverflowError):
        raise ValueError("must be a time that exists") from None
    t_ns = (since.days * 86400 + since.seconds) * SECOND_NS + int((decimals or "").ljust(9, "0"))
    if not -_INT64 <= t_ns < _INT64:
        raise ValueError("must be between the years 1678 and 2261")
    return t_ns


TIME_SCHEMA = {"type": "string", "format": "date-time"}
# A time that comes in: validated as RFC 3339, handed on as nanoseconds.
Moment = Annotated[int, BeforeValidator(from_rfc3339), WithJsonSchema(TIME_SCHEMA)]
# A time that goes out: already RFC 3339 text.
Timestamp = Annotated[str, WithJsonSchema(TIME_SCHEMA)]
