"""From a wheelset's interval geometries to the points of its trend: one amplitude for all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimation.trend.extrapolation import (
    LIMIT_AMPLITUDE,
    SAME_AMPLITUDE,
    extrapolated,
    extrapolated_from,
    not_comparable,
)
from estimation.trend.trend import TrendPoint
from estimation.values.geometry import IntervalConicities, KnownConicity
from estimation.values.reasons import Reason, ReasonCode, combined

QUANTITY = "equivalent_conicity"  # at the limit's amplitude; at another one its name has the amplitude
WANTED_SHARE = 0.75  # of the latest intervals that must cover an amplitude
LATEST = 8  # intervals: an amplitude that a little worn wheelset did not reach long ago may be covered now

_Covered = tuple[IntervalConicities, Mapping[int, KnownConicity]]  # with its conicities by amplitude in micrometres


@dataclass(frozen=True, slots=True)
class TrendPoints:
    """Points of one quantity, and a note where they are extrapolated, at another amplitude, or intervals were left out.

    ``spread`` is what the points have in common of the error of extrapolation. ``not_comparable`` says why no limit is
    held against them; None where one is.
    """

    quantity: str
    amplitude: float  # m, of the points
    points: tuple[TrendPoint, ...]
    note: Reason | None
    spread: float = 0.0
    not_comparable: Reason | None = None


def conicity_points(records: Sequence[IntervalConicities]) -> TrendPoints:
    """Return the equivalent conicity of each interval, at one amplitude.

    The amplitude is 3 mm where three quarters of the latest eight intervals cover it. Else every interval is
    extrapolated to 3 mm from the largest amplitude that as many cover (else the one that most of them cover). Where
    that is not possible the points are at that amplitude, and no limit is compared with them. Conicity depends on
    amplitude, so values at different amplitudes are never mixed in one trend.
    """
    covered = [{_key(one.amplitude): one for one in r.known} for r in records]
    if not any(covered):
        return TrendPoints(QUANTITY, LIMIT_AMPLITUDE, (), _why_none(records))
    chosen = _amplitude([c for c in covered if c])
    having = [(r, c) for r, c in zip(records, covered, strict=True) if chosen in c]
    notes = []
    if len(having) < len(records):
        text = f"{len(records) - len(having)} of {len(records)} intervals do not cover it"
        notes.append(Reason(ReasonCode.INTERVALS_LEFT_OUT, text))
    if chosen == _PREFERRED:
        points = tuple(_point(r, c[chosen]) for r, c in having)
        return TrendPoints(QUANTITY, LIMIT_AMPLITUDE, points, combined(notes))
    return _extrapolated_points(having, chosen, notes) or _points_at(having, chosen, notes)


def _extrapolated_points(having: Sequence[_Covered], chosen: int, notes: Sequence[Reason]) -> TrendPoints | None:
    """Return the points at 3 mm, extrapolated from the chosen amplitude; None where that is not possible for most."""
    found = [(r, extrapolated(_up_to(c, chosen))) for r, c in having if chosen < _PREFERRED]
    known = [(r, e) for r, e in found if e is not None]
    if not known or found[-1][1] is None or len(known) < WANTED_SHARE * len(found):
        return None
    points = tuple(TrendPoint(r.mileage_km, _middle_ns(r), e.value, e.std) for r, e in known)
    note = combined([extrapolated_from(chosen * SAME_AMPLITUDE), *notes])
    return TrendPoints(QUANTITY, LIMIT_AMPLITUDE, points, note, max(e.spread for _, e in known))


def _points_at(having: Sequence[_Covered], chosen: int, notes: Sequence[Reason]) -> TrendPoints:
    points = tuple(_point(r, c[chosen]) for r, c in having)
    text = f"at {chosen / 1000:g} mm, the largest amplitude that most intervals cover"
    note = combined([Reason(ReasonCode.OTHER_AMPLITUDE, text), *notes])
    amplitude = chosen * SAME_AMPLITUDE
    quantity = f"{QUANTITY}_{chosen / 1000:g}_mm"
    return TrendPoints(quantity, amplitude, points, note, not_comparable=not_comparable(amplitude))


def _up_to(covered: Mapping[int, KnownConicity], chosen: int) -> list[KnownConicity]:
    return [covered[key]._replace(amplitude=key * SAME_AMPLITUDE) for key in sorted(covered) if key <= chosen]


def _amplitude(covered: Sequence[Mapping[int, KnownConicity]]) -> int:
    """Return the key of the amplitude to show, from what each interval covers, which is something."""
    keys = sorted({key for c in covered for key in c})
    keys = [key for key in keys if key <= _PREFERRED] or keys
    counts = {key: sum(key in c for c in covered) for key in keys}
    latest = covered[-LATEST:]
    enough = [key for key in keys if sum(key in c for c in latest) >= WANTED_SHARE * len(latest)]
    return max(enough) if enough else max(counts, key=lambda key: (counts[key], key))


def _key(amplitude: float) -> int:
    return round(amplitude / SAME_AMPLITUDE)


_PREFERRED = _key(LIMIT_AMPLITUDE)


def _point(record: IntervalConicities, conicity: KnownConicity) -> TrendPoint:
    return TrendPoint(record.mileage_km, _middle_ns(record), conicity.value, conicity.std)


def _middle_ns(record: IntervalConicities) -> int:
    return (record.from_ns + record.to_ns) // 2


def _why_none(records: Sequence[IntervalConicities]) -> Reason:
    if not records:
        return Reason(ReasonCode.NO_GEOMETRY_SINCE_REPROFILING, "no geometry since the last reprofiling")
    reasons = {r.reason for r in records} - {None}
    given = ", ".join(sorted(map(str, reasons))[:3])
    return Reason(ReasonCode.NO_CONICITY, f"no interval has an equivalent conicity: {given}")
