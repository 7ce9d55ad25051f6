"""What led to a finding: one frozen class a rule, which says what its alerts keep and what the API answers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from typing import Annotated

from estimation.values.fields import JsonValue, Served
from estimation.values.quantities import Estimate, Forecast
from estimation.values.reasons import Reason, code_of, text_of

SECOND_NS = 1_000_000_000
MOST_NS = 2.0**63 - SECOND_NS  # so that the rounded time is within 64 bits


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What led to a finding; fields are described for the reader of the API."""

    def stored(self) -> dict[str, JsonValue]:
        """Return the fields as an alert keeps them: JSON under their own names."""
        kept: dict[str, JsonValue] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "unknown":
                kept |= unknown_evidence(value)
            elif isinstance(value, Forecast) and field.name.endswith("_ns"):
                kept[field.name] = date_evidence(value)
            else:
                kept[field.name] = _stored(value)
        return kept


@dataclass(frozen=True, slots=True, kw_only=True)
class DecidingEvidence(Evidence):
    """Evidence of a rule that the data may leave undecided."""

    unknown: Annotated[Reason | None, Served("Why the data decide nothing at present; null where they do.")] = None


def _stored(value: object) -> JsonValue:
    if isinstance(value, Estimate | Forecast):
        return dict(estimate_evidence(value) if isinstance(value, Estimate) else forecast_evidence(value))
    if isinstance(value, Enum):
        return str(value.value)
    if is_dataclass(value):
        return {field.name: _stored(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple | list):
        return [_stored(item) for item in value]
    if isinstance(value, Mapping):
        return {str(name): _stored(value[name]) for name in sorted(value)}
    return value  # type: ignore[return-value]  # a number, a text or None


def number_evidence(value: float | None, digits: int = 4) -> float | None:
    """Return the value with some significant digits; None where unknown or not finite."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{digits}g}")


def estimate_evidence(value: Estimate) -> dict[str, JsonValue]:
    """Return an estimate with its interval and status, as the API writes it."""
    return {
        "value": number_evidence(value.value),
        "std": number_evidence(value.std, 3),
        "interval_95": None if value.low is None else [number_evidence(value.low), number_evidence(value.high)],
        "n_windows": number_evidence(value.count),
        "status": str(value.status),
        "reason": text_of(value.reason),
        "reason_code": code_of(value.reason),
    }


def unknown_evidence(reason: Reason | None) -> dict[str, JsonValue]:
    """Return why a rule cannot decide, as sentence and code; both None where it can."""
    return {"unknown_because": text_of(reason), "unknown_because_code": code_of(reason)}


def forecast_evidence(value: Forecast, digits: int = 3) -> dict[str, JsonValue]:
    """Return the quantiles of a forecast."""
    return {name: number_evidence(getattr(value, name), digits) for name in ("p10", "p50", "p90")}


def date_evidence(value: Forecast) -> dict[str, JsonValue]:
    """Return the quantiles of a date in whole seconds, ns UTC; None beyond what 64 bits hold."""
    return {name: _whole_second(getattr(value, name)) for name in ("p10", "p50", "p90")}


def _whole_second(t_ns: float | None) -> int | None:
    if t_ns is None or not abs(t_ns) < MOST_NS:
        return None
    return round(t_ns / SECOND_NS) * SECOND_NS
