"""Rule: the conicity limit is going to be reached within so many kilometres."""

from __future__ import annotations

from estimation.alerts.rules import evidence
from estimation.alerts.rules.book import LimitForecastRule
from estimation.trend.trend import probability_within
from estimation.values.alerts import AlertKind, Finding, Severity
from estimation.values.quantities import Status
from estimation.values.trend import WearTrend


def limit_forecast_finding(
    rule: LimitForecastRule, wheelset: str, trend: WearTrend, measured_ns: int, *, blind: str = ""
) -> Finding:
    """Return what the trend says of the distance to its limit.

    Parameters
    ----------
    rule
        Distances and probabilities.
    wheelset
        Serial.
    trend
        Trend since the last reprofiling.
    measured_ns
        Time of the newest data behind the trend.
    blind
        Why the data do not say how the wheelset is now; empty where they do.
    """
    points = len(trend.value)
    reason = blind or (trend.reason if trend.status is not Status.ESTIMATED else "")
    if not reason and points < rule.minimum_points:
        reason = f"{points} points, {rule.minimum_points} needed"
    within = None if reason else probability_within(trend, rule.within_km)
    within_clear = None if reason else probability_within(trend, rule.clear_within_km)
    return Finding(
        wheelset=wheelset,
        kind=AlertKind.LIMIT_FORECAST,
        breached=None if within is None else within >= rule.raise_probability,
        cleared=None if within_clear is None else 1.0 - within_clear >= rule.clear_probability,
        severity=Severity.INFO if within is None or within < rule.clear_probability else Severity.WARNING,
        probability=evidence.number(within, 2),
        evidence={
            "quantity": trend.quantity,
            "slope_per_1000_km": evidence.estimate(trend.slope_per_1000_km),
            "current": evidence.estimate(trend.current),
            "distance_to_limit_km": evidence.forecast(trend.distance_to_limit_km),
            "date_of_limit_ns": evidence.forecast(trend.date_of_limit_ns, 6),
            "within_km": rule.within_km,
            "limit": evidence.number(trend.limit),
            "points": points,
            "unknown_because": reason or None,
        },
        action="plan_reprofiling",
        raise_limit=rule.within_km,
        clear_limit=rule.clear_within_km,
        measured_ns=measured_ns,
    )
