"""Rule: a wheel strikes once a turn in most of its latest windows: its tread has a flat."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

import numpy as np
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
from estimation.values.registry import WheelsetRecord
from estimation.values.windows import WindowRecord

MOST_APART = 0.1  # relative, of the turn from that of the wheel: worn wheels, and speeds by wheels of another radius
SAME_SIDE = 0.8  # of the windows that show a side


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelFlatEvidence(DecidingEvidence):
    """Evidence of `wheel_flat`: a wheel strikes once a turn in many of the latest windows."""

    striking_windows: Annotated[int, Served("Windows in which it strikes, of the latest.")]
    windows: Annotated[int, Served("How many windows were looked at.")]
    blow_m_s2: Annotated[float | None, Served("Median lateral acceleration; at least that where the sensor clips.")]
    wheel: Annotated[Literal["left", "right"] | None, Served("Of the wheelset itself; null where it is not known.")]
    turn_m: Annotated[float | None, Served("Distance between two blows.")]
    speed_max_m_s: Annotated[float | None, Served("Greatest speed of those windows.")]


@dataclass(frozen=True, slots=True)
class WheelFlatRule(AlertRule):
    """Blows on the axle box once a turn of the wheel, in a share of the latest windows."""

    kind: ClassVar[str] = "wheel_flat"
    limit_unit: ClassVar[str] = "1"
    evidence: ClassVar[type[Evidence] | None] = WheelFlatEvidence
    advice: ClassVar[str] = "a wheel has a flat: inspect the treads, turn the wheelset"
    counts_km: ClassVar[bool] = True
    of_wear: ClassVar[bool] = True
    relations: ClassVar[Sequence[tuple[str, str, str]]] = (
        ("clear_share", "<=", "raise_share"),
        ("minimum_windows", "<=", "latest_windows"),
    )

    latest_windows: Annotated[int, Interval(ge=1, le=1000)] = 20
    minimum_windows: WindowCount = 3
    raise_share: Share = 0.25  # of the windows; blows are weak where a vehicle runs slowly
    clear_share: Share = 0.15
    raise_probability: Probability = 0.9
    clear_probability: Probability = 0.8
    critical_m_s2: float = 35.0  # of the lateral acceleration; the shipped catalogue ends at 41

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the latest windows of the profile in this mounting."""
        wheelset = facts.wheelset
        if wheelset.mounting is None:
            return None
        turned_ns = max((one.at_ns for one in wheelset.reprofilings), default=None)
        if turned_ns is not None:
            facts = replace(facts, windows=[one for one in facts.windows if one.start_ns >= turned_ns])
        turn_m = 2.0 * math.pi * wheelset.nominal_radius_m

        def find(windows: Sequence[WindowRecord]) -> Finding:
            return wheel_flat_finding(self, wheelset, windows, turn_m)

        return of_windows(find, facts, lambda window: strikes(window, turn_m), self.latest_windows, self.delays)


def strikes(window: WindowRecord, turn_m: float) -> bool:
    """Return whether a wheel of this turn strikes for most of a window.

    Args:
        turn_m: Run in a turn of the wheel, m.
    """
    blows = window.quality.blows
    return blows.sustained and abs(blows.turn_m / turn_m - 1.0) <= MOST_APART


def wheel_flat_finding(
    rule: WheelFlatRule, wheelset: WheelsetRecord, windows: Sequence[WindowRecord], turn_m: float
) -> Finding:
    """Return the finding of the latest windows on blows once a turn.

    With k of n windows in which the wheel strikes, the probability that it does in more than a share of them is that
    of a Beta(k + 1, n - k + 1), the posterior of a flat prior.

    Args:
        windows: Of its profile in this mounting, any order; the newest ``rule.latest_windows`` are looked at.
        turn_m: Run in a turn of the wheel, m.
    """
    latest = newest_windows(windows, rule.latest_windows)
    found = [window for window in latest if strikes(window, turn_m)]
    n, k = len(latest), len(found)
    unknown = too_few_windows(n, rule.minimum_windows)
    over, over_clear = (float(1.0 - betainc(k + 1, n - k + 1, share)) for share in (rule.raise_share, rule.clear_share))
    size = float(np.median([window.quality.blows.size for window in found])) if found else None
    mounting = wheelset.mounting
    return Finding(
        wheelset=wheelset.serial,
        kind=WheelFlatRule.kind,
        breached=None if unknown else over >= rule.raise_probability,
        cleared=None if unknown else 1.0 - over_clear >= rule.clear_probability,
        severity=Severity.CRITICAL if size is not None and size >= rule.critical_m_s2 else Severity.WARNING,
        probability=None if unknown else number_evidence(over, 3),
        evidence=WheelFlatEvidence(
            striking_windows=k,
            windows=n,
            blow_m_s2=number_evidence(size, 2),
            wheel=None if mounting is None else _wheel(found, mounted_reversed=mounting.reversed),
            turn_m=number_evidence(float(np.median([w.quality.blows.turn_m for w in found])) if found else None, 3),
            speed_max_m_s=number_evidence(max((w.quality.speed_max_m_s for w in found), default=None), 3),
            unknown=unknown,
        ).stored(),
        action="inspect_wheel_treads",
        raise_limit=rule.raise_share,
        clear_limit=rule.clear_share,
        measured_ns=measured_until(latest, 0 if mounting is None else mounting.from_ns),
    )


def _wheel(found: Sequence[WindowRecord], *, mounted_reversed: bool) -> Literal["left", "right"] | None:
    """Return which of the wheelset's own wheels strikes, ``left`` or ``right``; None where the windows do not say."""
    sides = [window.quality.blows.side for window in found if window.quality.blows.side]
    if not sides or abs(sum(sides)) < SAME_SIDE * len(sides) or 2 * len(sides) < len(found):
        return None
    on_left = sum(sides) > 0
    return "left" if on_left != mounted_reversed else "right"
