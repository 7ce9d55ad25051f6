"""Rule: a wheelset that hunts in several of its latest windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Interval

from estimation.alerts.rules.evidence import DecidingEvidence, Evidence, number_evidence
from estimation.alerts.rules.rule import (
    AlertRule,
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
from estimation.values.reasons import Reason
from estimation.values.windows import HUNTING_SHARE, WindowRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class HuntingEvidence(DecidingEvidence):
    """Evidence of `hunting`: several of the latest windows show it."""

    hunting_windows: Annotated[int, Served("Windows of hunting among the latest.")]
    windows: Annotated[int, Served("How many windows were looked at.")]
    frequency_hz: Annotated[float | None, Served("Median frequency.")] = None
    wavelength_m: Annotated[float | None, Served("Median wavelength.")] = None
    amplitude_mm: Annotated[float | None, Served("Largest lateral amplitude.")] = None
    speed_max_m_s: Annotated[float | None, Served("Greatest speed of those windows.")] = None


@dataclass(frozen=True, slots=True)
class HuntingRule(AlertRule):
    """The wheelset sways at its own wavelength, sustained, in several of the latest windows."""

    kind: ClassVar[str] = "hunting"
    limit_unit: ClassVar[str] = "windows"
    evidence: ClassVar[type[Evidence] | None] = HuntingEvidence
    advice: ClassVar[str] = "it hunts: check yaw dampers and wheel profiles"
    counts_km: ClassVar[bool] = True
    relations: ClassVar[Sequence[tuple[str, str, str]]] = (
        ("raise_windows", "<=", "latest_windows"),
        ("critical_windows", "<=", "latest_windows"),
        ("critical_windows", ">=", "raise_windows"),
        ("minimum_windows", "<=", "latest_windows"),
    )

    latest_windows: Annotated[int, Interval(ge=1, le=1000)] = 20
    raise_windows: WindowCount = 3
    critical_windows: WindowCount = 10
    minimum_windows: WindowCount = 3  # behind "it does not hunt"
    hunting_share: Share = HUNTING_SHARE  # of a window's running time that makes it a window of hunting

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the latest windows of the mounting."""
        mounting = facts.wheelset.mounting
        if mounting is None:
            return None

        def find(windows: Sequence[WindowRecord]) -> Finding:
            return hunting_finding(self, facts.wheelset.serial, windows, mounting.from_ns)

        return of_windows(
            find, facts, lambda window: hunts(window, self.hunting_share), self.latest_windows, self.delays
        )


def hunts(window: WindowRecord, share: float) -> bool:
    """Return whether a window shows hunting for a share of its running time.

    Args:
        share: From 0 to 1; of 0 some hunting is needed still.
    """
    return window.quality.hunting.share >= share and window.quality.hunting.share > 0.0


def hunting_finding(rule: HuntingRule, wheelset: str, windows: Sequence[WindowRecord], measured_ns: int) -> Finding:
    """Return the finding of the latest windows on hunting.

    Args:
        windows: Windows of the mounting in service, any order; the newest ``rule.latest_windows`` are looked at.
        measured_ns: Used where there is no window.
    """
    latest = newest_windows(windows, rule.latest_windows)
    found = [w for w in latest if hunts(w, rule.hunting_share)]
    unknown = None if found else too_few_windows(len(latest), rule.minimum_windows)
    return Finding(
        wheelset=wheelset,
        kind=HuntingRule.kind,
        breached=None if unknown else len(found) >= rule.raise_windows,
        cleared=None if unknown else not found,
        severity=Severity.CRITICAL if len(found) >= rule.critical_windows else Severity.WARNING,
        probability=None,
        evidence=_evidence(found, len(latest), unknown).stored(),
        action="check_yaw_dampers_and_profiles",
        raise_limit=float(rule.raise_windows),
        clear_limit=0.0,
        measured_ns=measured_until(latest, measured_ns),
    )


def _evidence(found: Sequence[WindowRecord], windows: int, unknown: Reason | None) -> HuntingEvidence:
    if not found:
        return HuntingEvidence(hunting_windows=0, windows=windows, unknown=unknown)
    frequency = float(np.median([w.quality.hunting.frequency_hz for w in found]))
    speed = [0.5 * (w.quality.speed_min_m_s + w.quality.speed_max_m_s) for w in found]
    lengths = [v / w.quality.hunting.frequency_hz for v, w in zip(speed, found, strict=True)]
    return HuntingEvidence(
        hunting_windows=len(found),
        windows=windows,
        frequency_hz=number_evidence(frequency, 3),
        wavelength_m=number_evidence(float(np.median(lengths)), 2),
        amplitude_mm=number_evidence(max(1e3 * w.quality.hunting.amplitude for w in found), 2),
        speed_max_m_s=number_evidence(max(w.quality.speed_max_m_s for w in found), 3),
        unknown=unknown,
    )
