"""Rule: the conicity limit is going to be reached within so many kilometres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Interval

from estimation.alerts.rules.evidence import (
    DecidingEvidence,
    Evidence,
    number_evidence,
)
from estimation.alerts.rules.intervals import with_standing
from estimation.alerts.rules.rule import AlertRule, Probability, WheelsetFacts
from estimation.trend.trend import probability_within
from estimation.values.alerts import Finding, Severity
from estimation.values.fields import Served
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.trend import WearTrend

PROBABLY_OVER = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitForecastEvidence(DecidingEvidence):
    """Evidence of `limit_forecast`: when the trend reaches the limit."""

    quantity: Annotated[str, Served("What the trend is of.", example="equivalent_conicity")]
    slope_per_1000_km: Annotated[Estimate, Served("Slope of the trend.", "slope_1_per_1000_km")]
    fitted: Annotated[Estimate, Served("The fitted trend at its last point.", "fitted_1")]
    distance_to_limit_km: Annotated[Forecast, Served("Distance left to the limit.")]
    date_of_limit_ns: Annotated[Forecast, Served("When the limit is reached; to the second.", "date_of_limit")]
    within_km: Annotated[float, Served("Distance within which reaching the limit raises the alert.")]
    limit: Annotated[float | None, Served("Limit of the quantity.", "limit_1")]
    points: Annotated[int, Served("Points of the trend.")]


@dataclass(frozen=True, slots=True)
class LimitForecastRule(AlertRule):
    """The conicity limit is going to be reached within a distance."""

    kind: ClassVar[str] = "limit_forecast"
    limit_unit: ClassVar[str] = "km"
    evidence: ClassVar[type[Evidence] | None] = LimitForecastEvidence
    counts_km: ClassVar[bool] = True
    of_wear: ClassVar[bool] = True
    relations: ClassVar[Sequence[tuple[str, str, str]]] = (("clear_within_km", ">=", "within_km"),)

    within_km: float = 20_000.0
    clear_within_km: float = 30_000.0
    raise_probability: Probability = 0.5  # that it is reached within within_km
    clear_probability: Probability = 0.8  # that it is not reached within clear_within_km
    minimum_points: Annotated[int, Interval(ge=2, le=1_000_000)] = 3

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the trend, which stands by all intervals; None without one of the present profile."""
        return with_standing(self._find, facts, self.delays)

    def _find(self, facts: WheelsetFacts) -> Finding | None:
        if facts.geometry is None or facts.current_trend is None:
            return None
        return limit_forecast_finding(
            self,
            facts.wheelset.serial,
            facts.current_trend.trend,
            facts.geometry.to_ns,
            not_assessable_reason=facts.not_assessable_reason,
        )


def limit_forecast_finding(
    rule: LimitForecastRule,
    wheelset: str,
    trend: WearTrend,
    measured_ns: int,
    *,
    not_assessable_reason: Reason | None = None,
) -> Finding:
    """Return the finding on the distance that is left to the limit of the trend.

    Args:
        measured_ns: Time of the newest data behind the trend.
        not_assessable_reason: Why the data do not describe the present wheelset; None where they do.
    """
    points = len(trend.value)
    reason = not_assessable_reason or (trend.reason if trend.status is not Status.ESTIMATED else trend.not_comparable)
    reason = reason or trend.few_behind
    if reason is None and points < rule.minimum_points:
        reason = Reason(ReasonCode.TOO_FEW_POINTS, f"{points} points, {rule.minimum_points} needed")
    within = None if reason else probability_within(trend, rule.within_km)
    within_clear = None if reason else probability_within(trend, rule.clear_within_km)
    return Finding(
        wheelset=wheelset,
        kind=LimitForecastRule.kind,
        breached=None if within is None else within >= rule.raise_probability,
        cleared=None if within_clear is None else 1.0 - within_clear >= rule.clear_probability,
        severity=_severity(rule, trend, within),
        probability=number_evidence(within, 2),
        evidence=LimitForecastEvidence(
            quantity=trend.quantity,
            slope_per_1000_km=trend.slope_per_1000_km,
            fitted=trend.fitted,
            distance_to_limit_km=trend.distance_to_limit_km,
            date_of_limit_ns=trend.date_of_limit_ns,
            within_km=rule.within_km,
            limit=number_evidence(trend.limit),
            points=points,
            unknown=reason,
        ).stored(),
        action="plan_reprofiling",
        raise_limit=rule.within_km,
        clear_limit=rule.clear_within_km,
        measured_ns=measured_ns,
    )


def _severity(rule: LimitForecastRule, trend: WearTrend, within: float | None) -> Severity:
    """Return how urgent it is: what is probably over the limit now is no mere information."""
    if within is None:
        return Severity.INFO
    over = (trend.probability_over_limit or 0.0) >= PROBABLY_OVER
    return Severity.WARNING if over or within >= rule.clear_probability else Severity.INFO
