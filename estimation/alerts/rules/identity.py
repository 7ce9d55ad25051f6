"""Rule: the wheelset that runs is not the one on file, or not the way round that is on file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, ClassVar

from estimation.alerts.identity import IdentityEvent, IdentityParameters, Mistake
from estimation.alerts.rules.evidence import Evidence, number_evidence
from estimation.alerts.rules.rule import AlertRule, WheelsetFacts
from estimation.values.alerts import Alert, Finding, Severity
from estimation.values.fields import Served
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting
from estimation.values.trend import IDENTITY

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

    kind: ClassVar[str] = IDENTITY
    limit_unit: ClassVar[str] = "1"
    evidence: ClassVar[type[Evidence] | None] = IdentityEvidence
    hides_wear: ClassVar[Reason | None] = Reason(
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
    """Return the finding on a wheelset's identity; None where the geometries agree with it.

    Args:
        event: What has been found since the last identity change; None where nothing.
        standing: The open alert: it stands until its mounting is corrected on file.
    """
    if event is None:
        return None if standing is None else _unchanged(standing)
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
        severity=Severity.WARNING,
        probability=None,
        evidence=details.stored(),
        action="check_mounting",
        raise_limit=None,
        clear_limit=None,
        measured_ns=event.measured_ns,
    )


def _unchanged(alert: Alert) -> Finding:
    return Finding(
        wheelset=alert.wheelset or "",
        kind=IDENTITY,
        breached=True,
        cleared=False,
        severity=alert.severity,
        probability=None,
        evidence={name: value for name, value in alert.evidence.items() if name != "delays"},
        action=alert.action,
        raise_limit=None,
        clear_limit=None,
        measured_ns=alert.last_seen_ns,
    )


def mounting_corrected(alert: Alert, mounting: Mounting) -> bool:
    """Whether the mounting on file is another than the alert was raised on."""
    mounted = alert.evidence.get(MOUNTED)
    if alert.kind != IDENTITY or not isinstance(mounted, Mapping):
        return alert.kind == IDENTITY
    return any(mounted.get(field.name) != getattr(mounting, field.name) for field in fields(MountedAs))
