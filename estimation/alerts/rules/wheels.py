"""Rules on the wheels of a wheelset: one with a flat strikes once a turn, and left and right differ.

Two indicators say that they differ. The *offset* is the lateral displacement at which both wheels roll on one radius
(diameter difference across the axle, EN 15302's R = 0 crossing); band-passed sensors may not see it. The *shape* is the
even part of the rolling radius difference, (R(y) + R(-y)) / 2, outside against inside: wheels of equal shape have none,
whatever their offset and however slowly the sensors see.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from scipy.special import ndtr

from estimation.alerts.parameters import FINDINGS
from estimation.alerts.rules.rule import (
    AlertRule,
    Probability,
    Share,
    Standing,
    WheelsetFacts,
    WindowCount,
    WindowShareRule,
    counting,
    too_few_windows,
)
from estimation.values.alerts import DecidingEvidence, Finding, Severity, number_evidence
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.fields import JsonValue, Served
from estimation.values.geometry import GeometryRecord, WheelsetGeometry
from estimation.values.quantities import Estimate, with_interval
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import KM_H_IN_M_S
from estimation.values.windows import WindowRecord

Indicator = Literal["offset", "shape"]


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelFlatEvidence(DecidingEvidence):
    """Evidence of `wheel_flat`: a wheel strikes once a turn in many of the latest windows."""

    striking_windows: Annotated[int, Served("Windows in which it strikes, of the latest.")]
    windows: Annotated[int, Served("How many windows were looked at.")]
    blow_m_s2: Annotated[float | None, Served("Median lateral acceleration; at least that where the sensor clips.")]
    wheel: Annotated[Literal["left", "right"] | None, Served("Of the wheelset itself; null where it is not known.")]
    turn_m: Annotated[float | None, Served("Distance between two blows.")]
    speed_max_km_h: Annotated[float | None, Served("Greatest speed of those windows.")]


@dataclass(frozen=True, slots=True)
class WheelFlatRule(WindowShareRule):
    """Blows on the axle box once a turn of the wheel, in a share of the latest windows."""

    kind = "wheel_flat"
    limit_unit = "1"
    evidence = WheelFlatEvidence
    advice = "a wheel has a flat: inspect the treads, turn the wheelset"
    of_wear = True

    raise_share: Share = 0.25  # of the windows; blows are weak where a vehicle runs slowly
    clear_share: Share = 0.15
    raise_probability: Probability = 0.9
    critical_m_s2: float = 35.0  # of the lateral acceleration; the shipped catalogue ends at 41

    def find_in(self, windows: Sequence[WindowRecord], facts: WheelsetFacts) -> Finding:
        """Return the finding on blows once a turn."""
        striking = [window for window in windows if self.is_suspect(window, facts)]
        size, turn_m = (
            float(np.median([getattr(window.quality.blows, name) for window in striking])) if striking else None
            for name in ("size", "turn_m")
        )
        mounting = facts.wheelset.mounting
        speeds = [KM_H_IN_M_S * window.quality.speed_max_m_s for window in striking]
        evidence = WheelFlatEvidence(
            striking_windows=len(striking),
            windows=len(windows),
            blow_m_s2=number_evidence(size, 2),
            wheel=None if mounting is None else _wheel(striking, mounted_reversed=mounting.reversed),
            turn_m=number_evidence(turn_m, 3),
            speed_max_km_h=number_evidence(max(speeds, default=None), 3),
            unknown=too_few_windows(len(windows), self.minimum_windows),
        )
        severity = Severity.CRITICAL if size is not None and size >= self.critical_m_s2 else Severity.WARNING
        return self.share_finding(windows, len(striking), facts, evidence, "inspect_wheel_treads", severity)

    def is_suspect(self, window: WindowRecord, facts: WheelsetFacts) -> bool:
        """Return whether a wheel strikes in a window."""
        return strikes(window, 2.0 * math.pi * facts.wheelset.nominal_radius_m)

    def counts_from_ns(self, facts: WheelsetFacts) -> int | None:
        """Return when the wheels were last turned."""
        return max((reprofiling.at_ns for reprofiling in facts.wheelset.reprofilings), default=None)


def strikes(window: WindowRecord, turn_m: float) -> bool:
    """Return whether a wheel that runs ``turn_m`` in a turn strikes for most of a window."""
    blows = window.quality.blows
    return blows.sustained and abs(blows.turn_m / turn_m - 1.0) <= FINDINGS.turn_tolerance


def _wheel(found: Sequence[WindowRecord], *, mounted_reversed: bool) -> Literal["left", "right"] | None:
    """Return which of the wheelset's own wheels strikes, ``left`` or ``right``; None where the windows do not say."""
    sides = [window.quality.blows.side for window in found if window.quality.blows.side]
    if not sides or abs(sum(sides)) < FINDINGS.same_side_share * len(sides) or 2 * len(sides) < len(found):
        return None
    on_left = sum(sides) > 0
    return "left" if on_left != mounted_reversed else "right"


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelAsymmetryEvidence(DecidingEvidence):
    """Evidence of `wheel_asymmetry`: left and right wheel differ."""

    offset_mm: Annotated[Estimate, Served("Lateral displacement at which both wheels roll on one radius.")]
    shape_mm: Annotated[Estimate, Served("Even part of the rolling radius difference, outside against inside.")]
    raised_by: Annotated[tuple[Indicator, ...], Served("What raised it.")]
    windows: Annotated[int, Served("Windows behind the geometry.")]


@dataclass(frozen=True, slots=True)
class WheelAsymmetryRule(AlertRule):
    """Left and right wheel differ: an offset of the rolling line, or unequal tread shapes."""

    kind = "wheel_asymmetry"
    limit_unit = "mm"
    evidence = WheelAsymmetryEvidence
    advice = "its wheels differ in diameter or shape: measure them"
    counts_km = True
    of_wear = True
    relations = (("offset_clear_mm", "<=", "offset_limit_mm"), ("shape_clear_mm", "<=", "shape_limit_mm"))

    offset_limit_mm: float = 2.0  # lateral displacement at which both wheels roll on one radius
    offset_clear_mm: float = 1.5
    shape_limit_mm: float = 0.5  # even part of the rolling radius difference, outside against inside
    shape_clear_mm: float = 0.35
    raise_probability: Probability = 0.95
    clear_probability: Probability = 0.9
    minimum_windows: WindowCount = 3

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - the data alone decide
        """Return the finding of the current geometry, which stands by the newest intervals; None without one."""
        if facts.geometry is None:
            return None
        if not facts.intervals:
            raised = (_names(a.evidence.get("raised_by")) for a in facts.open_alerts if a.kind == self.kind)
            now = self._of(facts, facts.geometry, next(raised, []), facts.not_assessable_reason)
            return replace(now, mileage_km=facts.geometry.mileage_km)
        standing, blamed = Standing(), list[str]()
        counted = counting(facts, self.delays)
        for interval in counted:
            record = facts.geometry if interval is counted[-1] else interval
            finding = replace(self._of(facts, record, blamed), mileage_km=interval.mileage_km)
            if finding.breached is None:
                continue
            standing = standing.after(finding, self.delays)
            blamed = [] if standing.since_ns is None else _names(finding.evidence.get("raised_by"))
        now = self._of(facts, facts.geometry, blamed, facts.not_assessable_reason)
        return replace(now, stands=standing.since_ns is not None, since_ns=standing.since_ns)

    def _of(
        self, facts: WheelsetFacts, record: GeometryRecord, raised_by: Sequence[str], reason: Reason | None = None
    ) -> Finding:
        return wheel_asymmetry_finding(
            self,
            facts.wheelset.serial,
            asymmetry_of(record.geometry),
            record.geometry.windows,
            record.to_ns,
            raised_by=raised_by,
            not_assessable_reason=reason,
        )


def _names(indicators: JsonValue) -> list[str]:
    return [str(name) for name in indicators] if isinstance(indicators, list) else []


@dataclass(frozen=True, slots=True)
class Asymmetry:
    """Both indicators of a wheelset, in metres."""

    offset: Estimate
    shape: Estimate


def asymmetry_of(geometry: WheelsetGeometry) -> Asymmetry:
    """Return both indicators of a geometry."""
    return Asymmetry(geometry.zero_crossing, _shape(geometry))


def _shape(geometry: WheelsetGeometry) -> Estimate:
    centre = geometry.bin_centres
    known = np.isfinite(geometry.rolling_radius_difference.value) & np.isfinite(geometry.rolling_radius_difference.std)
    if np.count_nonzero(known) < 2:  # noqa: PLR2004 - nothing to interpolate between
        return Estimate.unknown(Reason(ReasonCode.TOO_FEW_BINS, "no bins of the rolling radius difference"))
    place, value, std = (
        x[known] for x in (centre, geometry.rolling_radius_difference.value, geometry.rolling_radius_difference.std)
    )
    reach = min(place[-1], -place[0])
    distance = centre[(centre > 0.0) & (centre <= reach)]
    even = 0.5 * (np.interp(distance, place, value) + np.interp(-distance, place, value))
    even_std = 0.5 * np.hypot(np.interp(distance, place, std), np.interp(-distance, place, std))
    inner = _mean(even, even_std, distance <= FINDINGS.inner_amplitude)
    outer = _mean(even, even_std, (distance >= FINDINGS.outer_range[0]) & (distance <= FINDINGS.outer_range[1]))
    if inner is None or outer is None:
        return Estimate.unknown(
            Reason(ReasonCode.TOO_FEW_BINS, f"bins on both sides reach {max(0.0, float(reach)) * 1e3:.2g} mm")
        )
    difference, spread = outer[0] - inner[0], float(np.hypot(outer[1], inner[1]))
    return with_interval(difference, spread, count=float(geometry.windows))


def _mean(value: FloatArray, std: FloatArray, chosen: BoolArray) -> tuple[float, float] | None:
    if not np.any(chosen):
        return None
    # errors of neighbouring bins go together: the mean is not better than its bins
    return float(np.mean(value[chosen])), float(np.mean(std[chosen]))


def wheel_asymmetry_finding(
    rule: WheelAsymmetryRule,
    wheelset: str,
    asymmetry: Asymmetry,
    windows: int,
    measured_ns: int,
    *,
    raised_by: Sequence[str] = (),
    not_assessable_reason: Reason | None = None,
) -> Finding:
    """Return the finding of one wheelset from the two indicators of its asymmetry.

    Breached when one of them is; not breached when both are known not to be. Cleared when every indicator that raised
    the open alert (``raised_by``, from its evidence) is known and below its clear limit and no known one is above its
    own.
    """
    reason = not_assessable_reason or too_few_windows(windows, rule.minimum_windows)
    limits: dict[Indicator, tuple[Estimate, float, float]] = {
        "offset": (asymmetry.offset, rule.offset_limit_mm, rule.offset_clear_mm),
        "shape": (asymmetry.shape, rule.shape_limit_mm, rule.shape_clear_mm),
    }
    over = {name: None if reason else _beyond(value, limit) for name, (value, limit, _) in limits.items()}
    over_clear = {name: None if reason else _beyond(value, clear) for name, (value, _, clear) in limits.items()}
    breaching = [name for name, p in over.items() if p is not None and p >= rule.raise_probability]
    known = [p for p in over.values() if p is not None]
    leading: Indicator = max(limits, key=lambda name: -1.0 if over[name] is None else over[name] or 0.0)
    blamed = [name for name in limits if name in breaching or name in raised_by]
    details = WheelAsymmetryEvidence(
        offset_mm=asymmetry.offset.scaled(1e3),
        shape_mm=asymmetry.shape.scaled(1e3),
        raised_by=tuple(blamed),
        windows=windows,
        unknown=reason,
    )
    return Finding(
        wheelset=wheelset,
        kind=WheelAsymmetryRule.kind,
        breached=True if breaching else (False if len(known) == len(over) else None),
        cleared=_cleared(over_clear, blamed, rule.clear_probability),
        probability=number_evidence(max(known), 3) if known else None,
        evidence=details.stored(),
        action="measure_wheel_diameters" if leading == "offset" else "measure_wheel_profiles",
        raise_limit=limits[leading][1],
        clear_limit=limits[leading][2],
        measured_ns=measured_ns,
    )


def _cleared(over_clear: Mapping[Indicator, float | None], blamed: Sequence[str], wanted: float) -> bool | None:
    probabilities = {name: p for name, p in over_clear.items() if p is not None}
    if not probabilities or any(name not in probabilities for name in blamed):
        return None
    return all(1.0 - p >= wanted for p in probabilities.values())


def _beyond(value: Estimate, limit_mm: float) -> float | None:
    if value.value is None or value.std is None:
        return None
    if value.std <= 0.0:
        return float(abs(value.value) * 1e3 > limit_mm)
    size, spread = value.value * 1e3, value.std * 1e3
    return float(ndtr((size - limit_mm) / spread) + ndtr((-size - limit_mm) / spread))
