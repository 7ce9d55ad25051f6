"""Rule: equivalent conicity over the limit of the vehicle's class and speed."""

from __future__ import annotations

from estimation.alerts.rules import evidence
from estimation.alerts.rules.book import ConicityLimitRule
from estimation.trend.trend import probability_above
from estimation.values.alerts import AlertKind, Finding, Severity
from estimation.values.quantities import Estimate


def conicity_limit_finding(
    rule: ConicityLimitRule,
    wheelset: str,
    conicity: Estimate,
    windows: int,
    limit: float,
    measured_ns: int,
    *,
    quantity: str = "equivalent_conicity",
    blind: str = "",
) -> Finding:
    """Return what the conicity says of the limit.

    Parameters
    ----------
    rule
        Probabilities and margins.
    wheelset
        Serial.
    conicity
        Fitted value now.
    windows
        Windows behind it.
    limit
        The raise limit.
    measured_ns
        Time of the newest data behind the conicity.
    quantity
        What the conicity is, with its amplitude where it is not 3 mm.
    blind
        Why the data do not say how the wheelset is now (silent, sensor fault, reprofiled since); empty where they do.
    """
    reason = blind or conicity.reason
    if not reason and windows < rule.minimum_windows:
        reason = f"{windows} windows, {rule.minimum_windows} needed"
    over = None if reason else probability_above(conicity, limit)
    clear_limit = limit - rule.clear_margin
    above_clear = probability_above(conicity, clear_limit)
    severity = Severity.WARNING
    if (probability_above(conicity, limit + rule.critical_margin) or 0.0) >= rule.raise_probability:
        severity = Severity.CRITICAL
    return Finding(
        wheelset=wheelset,
        kind=AlertKind.CONICITY_LIMIT,
        breached=None if over is None else over >= rule.raise_probability,
        cleared=None if over is None or above_clear is None else 1.0 - above_clear >= rule.clear_probability,
        severity=severity,
        probability=evidence.number(over, 3),
        evidence={
            "quantity": quantity,
            "conicity": evidence.estimate(conicity),
            "windows": windows,
            "limit": evidence.number(limit),
            "unknown_because": reason or None,
        },
        action="reprofile" if severity is Severity.CRITICAL else "plan_reprofiling",
        raise_limit=limit,
        clear_limit=clear_limit,
        measured_ns=measured_ns,
    )
