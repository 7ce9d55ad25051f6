"""Numbers as evidence: rounded to what they are worth, so that float noise never looks like news."""

from __future__ import annotations

import math

from estimation.values.json_value import JsonValue
from estimation.values.quantities import Estimate, Forecast


def number(value: float | None, digits: int = 4) -> float | None:
    """Return the value with some significant digits; None where unknown or not finite."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{digits}g}")


def estimate(value: Estimate) -> dict[str, JsonValue]:
    """Return an estimate with its interval and status, as the API writes it."""
    return {
        "value": number(value.value),
        "std": number(value.std, 3),
        "interval_95": None if value.low is None else [number(value.low), number(value.high)],
        "n_windows": number(value.count),
        "status": str(value.status),
        "reason": value.reason or None,
    }


def forecast(value: Forecast, digits: int = 3) -> dict[str, JsonValue]:
    """Return the quantiles of a forecast."""
    return {"p10": number(value.p10, digits), "p50": number(value.p50, digits), "p90": number(value.p90, digits)}
