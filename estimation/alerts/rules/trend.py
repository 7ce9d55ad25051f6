"""Rules on the trend: the limit that it reaches, and a sudden change that nobody registered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval

from estimation.alerts.parameters import FINDINGS
from estimation.alerts.rules.rule import AlertRule, IntervalsRule, Probability, WheelsetFacts
from estimation.trend.now import SCALE, limit_now, probability_within
from estimation.values.alerts import DecidingEvidence, Evidence, Finding, LimitNow, Severity, number_evidence, restated
from estimation.values.fields import Served
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.trend import (
    UNREGISTERED_CHANGE,
    StepCause,
    StepExplanation,
    StepSurroundings,
    TrendStep,
    WearTrend,
)
from estimation.values.units import DAY_NS

_WORDS = {
    StepCause.TURNED: "turned",
    StepCause.EXCHANGED: "exchanged",
    StepCause.TURNED_END_FOR_END: "turned end for end",
    StepCause.DAMAGED: "damaged",
    StepCause.SENSOR: "another scale of its sensor",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ExplainedBy:
    """What may be behind a sudden change, and how well it explains it."""

    cause: Annotated[StepCause, Served("What may have happened.")]
    share: Annotated[float | None, Served("Probability among the causes.", "share_1")]
    left: Annotated[float | None, Served("Standard deviations that it leaves open.", "left_1")]


@dataclass(frozen=True, slots=True, kw_only=True)
class UnregisteredChangeEvidence(Evidence):
    """Evidence of `unregistered_change`: the conicity has changed at once, and no event on file says why."""

    before_ns: Annotated[int, Served("End of the last data before it.", "last_data_before_at")]
    after_ns: Annotated[int, Served("Begin of the first data behind it.", "first_data_behind_at")]
    before_km: Annotated[float | None, Served("Mileage of the last interval before it.")]
    after_km: Annotated[float | None, Served("Mileage of the first interval behind it.")]
    size: Annotated[Estimate, Served("By how much the conicity has changed.", "size_1")]
    level_before: Annotated[float | None, Served("Conicity before it.", "level_before_1")]
    amplitude_mm: Annotated[float | None, Served("Amplitude that size and level are of.")]
    intervals_before: Annotated[int, Served("Intervals before it.")]
    intervals_behind: Annotated[int, Served("Intervals behind it.")]
    causes: Annotated[tuple[ExplainedBy, ...], Served("What may have happened, the likeliest first.")]
    reason: Annotated[str, Served("The finding as a sentence.")]


@dataclass(frozen=True, slots=True)
class UnregisteredChangeRule(AlertRule):
    """A sudden change of conicity; its alert stands until what happened is registered, or the data withdraw it."""

    kind = UNREGISTERED_CHANGE
    limit_unit = "1"
    evidence = UnregisteredChangeEvidence
    advice = "its conicity has changed at once, and nobody registered why: turned, exchanged, damaged?"
    of_wear = True

    warning_fall: Annotated[float, Interval(ge=0.0, le=2.0)] = 0.1  # below it a fall is an info
    critical_rise: Annotated[float, Interval(ge=0.0, le=2.0)] = 0.2  # from it on a rise is critical

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the newest step of the trend; None where there is none and no alert is open."""
        # an open alert is withdrawn where later data, or what was registered, explain the step
        step = None if facts.current_trend is None else facts.current_trend.trend.step
        if step is None or explained(step, facts):
            own = (alert for alert in facts.open_alerts if alert.kind == self.kind)
            return next((restated(alert, breached=False, cleared=True, stands=False) for alert in own), None)
        return unregistered_change_finding(self, facts.wheelset.serial, step, facts.step_surroundings)


def explained(step: TrendStep, facts: WheelsetFacts) -> bool:
    """Return whether a step is explained: mounted then, sensors exchanged, or another wheelset."""
    doubt, mounting = facts.not_assessable_reason, facts.wheelset.mounting
    if doubt is not None and doubt.code is ReasonCode.IDENTITY_DOUBTFUL:
        return True
    if mounting is not None and mounting.from_ns > step.before_ns:
        return True
    return at_the_time(facts.sensors_changed_ns, step.before_ns, step.after_ns)


def at_the_time(registered_ns: int | None, before_ns: int, after_ns: int) -> bool:
    """Return whether what was registered for a time happened within a change, to the day; all in ns UTC."""
    return registered_ns is not None and before_ns - DAY_NS <= registered_ns <= after_ns + DAY_NS


def unregistered_change_finding(
    rule: UnregisteredChangeRule, wheelset: str, step: TrendStep, around: StepSurroundings
) -> Finding:
    """Return the finding of a step."""
    size, causes = step.size.value or 0.0, explanations(step, around)
    severe = Severity.CRITICAL if size >= rule.critical_rise else Severity.WARNING
    details = UnregisteredChangeEvidence(
        before_ns=step.before_ns,
        after_ns=step.after_ns,
        before_km=number_evidence(step.before_km, 8),
        after_km=number_evidence(step.after_km, 8),
        size=step.size,
        level_before=number_evidence(step.level_before),
        amplitude_mm=number_evidence(1e3 * step.amplitude),
        intervals_before=step.before,
        intervals_behind=step.behind,
        causes=tuple(
            ExplainedBy(cause=cause.cause, share=number_evidence(cause.share, 2), left=number_evidence(cause.left, 2))
            for cause in causes
        ),
        reason=_sentence(step, size, causes),
    )
    return Finding(
        wheelset=wheelset,
        kind=UnregisteredChangeRule.kind,
        breached=True,
        cleared=False,
        severity=Severity.INFO if -rule.warning_fall < size < 0.0 else severe,
        probability=number_evidence(step.probability, 3),
        evidence=details.stored(),
        action="measure_wheel_profiles" if size > 0.0 else "register_event",
        measured_ns=step.found_ns,
        stands=True,
        since_ns=step.found_ns,
    )


def _sentence(step: TrendStep, size: float, causes: tuple[StepExplanation, ...]) -> str:
    which = " or ".join(_WORDS[cause.cause] for cause in causes if cause.share >= FINDINGS.named_probability)
    changed = f"the conicity has {'risen' if size > 0.0 else 'fallen'} by {abs(size):.2f} at {step.after_km:,.0f} km"
    look = "look at the wheels, and register what happened" if size > 0.0 else "register what happened"
    return f"{changed}, which no event on file explains: {which}; {look}"


USUAL = {
    StepCause.TURNED: FINDINGS.turned_prior,
    StepCause.EXCHANGED: FINDINGS.exchanged_prior,
    StepCause.DAMAGED: FINDINGS.damaged_prior,
    StepCause.SENSOR: FINDINGS.sensor_prior,
    StepCause.TURNED_END_FOR_END: FINDINGS.end_for_end_prior,
}


def explanations(step: TrendStep, around: StepSurroundings) -> tuple[StepExplanation, ...]:
    """Return the causes, the likeliest first."""
    # A cause predicts the conicity behind the step: turned wheels have that of their design, a wheelset that was turned
    # end for end keeps its own, a sensor of another scale changes all wheelsets of its node by one factor, damage only
    # raises it, and another wheelset may have any. Causes are weighed by the density of what was found under each, and
    # by how often each happens.
    size, std = step.size.value or 0.0, step.size.std or 1.0
    predicted = {
        StepCause.TURNED: _turned(step, std, around),
        StepCause.EXCHANGED: (1.0 / (FINDINGS.usual_conicities[1] - FINDINGS.usual_conicities[0]), 0.0),
        StepCause.DAMAGED: (float(np.exp(-size / FINDINGS.damage_rise)) / FINDINGS.damage_rise, 0.0)
        if size > 0.0
        else (0.0, -size / std),
        StepCause.SENSOR: _sensor(step, around.others),
        StepCause.TURNED_END_FOR_END: _normal(size, float(np.hypot(std, FINDINGS.own_std))),
    }
    least = FINDINGS.least_likelihood
    weight = {cause: USUAL[cause] * max(density, least) for cause, (density, _) in predicted.items()}
    total = sum(weight.values())
    ordered = sorted(predicted, key=lambda cause: -weight[cause])
    return tuple(StepExplanation(cause, weight[cause] / total, predicted[cause][1]) for cause in ordered)


def _turned(step: TrendStep, std: float, around: StepSurroundings) -> tuple[float, float]:
    """Return density and what is left where the wheels have been turned to their design."""
    after = step.level_before + (step.size.value or 0.0)
    if not around.designed:
        falls = after < step.level_before
        return (
            (1.0 / max(step.level_before, FINDINGS.own_std), 0.0) if falls else (0.0, abs(step.size.value or 0.0) / std)
        )
    nearest = min(around.designed, key=lambda amplitude: abs(amplitude - step.amplitude))
    density, left = _normal(after - around.designed[nearest], float(np.hypot(std, FINDINGS.design_std)))
    apart = [
        (conicity.value - around.designed[amplitude]) / FINDINGS.design_std
        for conicity in around.behind
        for amplitude in around.designed
        if abs(amplitude - conicity.amplitude) < FINDINGS.amplitude_tolerance
    ]
    shape = float(np.sqrt(np.mean(np.square(apart)))) if apart else left
    worse = max(left, shape)
    return density * float(np.exp(-0.5 * (worse**2 - left**2))), worse


def _sensor(step: TrendStep, others: Sequence[TrendStep | None]) -> tuple[float, float]:
    """Return density and what is left where a sensor has another scale: wheelsets of one node change by one factor."""
    after = max(step.level_before + (step.size.value or 0.0), FINDINGS.own_std)
    scale = _log_scale(step)
    together = [other for other in others if other is not None and _together(step, other)]
    density, left = _normal(scale, FINDINGS.sensor_scale_std)
    if not together:
        alone = FINDINGS.lone_sensor_share if others else 1.0
        return alone * density / after, 0.0
    own_std = np.hypot(_log_std(step), FINDINGS.node_scale_std)
    same = [abs(_log_scale(other) - scale) / float(np.hypot(_log_std(other), own_std)) for other in together]
    left = float(np.sqrt(np.mean(np.square(same))))
    sharper = FINDINGS.sensor_scale_std / FINDINGS.node_scale_std  # one factor for all is a sharp prediction
    return sharper * len(together) / len(others) * density * float(np.exp(-0.5 * left**2)) / after, left


def _together(first: TrendStep, second: TrendStep) -> bool:
    most_ns = FINDINGS.simultaneous_ns
    return first.before_ns - most_ns <= second.after_ns and second.before_ns <= first.after_ns + most_ns


def _log_scale(step: TrendStep) -> float:
    after = max(step.level_before + (step.size.value or 0.0), FINDINGS.own_std)
    return float(np.log(after / max(step.level_before, FINDINGS.own_std)))


def _log_std(step: TrendStep) -> float:
    return (step.size.std or 1.0) / max(step.level_before + (step.size.value or 0.0), FINDINGS.own_std)


def _normal(apart: float, std: float) -> tuple[float, float]:
    left = abs(apart) / std
    return float(np.exp(-0.5 * left**2) / (std * np.sqrt(2.0 * np.pi))), left


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitForecastEvidence(DecidingEvidence):
    """Evidence of `limit_forecast`: when the trend reaches the limit."""

    quantity: Annotated[str, Served("What the trend is of.", example="equivalent_conicity")]
    slope_per_1000_km: Annotated[Estimate, Served("Slope of the trend.", "slope_1_per_1000_km")]
    fitted: Annotated[Estimate, Served("The fitted trend at its last point.", "fitted_1")]
    probability_over_limit: Annotated[
        float | None, Served("That the limit is exceeded now, as in the worklist.", "probability_over_limit_1")
    ]
    distance_to_limit_km: Annotated[Forecast, Served("Distance left to the limit from the newest mileage.")]
    date_of_limit_ns: Annotated[Forecast, Served("When the limit is reached; to the second.", "date_of_limit")]
    within_km: Annotated[float, Served("Distance from now within which reaching the limit raises the alert.")]
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
        trend = facts.current_trend.trend
        return limit_forecast_finding(
            self,
            facts.wheelset.serial,
            trend,
            limit_now(facts.geometry.geometry, trend, trend.limit, facts.mileage),
            facts.geometry.to_ns,
            not_assessable_reason=facts.not_assessable_reason,
        )


def limit_forecast_finding(
    rule: LimitForecastRule,
    wheelset: str,
    trend: WearTrend,
    now: LimitNow,
    measured_ns: int,
    *,
    not_assessable_reason: Reason | None = None,
) -> Finding:
    """Return the finding on the distance that is left to the limit of the trend, from now."""
    points = len(trend.value)
    reason = not_assessable_reason or (trend.reason if trend.status is not Status.ESTIMATED else trend.not_comparable)
    reason = reason or trend.few_behind
    if reason is None and points < rule.minimum_points:
        reason = Reason(ReasonCode.TOO_FEW_POINTS, f"{points} points, {rule.minimum_points} needed")
    within = None if reason else _reached_within(rule.within_km, trend, now)
    within_clear = None if reason else _reached_within(rule.clear_within_km, trend, now)
    return Finding(
        wheelset=wheelset,
        kind=LimitForecastRule.kind,
        breached=None if within is None else within >= rule.raise_probability,
        cleared=None if within_clear is None else 1.0 - within_clear >= rule.clear_probability,
        severity=SCALE.severity(now.probability_over_limit),
        probability=number_evidence(within, 2),
        evidence=LimitForecastEvidence(
            quantity=trend.quantity,
            slope_per_1000_km=trend.slope_per_1000_km,
            fitted=trend.fitted,
            probability_over_limit=number_evidence(now.probability_over_limit, 3),
            distance_to_limit_km=now.distance_to_limit_km,
            date_of_limit_ns=now.date_of_limit_ns,
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


def _reached_within(distance_km: float, trend: WearTrend, now: LimitNow) -> float | None:
    """Return the probability that the limit is reached within a distance from now; None where not known."""
    within = probability_within(trend, now.since_trend_km or 0.0, distance_km)
    return None if within is None else max(within, now.probability_over_limit or 0.0)
