"""Rule: the newest windows of a wheelset have a mileage that cannot be believed, or recordings were rejected."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

from annotated_types import Interval

from estimation.alerts.rules.evidence import DecidingEvidence, Evidence, unknown_evidence
from estimation.alerts.rules.rule import (
    AlertRule,
    WheelsetFacts,
    WindowCount,
    measured_until,
    newest_windows,
    too_few_windows,
)
from estimation.alerts.rules.standing import of_windows
from estimation.values.alerts import Finding, Severity
from estimation.values.fields import JsonValue, Served
from estimation.values.reasons import ReasonCode
from estimation.values.windows import WindowRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class DataQualityEvidence(DecidingEvidence):
    """Evidence of `data_quality`: the data contradict themselves or the registry."""

    implausible_windows: Annotated[int, Served("Implausible ones of the latest windows.")]
    windows: Annotated[int, Served("How many windows were looked at.")]
    reasons: Annotated[Mapping[str, int], Served("Implausible windows by reason code.")]
    rejected_recordings: Annotated[int | None, Served("Rejected recordings of the vehicle.")] = 0
    rejected_reasons: Annotated[Mapping[str, int], Served("Rejected recordings by reason code.")] = field(
        default_factory=dict
    )


@dataclass(frozen=True, slots=True)
class DataQualityRule(AlertRule):
    """What the vehicle sent contradicts itself or the registry: several of the newest windows, or a whole recording."""

    kind: ClassVar[str] = "data_quality"
    limit_unit: ClassVar[str] = "windows"
    evidence: ClassVar[type[Evidence] | None] = DataQualityEvidence
    advice: ClassVar[str] = "its mileage or recordings cannot be believed: check odometer and recordings"
    counts_km: ClassVar[bool] = True
    relations: ClassVar[Sequence[tuple[str, str, str]]] = (
        ("raise_windows", "<=", "latest_windows"),
        ("minimum_windows", "<=", "latest_windows"),
    )

    latest_windows: Annotated[int, Interval(ge=1, le=1000)] = 10
    raise_windows: WindowCount = 2
    minimum_windows: WindowCount = 3  # behind "the data are good again"

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the newest windows of the mounting."""
        mounting = facts.wheelset.mounting
        if mounting is None:
            return None

        def find(windows: Sequence[WindowRecord]) -> Finding:
            return data_quality_finding(self, facts.wheelset.serial, windows, mounting.from_ns)

        found = of_windows(find, facts, lambda window: window.implausible is not None, self.latest_windows, self.delays)
        return _with_rejected(found, facts.rejected_recordings)


def data_quality_finding(
    rule: DataQualityRule,
    wheelset: str,
    windows: Sequence[WindowRecord],
    measured_ns: int,
) -> Finding:
    """Return the finding of the newest windows on what is implausible.

    Args:
        windows: Windows of the mounting in service, any order; the newest ``rule.latest_windows`` are looked at.
        measured_ns: Used where there is no window.
    """
    latest = newest_windows(windows, rule.latest_windows)
    reasons = Counter(window.implausible.code.value for window in latest if window.implausible is not None)
    found = reasons.total()
    unknown = None if found else too_few_windows(len(latest), rule.minimum_windows)
    return Finding(
        wheelset=wheelset,
        kind=DataQualityRule.kind,
        breached=None if unknown else found >= rule.raise_windows,
        cleared=None if unknown else not found,
        severity=Severity.WARNING,
        probability=None,
        evidence=DataQualityEvidence(
            implausible_windows=found, windows=len(latest), reasons=reasons, unknown=unknown
        ).stored(),
        action="check_section_number" if set(reasons) == {ReasonCode.PLACE_IMPLAUSIBLE.value} else "check_odometer",
        raise_limit=float(rule.raise_windows),
        clear_limit=0.0,
        measured_ns=measured_until(latest, measured_ns),
    )


def _with_rejected(found: Finding, rejected: Mapping[str, int]) -> Finding:
    """Return the finding with the rejected recordings of the vehicle, by reason code.

    One stands for an alert until it is decoded or set aside.
    """
    if not rejected:
        return found
    evidence: dict[str, JsonValue] = {
        **found.evidence,
        "rejected_recordings": sum(rejected.values()),
        "rejected_reasons": {code: rejected[code] for code in sorted(rejected)},
        **unknown_evidence(None),
    }
    return replace(found, breached=True, cleared=False, evidence=evidence, action="check_recordings", stands=True)
