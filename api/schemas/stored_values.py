"""Values of the JSON that alerts keep, read as what they should be; None where another thing is stored.

An alert is answered for good: nothing here raises, whatever is stored.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from api.schemas.common import Uncertain
from api.schemas.trend import DateForecast, DistanceForecast
from api.times import to_rfc3339
from estimation.values.json_value import JsonValue
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of

SAFE = 2**53  # beyond it a reader of JSON may round an integer
SECOND_NS = 1_000_000_000
_BEYOND = Reason(ReasonCode.BEYOND_HORIZON, "not reached within the forecast horizon")
_QUANTILES = ("p10", "p50", "p90")

Stored = Mapping[str, JsonValue]


def number(value: JsonValue) -> float | None:
    """Return a finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return float(value)


def count(value: JsonValue) -> int | None:
    """Return a whole number that every reader of JSON keeps."""
    found = number(value)
    return None if found is None or abs(found) >= SAFE else int(found)


def text(value: JsonValue) -> str | None:
    """Return a text."""
    return value if isinstance(value, str) else None


def moment(value: JsonValue) -> str | None:
    """Return a time that is stored as nanoseconds."""
    if isinstance(value, float):
        value = round(value / SECOND_NS) * SECOND_NS if math.isfinite(value) else None
    if isinstance(value, bool) or not isinstance(value, int) or abs(value) >= 2**63:
        return None
    return to_rfc3339(value)


def code(value: JsonValue) -> ReasonCode | None:
    """Return a reason code that is known."""
    return next((known for known in ReasonCode if known == value), None)


def part(value: JsonValue) -> Stored:
    """Return an object; an empty one in place of anything else."""
    return value if isinstance(value, Mapping) else {}


def counted(value: JsonValue) -> dict[str, int]:
    """Return counts, each under its name."""
    return {name: found for name, item in part(value).items() if (found := count(item)) is not None}


def estimate(value: JsonValue) -> Uncertain | None:
    """Return an estimate with its interval and status; None where nothing of the kind is stored."""
    if not isinstance(value, Mapping):
        return None
    ends = value.get("interval_95")
    bounds = [number(end) for end in ends] if isinstance(ends, Sequence) and not isinstance(ends, str) else []
    low, high = bounds if len(bounds) == 2 else (None, None)  # noqa: PLR2004 - an interval has two ends
    return Uncertain(
        value=number(value.get("value")),
        std=number(value.get("std")),
        interval_95=None if low is None or high is None else (low, high),
        n_windows=number(value.get("n_windows")) or 0.0,
        status=next((known for known in Status if known == value.get("status")), Status.INVALID),
        reason=text(value.get("reason")),
        reason_code=code(value.get("reason_code")),
    )


def distance(value: JsonValue, unknown: Reason | None) -> DistanceForecast:
    """Return the quantiles of a distance in km.

    Args:
        unknown: Why nothing is known; None where missing quantiles are beyond the horizon.
    """
    p10, p50, p90 = (number(part(value).get(name)) for name in _QUANTILES)
    reason = (unknown or _BEYOND) if None in (p10, p50, p90) else None
    return DistanceForecast(p10=p10, p50=p50, p90=p90, reason=text_of(reason), reason_code=code_of(reason))


def date(value: JsonValue, unknown: Reason | None) -> DateForecast:
    """Return the quantiles of a date.

    Args:
        value: As stored, ns UTC.
        unknown: Why nothing is known; None where missing quantiles are beyond the horizon.
    """
    p10, p50, p90 = (moment(part(value).get(name)) for name in _QUANTILES)
    reason = (unknown or _BEYOND) if None in (p10, p50, p90) else None
    return DateForecast(p10=p10, p50=p50, p90=p90, reason=text_of(reason), reason_code=code_of(reason))
