"""From a wheelset's interval geometries to the points of its trend: one amplitude for all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.trend.trend import TrendPoint
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode, combined

PREFERRED_AMPLITUDE = 3e-3  # m, the reference amplitude of EN 15302
WANTED_SHARE = 0.75  # of the latest intervals that must cover an amplitude
LATEST = 8  # intervals: an amplitude that a little worn wheelset did not reach long ago may be covered now
SAME_AMPLITUDE = 1e-6  # m


@dataclass(frozen=True, slots=True)
class TrendPoints:
    """Points of one quantity, and a note where the quantity is not the headline one or intervals were left out."""

    quantity: str
    amplitude: float  # m
    points: tuple[TrendPoint, ...]
    note: Reason | None


def conicity_points(records: Sequence[GeometryRecord]) -> TrendPoints:
    """Return the equivalent conicity of each interval, at one amplitude.

    The amplitude is 3 mm where three quarters of the latest eight intervals cover it; else the largest smaller one
    that as many cover; else the one that most of them cover. Conicity depends on amplitude, so
    values at different amplitudes are never mixed in one trend.

    Parameters
    ----------
    records
        Interval geometries of one wheelset and baseline.
    """
    covered = [{_key(a): e for a, e in _conicities(r) if e.status is Status.ESTIMATED} for r in records]
    if not any(covered):
        return TrendPoints("equivalent_conicity", PREFERRED_AMPLITUDE, (), _why_none(records))
    chosen = _amplitude([c for c in covered if c])
    points = tuple(_point(r, c[chosen]) for r, c in zip(records, covered, strict=True) if chosen in c)
    quantity = "equivalent_conicity" if chosen == _PREFERRED else f"equivalent_conicity_{chosen / 1000:g}_mm"
    notes = []
    if chosen != _PREFERRED:
        text = f"at {chosen / 1000:g} mm, the largest amplitude that most intervals cover"
        notes.append(Reason(ReasonCode.OTHER_AMPLITUDE, text))
    if len(points) < len(records):
        text = f"{len(records) - len(points)} of {len(records)} intervals do not cover it"
        notes.append(Reason(ReasonCode.INTERVALS_LEFT_OUT, text))
    return TrendPoints(quantity, chosen * SAME_AMPLITUDE, points, combined(notes))


def _amplitude(covered: Sequence[Mapping[int, Estimate]]) -> int:
    """Return the key of the amplitude to show, from what each interval covers, which is something."""
    keys = sorted({key for c in covered for key in c})
    keys = [key for key in keys if key <= _PREFERRED] or keys
    counts = {key: sum(key in c for c in covered) for key in keys}
    latest = covered[-LATEST:]
    enough = [key for key in keys if sum(key in c for c in latest) >= WANTED_SHARE * len(latest)]
    return max(enough) if enough else max(counts, key=lambda key: (counts[key], key))


def _key(amplitude: float) -> int:
    return round(amplitude / SAME_AMPLITUDE)


_PREFERRED = _key(PREFERRED_AMPLITUDE)


def _conicities(record: GeometryRecord) -> list[tuple[float, Estimate]]:
    geometry = record.geometry
    pairs = list(zip((float(a) for a in geometry.amplitude), geometry.conicity, strict=True))
    if np.isfinite(geometry.reported_amplitude):
        pairs.append((geometry.reported_amplitude, geometry.equivalent_conicity))
    return pairs


def _point(record: GeometryRecord, estimate: Estimate) -> TrendPoint:
    assert estimate.value is not None
    assert estimate.std is not None
    return TrendPoint(record.mileage_km, (record.from_ns + record.to_ns) // 2, estimate.value, estimate.std)


def _why_none(records: Sequence[GeometryRecord]) -> Reason:
    if not records:
        return Reason(ReasonCode.NO_GEOMETRY_SINCE_REPROFILING, "no geometry since the last reprofiling")
    reasons = {r.geometry.equivalent_conicity.reason or r.geometry.reason for r in records} - {None}
    given = ", ".join(sorted(map(str, reasons))[:3])
    return Reason(ReasonCode.NO_CONICITY, f"no interval has an equivalent conicity: {given}")
