"""Rules on what the registry has wrong: a wheelset that is not the one on file, and a change that nobody registered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated

from annotated_types import Interval

from estimation.alerts.identity import IdentityEvent, IdentityParameters, Mistake
from estimation.alerts.rules.rule import AlertRule, Evidence, WheelsetFacts, number_evidence, restated
from estimation.trend.steps import StepSurroundings, explanations
from estimation.values.alerts import Alert, Finding, Severity
from estimation.values.fields import Served
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting
from estimation.values.trend import IDENTITY, UNREGISTERED_CHANGE, StepCause, StepExplanation, TrendStep

MOUNTED = "mounted"
_EXPLANATIONS = {
    Mistake.REVERSED: "the geometry has become its own mirror image: it runs the other way round than on file",
    Mistake.SWAPPED: "the geometry has become that of another wheelset, and the other's has become this one's",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class MountedAs:
    """How a wheelset is mounted on file."""

    vehicle: Annotated[str, Served("Code of the vehicle.")]
    axle: Annotated[int, Served("Number of the axle, from 1.")]
    from_ns: Annotated[int, Served("Since when.", "mounted_from")]
    reversed: Annotated[bool, Served("The left wheel runs on the right-hand side.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentityEvidence(Evidence):
    """Evidence of `identity`: the wheelset that runs is not the one on file, or not the way round."""

    mistake: Annotated[Mistake, Served("The mistake that explains the jump.")]
    partner: Annotated[str | None, Served("The other wheelset of a swap.")]
    before_ns: Annotated[int, Served("End of the last data before it happened.", "last_data_before_at")]
    after_ns: Annotated[int, Served("Begin of the first data after it.", "first_data_after_at")]
    jump: Annotated[float | None, Served("Standard deviations between the geometries before and after.", "jump_1")]
    left: Annotated[float | None, Served("Standard deviations that the explanation leaves.", "left_1")]
    reason: Annotated[str, Served("The explanation, as a sentence.")]
    mounted: Annotated[MountedAs, Served("The mounting that it was raised on.")]


@dataclass(frozen=True, slots=True)
class IdentityRule(AlertRule):
    """A wheelset is not the one on file, or not the way round; its alert stands until its mounting is corrected."""

    kind = IDENTITY
    limit_unit = "1"
    evidence = IdentityEvidence
    hides_wear = Reason(
        ReasonCode.IDENTITY_DOUBTFUL, "the wheelset is not the recorded one, or is mounted the other way round"
    )

    parameters: IdentityParameters = field(default_factory=IdentityParameters)

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return what stands against the wheelset's identity, unless the mounting has been corrected since."""
        mounting = facts.wheelset.mounting
        if mounting is None or not self.enabled:
            return None
        standing = next((alert for alert in facts.open_alerts if alert.kind == self.kind), None)
        if standing is not None and (mounting_corrected(standing, mounting) or mounting.from_ns > standing.opened_ns):
            standing = None
        return identity_finding(facts.identity, mounting, standing)


def identity_finding(event: IdentityEvent | None, mounting: Mounting, standing: Alert | None) -> Finding | None:
    """Return the finding on a wheelset's identity; None where the geometries agree with it."""
    if event is None:
        return None if standing is None else restated(standing, breached=True, cleared=False)
    details = IdentityEvidence(
        mistake=event.mistake,
        partner=event.partner,
        before_ns=event.before_ns,
        after_ns=event.after_ns,
        jump=number_evidence(event.jump, 3),
        left=number_evidence(event.left, 3),
        reason=_EXPLANATIONS[event.mistake],
        mounted=MountedAs(
            vehicle=mounting.vehicle, axle=mounting.axle, from_ns=mounting.from_ns, reversed=mounting.reversed
        ),
    )
    return Finding(
        wheelset=event.wheelset,
        kind=IDENTITY,
        breached=True,
        cleared=False,
        evidence=details.stored(),
        action="check_mounting",
        measured_ns=event.measured_ns,
    )


def mounting_corrected(alert: Alert, mounting: Mounting) -> bool:
    """Whether the mounting on file is another than the alert was raised on."""
    mounted = alert.evidence.get(MOUNTED)
    if alert.kind != IDENTITY or not isinstance(mounted, Mapping):
        return alert.kind == IDENTITY
    return any(mounted.get(field.name) != getattr(mounting, field.name) for field in fields(MountedAs))


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

    kind = UNREGISTERED_CHANGE
    limit_unit = "1"
    evidence = UnregisteredChangeEvidence
    advice = "its conicity has changed at once, and nobody registered why: turned, exchanged, damaged?"
    of_wear = True

    warning_fall: Annotated[float, Interval(ge=0.0, le=2.0)] = 0.1  # below it a fall is an info
    critical_rise: Annotated[float, Interval(ge=0.0, le=2.0)] = 0.2  # from it on a rise is critical

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the newest step of the trend; None where there is none and no alert is open.

        An open alert is withdrawn where later data, or what was registered, explain the step.
        """
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
        measured_ns=step.found_ns,
        stands=True,
        since_ns=step.found_ns,
    )


def _sentence(step: TrendStep, size: float, causes: tuple[StepExplanation, ...]) -> str:
    which = " or ".join(_WORDS[one.cause] for one in causes if one.share >= NAMED)
    changed = f"the conicity has {'risen' if size > 0.0 else 'fallen'} by {abs(size):.2f} at {step.after_km:,.0f} km"
    look = "look at the wheels, and register what happened" if size > 0.0 else "register what happened"
    return f"{changed}, which no event on file explains: {which}; {look}"
