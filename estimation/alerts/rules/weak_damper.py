"""Rule: the lateral damper of a running gear has lost most of its damping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Interval
from scipy.special import ndtr

from estimation.alerts.rules.evidence import (
    DecidingEvidence,
    Evidence,
    number_evidence,
)
from estimation.alerts.rules.rule import AlertRule, Probability, WheelsetFacts, WindowCount, too_few_windows
from estimation.values.alerts import Finding, Severity
from estimation.values.fields import Served
from estimation.values.opinions import GearDamper
from estimation.values.quantities import NORMAL_95, Estimate

DampingShare = Annotated[float, Interval(ge=0.05, le=1.5)]


@dataclass(frozen=True, slots=True, kw_only=True)
class WeakDamperEvidence(DecidingEvidence):
    """Evidence of `weak_damper`: the lateral damper of a running gear has lost most of its damping."""

    vehicle: Annotated[str, Served("Code of the vehicle.")]
    first_axle: Annotated[int, Served("First axle of the running gear, from 1.")]
    share: Annotated[Estimate, Served("Damping over that of the vehicle class on file.", "damping_share_1")]
    windows: Annotated[int, Served("Windows that show it.")]
    from_ns: Annotated[int, Served("Start of the first of them.", "measured_from")]
    to_ns: Annotated[int, Served("Start of the last of them.", "measured_to")]
    limit: Annotated[float, Served("Share below which the alert is raised.", "limit_1")]


@dataclass(frozen=True, slots=True)
class WeakDamperRule(AlertRule):
    """Less of the damping on file is left than a limit; the alert stands at the wheelset of the gear's first axle.

    What the windows of months say is pooled, so that there is one finding, which grows surer; runs of the job with
    newer data count towards the delays.
    """

    kind: ClassVar[str] = "weak_damper"
    limit_unit: ClassVar[str] = "1"
    evidence: ClassVar[type[Evidence] | None] = WeakDamperEvidence
    advice: ClassVar[str] = "a lateral damper has lost its damping: check it"
    relations: ClassVar[Sequence[tuple[str, str, str]]] = (("clear_share", ">=", "raise_share"),)

    raise_share: DampingShare = 0.5
    clear_share: DampingShare = 0.6
    raise_probability: Probability = 0.9
    clear_probability: Probability = 0.8
    minimum_windows: WindowCount = 6

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the running gear that begins at the wheelset; None at others, or before its mounting.

        What was measured before the wheelset was mounted has raised what it has to raise at the one before.
        """
        found, mounting = facts.damper, facts.wheelset.mounting
        if found is None or mounting is None or found.to_ns < mounting.from_ns:
            return None
        return weak_damper_finding(self, facts.wheelset.serial, found)


def weak_damper_finding(rule: WeakDamperRule, wheelset: str, found: GearDamper) -> Finding:
    """Return the finding of a damper.

    Args:
        wheelset: Serial of the wheelset that the alert stands at.
    """
    few = too_few_windows(found.windows, rule.minimum_windows)
    weak, not_whole = _below(found, rule.raise_share), _below(found, rule.clear_share)
    known = few is None and weak is not None and not_whole is not None
    because = None if known else (found.share.reason or few)
    return Finding(
        wheelset=wheelset,
        kind=WeakDamperRule.kind,
        breached=weak >= rule.raise_probability if known and weak is not None else None,
        cleared=1.0 - not_whole >= rule.clear_probability if known and not_whole is not None else None,
        severity=Severity.WARNING,
        probability=number_evidence(weak, 3),
        evidence=WeakDamperEvidence(
            vehicle=found.vehicle,
            first_axle=found.first_axle,
            share=found.share,
            windows=found.windows,
            from_ns=found.from_ns,
            to_ns=found.to_ns,
            limit=rule.raise_share,
            unknown=because,
        ).stored(),
        action="check_lateral_damper",
        raise_limit=rule.raise_share,
        clear_limit=rule.clear_share,
        measured_ns=found.to_ns,
    )


def _below(found: GearDamper, limit: float) -> float | None:
    """Return the probability that less than a share is left; None where the share is not known.

    The std follows from the upper end of the interval, because the lower end is cut off at 0.
    """
    value, high = found.share.value, found.share.high
    if value is None or high is None or not high > value:
        return None
    return float(ndtr((limit - value) * NORMAL_95 / (high - value)))
