"""Rule: the yaw stiffness of a vehicle has changed, as its passes show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

from annotated_types import Interval
from scipy.special import ndtr

from estimation.alerts.rules.evidence import Evidence, number_evidence
from estimation.alerts.rules.rule import AlertRule, Probability, WheelsetFacts
from estimation.trend.suspension import SuspensionParameters
from estimation.values.alerts import Alert, Finding, Severity
from estimation.values.fields import Served
from estimation.values.quantities import Estimate, with_interval
from estimation.values.trend import SuspensionChange

Change = Annotated[float, Interval(ge=0.01, le=10.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class SuspensionChangeEvidence(Evidence):
    """Evidence of `suspension_change`: yaw stiffness over creep coefficient of a vehicle has changed."""

    vehicle: Annotated[str, Served("Code of the vehicle.")]
    change: Annotated[Estimate, Served("Relative change; -0.3 is softer by 30 %.", "change_1")]
    past_findings: Annotated[int, Served("Findings of its own past.")]
    step_probability: Annotated[
        float | None, Served("That it changed at once; null where it did not seem to.", "step_probability_1")
    ]
    step_ns: Annotated[int | None, Served("First finding behind the step.")]
    recent_findings: Annotated[int, Served("Findings that count as now.")]
    other_vehicles: Annotated[int, Served("Vehicles on the same sections at the same time.")]
    limit: Annotated[float, Served("Change that raises the alert.", "limit_1")]


@dataclass(frozen=True, slots=True)
class SuspensionChangeRule(AlertRule):
    """The ratio of yaw stiffness to creep coefficient of a vehicle has changed by more than friction explains.

    The alert is one of the vehicle; it stands at the wheelset of its first axle.
    """

    kind: ClassVar[str] = "suspension_change"
    limit_unit: ClassVar[str] = "1"
    evidence: ClassVar[type[Evidence] | None] = SuspensionChangeEvidence
    advice: ClassVar[str] = "the yaw suspension of its vehicle has changed: check it"
    relations: ClassVar[Sequence[tuple[str, str, str]]] = (
        ("clear_change", "<=", "raise_change"),
        ("raise_step", "<=", "raise_change"),
    )

    raise_change: Change = 0.2
    clear_change: Change = 0.15
    raise_step: Change = 0.1  # of a sudden change
    raise_probability: Probability = 0.9
    clear_probability: Probability = 0.8
    parameters: SuspensionParameters = field(default_factory=SuspensionParameters)

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the vehicle; None at its other wheelsets, or where nothing is known nor open."""
        shown = facts.suspension
        if shown is None:
            return None
        if shown.newest is None:
            return next((self._withdrawn(alert) for alert in facts.open_alerts if alert.kind == self.kind), None)
        found = suspension_change_finding(self, facts.wheelset.serial, shown.newest)
        return replace(found, stands=shown.stands, since_ns=shown.since_ns)

    def _withdrawn(self, alert: Alert) -> Finding:
        """Return that too little is known for an open alert: what it was raised on has been corrected since."""
        return Finding(
            wheelset=alert.wheelset or "",
            kind=self.kind,
            breached=None,
            cleared=None,
            severity=alert.severity,
            probability=None,
            evidence={name: value for name, value in alert.evidence.items() if name != "delays"},
            action=alert.action,
            raise_limit=alert.raise_limit,
            clear_limit=alert.clear_limit,
            measured_ns=alert.last_seen_ns,
            stands=False,
        )


def suspension_change_finding(rule: SuspensionChangeRule, wheelset: str, found: SuspensionChange) -> Finding:
    """Return the finding of a change.

    Args:
        wheelset: Serial of the wheelset that the alert stands at.
    """
    over = _beyond(found, rule.raise_change)
    over_clear = _beyond(found, rule.clear_change)
    sudden = found.step_probability is not None and _beyond(found, rule.raise_step) >= rule.raise_probability
    breached = sudden or over >= rule.raise_probability
    return Finding(
        wheelset=wheelset,
        kind=SuspensionChangeRule.kind,
        breached=breached,
        cleared=not breached and 1.0 - over_clear >= rule.clear_probability,
        severity=Severity.WARNING,
        probability=number_evidence(over, 3),
        evidence=SuspensionChangeEvidence(
            vehicle=found.vehicle,
            change=with_interval(found.change, found.std, count=float(found.recent)),
            past_findings=found.past,
            recent_findings=found.recent,
            other_vehicles=found.others,
            step_probability=number_evidence(found.step_probability, 3),
            step_ns=found.since_ns,
            limit=rule.raise_change,
        ).stored(),
        action="check_yaw_suspension",
        raise_limit=rule.raise_change,
        clear_limit=rule.clear_change,
        measured_ns=found.recent_ns,
    )


def _beyond(found: SuspensionChange, limit: float) -> float:
    """Return the probability that the size of the true change is above the limit."""
    return float(ndtr((found.change - limit) / found.std) + ndtr((-found.change - limit) / found.std))
