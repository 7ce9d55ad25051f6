"""Numbers as evidence: rounded to what they are worth, so that float noise never looks like news."""

from __future__ import annotations

import math

from estimation.values.json_value import JsonValue
from estimation.values.quantities import Estimate, Forecast
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of


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
        "reason": text_of(value.reason),
        "reason_code": code_of(value.reason),
    }


def unknown(reason: Reason | None) -> dict[str, JsonValue]:
    """Return why a rule cannot decide, as sentence and code; both None where it can.

    Parameters
    ----------
    reason
        Why.
    """
    return {"unknown_because": text_of(reason), "unknown_because_code": code_of(reason)}


def too_few_windows(windows: int, needed: int) -> Reason | None:
    """Return that there are fewer windows than a rule needs; None where there are enough.

    Parameters
    ----------
    windows, needed
        How many there are, and the least number.
    """
    if windows >= needed:
        return None
    return Reason(ReasonCode.TOO_FEW_WINDOWS, f"{windows} windows, {needed} needed")


def forecast(value: Forecast, digits: int = 3) -> dict[str, JsonValue]:
    """Return the quantiles of a forecast."""
    return {"p10": number(value.p10, digits), "p50": number(value.p50, digits), "p90": number(value.p90, digits)}
