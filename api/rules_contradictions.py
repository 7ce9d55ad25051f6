"""What in a rule contradicts itself, so that its alerts would never be raised or never be cleared."""

from __future__ import annotations

import math
import operator

from estimation.alerts.rules.conicity_limit import ConicityLimitRule
from estimation.alerts.rules.rule import AlertRule
from ingest.input_file import Location

_RELATIONS = {"<=": (operator.le, "is above"), ">=": (operator.ge, "is below")}


def contradiction(rule: AlertRule) -> tuple[Location, str] | None:
    """Return the field that contradicts another, and why; None where none does."""
    for name, relation, other in rule.relations:
        holds, contrary = _RELATIONS[relation]
        value, limit = getattr(rule, name), getattr(rule, other)
        if not holds(value, limit):
            return (name,), f"{value:g} {contrary} {other} ({limit:g})"
    if not rule.counts_km:
        for name in ("on_delay_km", "off_delay_km"):
            if getattr(rule.delays, name) > 0.0:
                return ("delays", name), f"{rule.kind} has no mileage to count; set evaluations"
    return _of_bands(rule) if isinstance(rule, ConicityLimitRule) else None


def _of_bands(rule: ConicityLimitRule) -> tuple[Location, str] | None:
    seen: set[tuple[str, float]] = set()
    for i, band in enumerate(rule.bands):
        scope = (band.vehicle_class, band.up_to_km_h)
        if scope in seen:
            return ("bands", i), f"{band.vehicle_class!r} up to {band.up_to_km_h:g} km/h is there twice"
        seen.add(scope)
        falls = band.per_km_h < 0.0 and math.isfinite(band.up_to_km_h)
        least = band.at(band.up_to_km_h) if falls else band.limit
        if least <= rule.clear_margin:
            reason = (
                f"the clear limit would not be above 0: {least:g} is not above clear_margin ({rule.clear_margin:g})"
            )
            return ("bands", i, "limit"), reason
    return None
