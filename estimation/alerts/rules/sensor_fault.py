"""Rule: too many of a wheelset's latest windows come from a faulty sensor."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

from annotated_types import Interval
from scipy.special import betainc

from estimation.alerts.rules.evidence import DecidingEvidence, Evidence, number_evidence
from estimation.alerts.rules.rule import (
    AlertRule,
    Probability,
    Share,
    WheelsetFacts,
    WindowCount,
    measured_until,
    newest_windows,
    too_few_windows,
)
from estimation.alerts.rules.standing import of_windows
from estimation.values.alerts import Finding, Severity
from estimation.values.fields import Served
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import WindowRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorFaultEvidence(DecidingEvidence):
    """Evidence of `sensor_fault`: too many of the latest windows are of a faulty sensor."""

    faulty_windows: Annotated[int, Served("Faulty ones of the latest windows.")]
    windows: Annotated[int, Served("How many windows were looked at.")]
    reasons: Annotated[
        Mapping[str, int],
        Served("Faulty windows by what is wrong: `self_test_or_emergency`, `clipping`, `invalid_values`."),
    ]


@dataclass(frozen=True, slots=True)
class SensorFaultRule(AlertRule):
    """Too many of the latest windows have a sensor that failed, clips or marks its values invalid."""

    kind: ClassVar[str] = "sensor_fault"
    of_sensors: ClassVar[bool] = True
    limit_unit: ClassVar[str] = "1"
    evidence: ClassVar[type[Evidence] | None] = SensorFaultEvidence
    counts_km: ClassVar[bool] = True
    hides_wear: ClassVar[Reason | None] = Reason(ReasonCode.SENSOR_FAULTY, "the sensor is faulty")
    relations: ClassVar[Sequence[tuple[str, str, str]]] = (
        ("clear_share", "<=", "raise_share"),
        ("minimum_windows", "<=", "latest_windows"),
    )

    latest_windows: Annotated[int, Interval(ge=1, le=1000)] = 20
    minimum_windows: WindowCount = 3
    raise_share: Share = 0.5
    clear_share: Share = 0.1
    raise_probability: Probability = 0.8
    clear_probability: Probability = 0.8
    clipped_share: Share = 0.05  # of a window's samples that makes it faulty
    invalid_share: Share = 0.2

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the latest windows of the mounting, since the sensors were last changed."""
        mounting = facts.wheelset.mounting
        if mounting is None:
            return None

        def find(windows: Sequence[WindowRecord]) -> Finding:
            return sensor_fault_finding(self, facts.wheelset.serial, windows, mounting.from_ns, facts.hunted)

        changed_ns = facts.sensors_changed_ns
        if changed_ns is not None:  # what was before is of other sensors
            facts = replace(facts, windows=[one for one in facts.windows if one.start_ns >= changed_ns])

        def suspect(window: WindowRecord) -> bool:
            return bool(faulty(self, window, facts.hunted))

        return of_windows(find, facts, suspect, self.latest_windows, self.delays)


def faulty(rule: SensorFaultRule, window: WindowRecord, hunted: frozenset[int] = frozenset()) -> str:
    """Return what is wrong with the sensor in this window; empty where nothing is.

    A sensor that clips because its wheelset hunts, or another one that shakes its vehicle, is sound; so is one that a
    wheel with a flat strikes.

    Args:
        hunted: Starts of windows in which a wheelset of the vehicle hunts.
    """
    quality = window.quality
    if quality.sensor_fault:
        return "self_test_or_emergency"
    explained = quality.hunting.sustained or quality.blows.sustained or window.start_ns in hunted
    if quality.clipped > rule.clipped_share and not explained:
        return "clipping"
    if quality.invalid > rule.invalid_share:
        return "invalid_values"
    return ""


def sensor_fault_finding(
    rule: SensorFaultRule,
    wheelset: str,
    windows: Sequence[WindowRecord],
    measured_ns: int,
    hunted: frozenset[int] = frozenset(),
) -> Finding:
    """Return the finding of the latest windows on the sensor.

    With k faulty ones of n, the probability that the share of faulty windows exceeds a limit is that of a
    Beta(k + 1, n - k + 1), the posterior of a flat prior.

    Args:
        windows: Windows of the mounting in service, any order; the newest ``rule.latest_windows`` are looked at.
        measured_ns: Used where there is no window.
        hunted: Starts of windows in which a wheelset of the vehicle hunts.
    """
    latest = newest_windows(windows, rule.latest_windows)
    reasons = [r for r in (faulty(rule, w, hunted) for w in latest) if r]
    n, k = len(latest), len(reasons)
    enough = n >= rule.minimum_windows
    over = float(1.0 - betainc(k + 1, n - k + 1, rule.raise_share))
    below_clear = float(betainc(k + 1, n - k + 1, rule.clear_share))
    return Finding(
        wheelset=wheelset,
        kind=SensorFaultRule.kind,
        breached=over >= rule.raise_probability if enough else None,
        cleared=below_clear >= rule.clear_probability if enough else None,
        severity=Severity.WARNING,
        probability=number_evidence(over, 3) if enough else None,
        evidence=SensorFaultEvidence(
            faulty_windows=k, windows=n, reasons=Counter(reasons), unknown=too_few_windows(n, rule.minimum_windows)
        ).stored(),
        action="replace_sensor",
        raise_limit=rule.raise_share,
        clear_limit=rule.clear_share,
        measured_ns=measured_until(latest, measured_ns),
    )
