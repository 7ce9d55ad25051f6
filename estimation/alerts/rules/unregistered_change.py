"""Rule: the conicity of a wheelset has changed at once, and nothing on file says why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Interval

from estimation.alerts.rules.evidence import Evidence, number_evidence
from estimation.alerts.rules.rule import AlertRule, WheelsetFacts
from estimation.alerts.step_causes import StepSurroundings, explanations
from estimation.values.alerts import Alert, Finding, Severity
from estimation.values.fields import Served
from estimation.values.quantities import Estimate
from estimation.values.reasons import ReasonCode
from estimation.values.trend import UNREGISTERED_CHANGE, StepCause, StepExplanation, TrendStep

DAY_NS = 86_400 * 10**9
_WORDS = {
    StepCause.TURNED: "turned",
    StepCause.EXCHANGED: "exchanged",
    StepCause.TURNED_END_FOR_END: "turned end for end",
    StepCause.DAMAGED: "damaged",
    StepCause.SENSOR: "another scale of its sensor",
}
NAMED = 0.1  # share of a cause that the sentence names


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

    kind: ClassVar[str] = UNREGISTERED_CHANGE
    limit_unit: ClassVar[str] = "1"
    evidence: ClassVar[type[Evidence] | None] = UnregisteredChangeEvidence
    advice: ClassVar[str] = "its conicity has changed at once, and nobody registered why: turned, exchanged, damaged?"
    of_wear: ClassVar[bool] = True

    warning_fall: Annotated[float, Interval(ge=0.0, le=2.0)] = 0.1  # below it a fall is an info
    critical_rise: Annotated[float, Interval(ge=0.0, le=2.0)] = 0.2  # from it on a rise is critical

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the newest step of the trend; None where there is none and no alert is open."""
        step = None if facts.current_trend is None else facts.current_trend.trend.step
        if step is None or explained(step, facts):
            return next((_withdrawn(alert) for alert in facts.open_alerts if alert.kind == self.kind), None)
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
    """Return whether what was registered for a time happened within a change, to the day.

    Args:
        registered_ns: ns UTC; None where nothing was.
        before_ns, after_ns: End of the data before the change, begin of those behind it.
    """
    return registered_ns is not None and before_ns - DAY_NS <= registered_ns <= after_ns + DAY_NS


def unregistered_change_finding(
    rule: UnregisteredChangeRule, wheelset: str, step: TrendStep, around: StepSurroundings
) -> Finding:
    """Return the finding of a step.

    Args:
        around: What else is known about its time.
    """
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
            ExplainedBy(cause=one.cause, share=number_evidence(one.share, 2), left=number_evidence(one.left, 2))
            for one in causes
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
        raise_limit=None,
        clear_limit=None,
        measured_ns=step.found_ns,
        stands=True,
        since_ns=step.found_ns,
    )


def _sentence(step: TrendStep, size: float, causes: tuple[StepExplanation, ...]) -> str:
    which = " or ".join(_WORDS[one.cause] for one in causes if one.share >= NAMED)
    changed = f"the conicity has {'risen' if size > 0.0 else 'fallen'} by {abs(size):.2f} at {step.after_km:,.0f} km"
    look = "look at the wheels, and register what happened" if size > 0.0 else "register what happened"
    return f"{changed}, which no event on file explains: {which}; {look}"


def _withdrawn(alert: Alert) -> Finding:
    """Return that an open alert stands no longer: later data, or what was registered, explain the step."""
    return Finding(
        wheelset=alert.wheelset or "",
        kind=alert.kind,
        breached=False,
        cleared=True,
        severity=alert.severity,
        probability=None,
        evidence={name: value for name, value in alert.evidence.items() if name != "delays"},
        action=alert.action,
        raise_limit=None,
        clear_limit=None,
        measured_ns=alert.last_seen_ns,
        stands=False,
    )
