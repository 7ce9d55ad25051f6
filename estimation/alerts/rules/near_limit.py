"""Rules on a conicity near its limit: to measure profiles where data do not decide, and to plan a reprofiling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval

from estimation.alerts.rules.conicity_limit import ConicityLimitRule, LimitState, conicity_limit_finding, limit_state
from estimation.alerts.rules.rule import (
    DecidingEvidence,
    Kilometres,
    Probability,
    WheelsetFacts,
    number_evidence,
    unknown_evidence,
)
from estimation.alerts.rules.standing import IntervalsRule
from estimation.trend.extrapolation import QUANTITY
from estimation.trend.trend import probability_within
from estimation.values.alerts import Finding, Severity
from estimation.values.fields import Served
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.trend import WearTrend

ANY_PROBABILITY = Interval(ge=0.01, le=0.9)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureEvidence(DecidingEvidence):
    """Evidence of `measure`: the conicity may be over its limit, and only a measurement of the profiles decides."""

    quantity: Annotated[str, Served("What is compared with the limit.", example="equivalent_conicity")]
    conicity: Annotated[Estimate, Served("Equivalent conicity at 3 mm; its reason says if extrapolated.", "conicity_1")]
    reached_mm: Annotated[float | None, Served("Largest amplitude that the motion covers, at most 3 mm.")]
    reached: Annotated[Estimate, Served("Equivalent conicity at that amplitude.", "reached_1")]
    windows: Annotated[int | None, Served("Windows behind the geometry.")] = None
    limit: Annotated[float | None, Served("Limit of the conicity at 3 mm.", "limit_1")]


@dataclass(frozen=True, slots=True)
class MeasureRule(IntervalsRule):
    """The conicity may be over its limit: not surely enough for `conicity_limit`, too probably to leave it."""

    kind = "measure"
    limit_unit = "1"
    evidence = MeasureEvidence
    advice = "may be beyond its limit: measure its profiles"
    relations = (
        ("clear_probability", "<=", "raise_probability"),
        ("clear_probability", "<=", "extrapolated_probability"),
    )

    raise_probability: Annotated[float, ANY_PROBABILITY] = 0.5  # that it is over where the motion covers 3 mm
    extrapolated_probability: Annotated[float, ANY_PROBABILITY] = 0.12  # and where it does not: no data will decide it
    clear_probability: Annotated[float, ANY_PROBABILITY] = 0.1
    reaches: Annotated[float, Interval(ge=1.0, le=10.0)] = 1.5  # limits that an interval at 3 mm goes up to
    measured_within_km: Kilometres = 10_000.0  # a measurement decides for as long

    def find_now(self, facts: WheelsetFacts) -> Finding | None:
        """Return the finding; None without a geometry or a limit."""
        rule, state = facts.limit_rule, limit_state(facts)
        if not isinstance(rule, ConicityLimitRule) or facts.geometry is None or state is None:
            return None
        limit = rule.limit_of(facts)
        if limit is None:
            return None
        decided = conicity_limit_finding(
            rule,
            facts.wheelset.serial,
            state,
            facts.geometry.geometry.windows,
            limit,
            facts.geometry.to_ns,
            not_assessable_reason=facts.not_assessable_reason,
        )
        at_km = facts.profiles_measured_km
        measured = at_km is not None and facts.geometry.mileage_km - at_km <= self.measured_within_km
        return measure_finding(self, state, decided, limit, measured=measured)


def measure_finding(rule: MeasureRule, state: LimitState, decided: Finding, limit: float, *, measured: bool) -> Finding:
    """Return whether the profiles are to be measured."""
    at_limit, at_reached = state.at_limit(limit), state.at_reached(limit)
    over = max((one.probability for one in (at_limit, at_reached) if one is not None), default=0.0)
    needed = rule.extrapolated_probability if state.extrapolated else rule.raise_probability
    at_3_mm = 0.0 if at_limit is None else at_limit.probability
    reached = 0.0 if at_reached is None else at_reached.probability
    open_far = not state.extrapolated and (state.conicity.high or 0.0) >= rule.reaches * limit
    unsaid = (
        at_limit is None
        and (state.reached is not None or state.left_open)
        and (decided.breached is not None or decided.evidence["unknown_because_code"] == code_of(state.conicity.reason))
    )  # nothing else hides the state
    may_be = at_3_mm >= needed or reached >= rule.raise_probability or open_far or unsaid
    silent, settled = decided.breached is None and not unsaid, measured or decided.breached is True
    is_clear = at_3_mm <= rule.clear_probability and reached <= rule.clear_probability and not may_be
    return Finding(
        wheelset=decided.wheelset,
        kind=MeasureRule.kind,
        breached=None if silent else may_be and not settled,
        cleared=None if silent else settled or is_clear,
        probability=None if silent else number_evidence(over, 3),
        evidence=MeasureEvidence(
            quantity=QUANTITY,
            conicity=state.conicity,
            reached_mm=number_evidence(1e3 * state.reached_amplitude),
            reached=state.conicity if state.reached is None else state.reached,
            limit=number_evidence(limit),
        ).stored()
        | {name: decided.evidence[name] for name in ("windows", *unknown_evidence(None))},
        action="measure_wheel_profiles",
        raise_limit=limit,
        clear_limit=limit,
        measured_ns=decided.measured_ns,
    )


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
class LimitForecastRule(IntervalsRule):
    """The conicity limit is going to be reached within a distance."""

    kind = "limit_forecast"
    limit_unit = "km"
    evidence = LimitForecastEvidence
    relations = (("clear_within_km", ">=", "within_km"),)

    within_km: float = 20_000.0
    clear_within_km: float = 30_000.0
    raise_probability: Probability = 0.5  # that it is reached within within_km
    clear_probability: Probability = 0.8  # that it is not reached within clear_within_km
    minimum_points: Annotated[int, Interval(ge=2, le=1_000_000)] = 3

    def find_now(self, facts: WheelsetFacts) -> Finding | None:
        """Return the finding of the trend; None without one of the present profile."""
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
    """Return the finding on the distance that is left to the limit of the trend."""
    points = len(trend.value)
    reason = not_assessable_reason or (trend.reason if trend.status is not Status.ESTIMATED else trend.not_comparable)
    reason = reason or trend.few_behind
    if reason is None and points < rule.minimum_points:
        reason = Reason(ReasonCode.TOO_FEW_POINTS, f"{points} points, {rule.minimum_points} needed")
    within = None if reason else probability_within(trend, rule.within_km)
    within_clear = None if reason else probability_within(trend, rule.clear_within_km)
    over = (trend.probability_over_limit or 0.0) >= PROBABLY_OVER  # that is no mere information
    urgent = within is not None and (over or within >= rule.clear_probability)
    severity = Severity.WARNING if urgent else Severity.INFO
    return Finding(
        wheelset=wheelset,
        kind=LimitForecastRule.kind,
        breached=None if within is None else within >= rule.raise_probability,
        cleared=None if within_clear is None else 1.0 - within_clear >= rule.clear_probability,
        severity=severity,
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
