"""Rule: left and right wheel differ.

Two indicators. The *offset* is the lateral displacement at which both wheels roll on one radius (diameter difference
across the axle, EN 15302's R = 0 crossing); band-passed sensors may not see it. The *shape* is the even part of the
rolling radius difference, (R(y) + R(-y)) / 2, outside against inside: wheels of equal shape have none, whatever their
offset and however slowly the sensors see.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from estimation.alerts.rules import evidence
from estimation.alerts.rules.book import WheelAsymmetryRule
from estimation.values.alerts import AlertKind, Finding, Severity
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.geometry import WheelsetGeometry
from estimation.values.intervals import with_interval
from estimation.values.json_value import JsonValue
from estimation.values.quantities import Estimate

INSIDE = 1.0e-3  # m: the reference
OUTSIDE = (2.0e-3, 3.5e-3)  # m: what is compared with it


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
        return Estimate.unknown("no bins of the rolling radius difference")
    at, value, std = (
        x[known] for x in (centre, geometry.rolling_radius_difference.value, geometry.rolling_radius_difference.std)
    )
    reach = min(at[-1], -at[0])
    distance = centre[(centre > 0.0) & (centre <= reach)]
    even = 0.5 * (np.interp(distance, at, value) + np.interp(-distance, at, value))
    even_std = 0.5 * np.hypot(np.interp(distance, at, std), np.interp(-distance, at, std))
    inner = _mean(even, even_std, distance <= INSIDE)
    outer = _mean(even, even_std, (distance >= OUTSIDE[0]) & (distance <= OUTSIDE[1]))
    if inner is None or outer is None:
        return Estimate.unknown(f"bins on both sides reach {max(0.0, float(reach)) * 1e3:.2g} mm")
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
    blind: str = "",
) -> Finding:
    """Return what the indicators say.

    Breached when one of them is; it takes both to say that none is. Cleared when every indicator that raised the open
    alert (``raised_by``, from its evidence) is known and below its clear limit and no known one is above its own.
    """
    reason = blind or ("" if windows >= rule.minimum_windows else f"{windows} windows, {rule.minimum_windows} needed")
    limits = {
        "offset": (asymmetry.offset, rule.offset_limit_mm, rule.offset_clear_mm),
        "shape": (asymmetry.shape, rule.shape_limit_mm, rule.shape_clear_mm),
    }
    over = {name: None if reason else _beyond(value, limit) for name, (value, limit, _) in limits.items()}
    over_clear = {name: None if reason else _beyond(value, clear) for name, (value, _, clear) in limits.items()}
    breaching = [name for name, p in over.items() if p is not None and p >= rule.raise_probability]
    known = [p for p in over.values() if p is not None]
    leading = max((n for n, p in over.items() if p is not None), key=lambda n: over[n] or 0.0, default="offset")
    blamed = sorted({*breaching, *(name for name in raised_by if name in limits)})
    details: dict[str, JsonValue] = {
        "offset_mm": evidence.estimate(_in_mm(asymmetry.offset)),
        "shape_mm": evidence.estimate(_in_mm(asymmetry.shape)),
        "raised_by": [*blamed],
        "windows": windows,
        "unknown_because": reason or None,
    }
    return Finding(
        wheelset=wheelset,
        kind=AlertKind.WHEEL_ASYMMETRY,
        breached=True if breaching else (False if len(known) == len(over) else None),
        cleared=_cleared(over_clear, blamed, rule.clear_probability),
        severity=Severity.WARNING,
        probability=evidence.number(max(known), 3) if known else None,
        evidence=details,
        action="measure_wheel_diameters" if leading == "offset" else "measure_wheel_profiles",
        raise_limit=limits[leading][1],
        clear_limit=limits[leading][2],
        measured_ns=measured_ns,
    )


def _cleared(over_clear: dict[str, float | None], blamed: list[str], wanted: float) -> bool | None:
    known = {name: p for name, p in over_clear.items() if p is not None}
    if not known or any(name not in known for name in blamed):
        return None
    return all(1.0 - p >= wanted for p in known.values())


def _beyond(value: Estimate, limit_mm: float) -> float | None:
    """Return the probability that the size of the true value lies above the limit."""
    if value.value is None or value.std is None:
        return None
    if value.std <= 0.0:
        return float(abs(value.value) * 1e3 > limit_mm)
    at, spread = value.value * 1e3, value.std * 1e3
    return float(ndtr((at - limit_mm) / spread) + ndtr((-at - limit_mm) / spread))


def _in_mm(value: Estimate) -> Estimate:
    at, std, low, high = (None if x is None else x * 1e3 for x in (value.value, value.std, value.low, value.high))
    return Estimate(at, std, low, high, value.count, value.status, value.reason)
