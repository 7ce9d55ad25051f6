"""Rules on the running gear: yaw suspension, lateral dampers, wheelsets that hunt, rails with low adhesion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from annotated_types import Interval
from scipy.special import ndtr

from estimation.alerts.rules.rule import (
    AlertRule,
    Probability,
    Share,
    WheelsetFacts,
    WindowCount,
    WindowsRule,
    measured_until,
    too_few_windows,
)
from estimation.trend.suspension import SuspensionParameters
from estimation.values.alerts import DecidingEvidence, Evidence, Finding, Severity, number_evidence, restated
from estimation.values.fields import Served
from estimation.values.opinions import GearDamper, SectionAdhesion
from estimation.values.quantities import Estimate, with_interval
from estimation.values.reasons import Reason
from estimation.values.trend import SuspensionChange
from estimation.values.units import KM_H_IN_M_S, NORMAL_95
from estimation.values.windows import SUSTAINED, WindowRecord

Change = Annotated[float, Interval(ge=0.01, le=10.0)]
DampingShare = Annotated[float, Interval(ge=0.05, le=1.5)]


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

    kind = "suspension_change"
    limit_unit = "1"
    evidence = SuspensionChangeEvidence
    advice = "the yaw suspension of its vehicle has changed: check it"
    relations = (("clear_change", "<=", "raise_change"), ("raise_step", "<=", "raise_change"))

    raise_change: Change = 0.2
    clear_change: Change = 0.15
    raise_step: Change = 0.1  # of a sudden change
    raise_probability: Probability = 0.9
    clear_probability: Probability = 0.8
    parameters: SuspensionParameters = field(default_factory=SuspensionParameters)

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the vehicle; None at its other wheelsets, or where nothing is known nor open."""
        # without a newest change an open alert is withdrawn: the data that raised it have been corrected since
        shown = facts.suspension
        if shown is None:
            return None
        if shown.newest is None:
            of_kind = (alert for alert in facts.open_alerts if alert.kind == self.kind)
            return next((restated(alert, breached=None, cleared=None, stands=False) for alert in of_kind), None)
        finding = suspension_change_finding(self, facts.wheelset.serial, shown.newest)
        return replace(finding, stands=shown.stands, since_ns=shown.since_ns)


def suspension_change_finding(rule: SuspensionChangeRule, wheelset: str, change: SuspensionChange) -> Finding:
    """Return the finding of a change; the alert stands at the wheelset."""
    over = _beyond(change, rule.raise_change)
    over_clear = _beyond(change, rule.clear_change)
    sudden = change.step_probability is not None and _beyond(change, rule.raise_step) >= rule.raise_probability
    breached = sudden or over >= rule.raise_probability
    return Finding(
        wheelset=wheelset,
        kind=SuspensionChangeRule.kind,
        breached=breached,
        cleared=not breached and 1.0 - over_clear >= rule.clear_probability,
        probability=number_evidence(over, 3),
        evidence=SuspensionChangeEvidence(
            vehicle=change.vehicle,
            change=with_interval(change.change, change.std, count=float(change.recent)),
            past_findings=change.past,
            recent_findings=change.recent,
            other_vehicles=change.others,
            step_probability=number_evidence(change.step_probability, 3),
            step_ns=change.since_ns,
            limit=rule.raise_change,
        ).stored(),
        action="check_yaw_suspension",
        raise_limit=rule.raise_change,
        clear_limit=rule.clear_change,
        measured_ns=change.recent_ns,
    )


def _beyond(change: SuspensionChange, limit: float) -> float:
    return float(ndtr((change.change - limit) / change.std) + ndtr((-change.change - limit) / change.std))


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

    kind = "weak_damper"
    limit_unit = "1"
    evidence = WeakDamperEvidence
    advice = "a lateral damper has lost its damping: check it"
    relations = (("clear_share", ">=", "raise_share"),)

    raise_share: DampingShare = 0.5
    clear_share: DampingShare = 0.6
    raise_probability: Probability = 0.9
    clear_probability: Probability = 0.8
    minimum_windows: WindowCount = 6

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the running gear that begins at the wheelset; None at others, or before its mounting.

        Data from before the mounting have raised their alerts at the wheelset before it.
        """
        damper, mounting = facts.damper, facts.wheelset.mounting
        if damper is None or mounting is None or damper.to_ns < mounting.from_ns:
            return None
        return weak_damper_finding(self, facts.wheelset.serial, damper)


def weak_damper_finding(rule: WeakDamperRule, wheelset: str, damper: GearDamper) -> Finding:
    """Return the finding of a damper; the alert stands at the wheelset."""
    too_few = too_few_windows(damper.windows, rule.minimum_windows)
    weak, not_whole = _below(damper, rule.raise_share), _below(damper, rule.clear_share)
    decided = too_few is None and weak is not None and not_whole is not None
    unknown = None if decided else (damper.share.reason or too_few)
    return Finding(
        wheelset=wheelset,
        kind=WeakDamperRule.kind,
        breached=weak >= rule.raise_probability if decided and weak is not None else None,
        cleared=1.0 - not_whole >= rule.clear_probability if decided and not_whole is not None else None,
        probability=number_evidence(weak, 3),
        evidence=WeakDamperEvidence(
            vehicle=damper.vehicle,
            first_axle=damper.first_axle,
            share=damper.share,
            windows=damper.windows,
            from_ns=damper.from_ns,
            to_ns=damper.to_ns,
            limit=rule.raise_share,
            unknown=unknown,
        ).stored(),
        action="check_lateral_damper",
        raise_limit=rule.raise_share,
        clear_limit=rule.clear_share,
        measured_ns=damper.to_ns,
    )


def _below(damper: GearDamper, limit: float) -> float | None:
    """Return the probability that less than a share is left; None where the share is not known."""
    # the std follows from the upper end of the interval, because the lower end is cut off at 0
    value, high = damper.share.value, damper.share.high
    if value is None or high is None or not high > value:
        return None
    return float(ndtr((limit - value) * NORMAL_95 / (high - value)))


@dataclass(frozen=True, slots=True, kw_only=True)
class HuntingEvidence(DecidingEvidence):
    """Evidence of `hunting`: several of the latest windows show it."""

    hunting_windows: Annotated[int, Served("Windows of hunting among the latest.")]
    windows: Annotated[int, Served("How many windows were looked at.")]
    frequency_hz: Annotated[float | None, Served("Median frequency.")] = None
    wavelength_m: Annotated[float | None, Served("Median wavelength.")] = None
    amplitude_mm: Annotated[float | None, Served("Largest lateral amplitude.")] = None
    speed_max_km_h: Annotated[float | None, Served("Greatest speed of those windows.")] = None


@dataclass(frozen=True, slots=True)
class HuntingRule(WindowsRule):
    """The wheelset sways at its own wavelength, sustained, in several of the latest windows."""

    kind = "hunting"
    limit_unit = "windows"
    evidence = HuntingEvidence
    advice = "it hunts: check yaw dampers and wheel profiles"
    relations = (
        ("raise_windows", "<=", "latest_windows"),
        ("critical_windows", "<=", "latest_windows"),
        ("critical_windows", ">=", "raise_windows"),
        ("minimum_windows", "<=", "latest_windows"),
    )

    raise_windows: WindowCount = 3
    critical_windows: WindowCount = 10
    minimum_windows: WindowCount = 3  # behind "it does not hunt"
    hunting_share: Share = SUSTAINED.hunting_share  # of a window's running time that makes it a window of hunting

    def find_in(self, windows: Sequence[WindowRecord], facts: WheelsetFacts) -> Finding:
        """Return the finding on hunting."""
        hunting = [window for window in windows if self.is_suspect(window, facts)]
        unknown = None if hunting else too_few_windows(len(windows), self.minimum_windows)
        return Finding(
            wheelset=facts.wheelset.serial,
            kind=self.kind,
            breached=None if unknown else len(hunting) >= self.raise_windows,
            cleared=None if unknown else not hunting,
            severity=Severity.CRITICAL if len(hunting) >= self.critical_windows else Severity.WARNING,
            evidence=_hunting_evidence(hunting, len(windows), unknown).stored(),
            action="check_yaw_dampers_and_profiles",
            raise_limit=float(self.raise_windows),
            clear_limit=0.0,
            measured_ns=measured_until(windows, facts),
        )

    def is_suspect(self, window: WindowRecord, facts: WheelsetFacts) -> bool:  # noqa: ARG002 - the window alone decides
        """Return whether a window shows hunting for the share of its running time; of a share of 0 some is needed."""
        return window.quality.hunting.share >= self.hunting_share and window.quality.hunting.share > 0.0


def _hunting_evidence(hunting: Sequence[WindowRecord], windows: int, unknown: Reason | None) -> HuntingEvidence:
    if not hunting:
        return HuntingEvidence(hunting_windows=0, windows=windows, unknown=unknown)
    frequency = float(np.median([w.quality.hunting.frequency_hz for w in hunting]))
    speed = [0.5 * (w.quality.speed_min_m_s + w.quality.speed_max_m_s) for w in hunting]
    lengths = [v / w.quality.hunting.frequency_hz for v, w in zip(speed, hunting, strict=True)]
    return HuntingEvidence(
        hunting_windows=len(hunting),
        windows=windows,
        frequency_hz=number_evidence(frequency, 3),
        wavelength_m=number_evidence(float(np.median(lengths)), 2),
        amplitude_mm=number_evidence(max(1e3 * w.quality.hunting.amplitude for w in hunting), 2),
        speed_max_km_h=number_evidence(KM_H_IN_M_S * max(w.quality.speed_max_m_s for w in hunting), 3),
        unknown=unknown,
    )


Friction = Annotated[float, Interval(ge=0.02, le=0.6)]
Hours = Annotated[float, Interval(ge=0.1, le=720.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """A stretch of a track section."""

    from_m: Annotated[float, Served("Where it begins, along the section.")]
    to_m: Annotated[float, Served("Where it ends, along the section.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class LowAdhesionEvidence(Evidence):
    """Evidence of `low_adhesion`: rails of little friction along a track section."""

    track_section: Annotated[str, Served("Code of the section.")]
    stretches: Annotated[tuple[Stretch, ...], Served("Where friction is below the limit.")]
    friction: Annotated[Estimate | None, Served("Coefficient of friction at the surest place of them.", "friction_1")]
    passes: Annotated[int | None, Served("Passes of wheelsets behind it.")]
    windows: Annotated[int, Served("Windows that are pooled along the section.")]
    from_ns: Annotated[int, Served("Start of the first of them.", "measured_from")]
    to_ns: Annotated[int, Served("Start of the last of them.", "measured_to")]
    limit: Annotated[float, Served("Friction below which the alert is raised.", "limit_1")]


@dataclass(frozen=True, slots=True)
class LowAdhesionRule(AlertRule):
    """Friction is below a limit somewhere along a section; the alert is about the section, one for each fleet."""

    kind = "low_adhesion"
    limit_unit = "1"
    evidence = LowAdhesionEvidence

    raise_friction: Friction = 0.15
    raise_probability: Probability = 0.45
    pooled_hours: Hours = 6.0

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - friction is no fact of a wheelset
        """Return None: the finding is of a section, see ``section_finding``."""
        return None


def section_finding(rule: LowAdhesionRule, adhesion: SectionAdhesion) -> Finding:
    """Return the finding on the newest friction of a section; its ``wheelset`` is empty."""
    stretches = adhesion.low_stretches
    low = [
        cell
        for cell in adhesion.cells
        if cell.friction.value is not None and any(a <= cell.from_m and cell.to_m <= b for a, b in stretches)
    ]
    worst = max(low, key=lambda cell: cell.low_probability, default=None)
    evidence = LowAdhesionEvidence(
        track_section=adhesion.track_section,
        stretches=tuple(Stretch(from_m=begin, to_m=end) for begin, end in adhesion.low_stretches),
        friction=None if worst is None else worst.friction,
        passes=None if worst is None else worst.passes,
        windows=adhesion.windows,
        from_ns=adhesion.from_ns,
        to_ns=adhesion.to_ns,
        limit=rule.raise_friction,
    )
    return Finding(
        wheelset="",
        kind=LowAdhesionRule.kind,
        breached=bool(adhesion.low_stretches),
        cleared=not adhesion.low_stretches,
        probability=None if worst is None else round(worst.low_probability, 3),
        evidence=evidence.stored(),
        action="inspect_rail_surface",
        raise_limit=rule.raise_friction,
        clear_limit=rule.raise_friction,
        measured_ns=adhesion.to_ns,
        stands=bool(adhesion.low_stretches),
        since_ns=adhesion.to_ns,
    )
