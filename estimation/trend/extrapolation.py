"""The conicity of a wheelset at the amplitude of its limit: as estimated where it moves as far, else extrapolated.

A limit belongs to an amplitude (EN 15302 quotes 3 mm). Where the motion does not cover it, the new and worn wheelsets
of ``estimation.contact.wear`` say how conicity goes on: of those that are like the wheelset at the largest
amplitude covered and a quarter, a half and a whole millimetre below, the change up to 3 mm is fitted as linear in all
of these, and what is left over is the spread. Where few are like it, wider differences count, and the spread grows.

Where the motion ends is evidence too: a wheelset runs out until the energy of a deflection, which is as conicity times
amplitude squared, is that of the track's irregularity. Of an energy of which only the order is not known, the share
that ends between an amplitude and the next one is the logarithm of the ratio of both. So a member whose conicity rises
beyond counts for more than one that stays flat, whose motion would have gone on; not for much more, since yaw springs
hold a wheelset too.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib.resources import as_file, files
from typing import Annotated

import numpy as np

from estimation.trend.parameters import CURVES
from estimation.values.arrays import FloatArray, FrozenArrays, IntArray
from estimation.values.geometry import IntervalConicities, KnownConicity, WheelsetGeometry, known_conicities
from estimation.values.memory import MEMORY
from estimation.values.mixture import NormalMixture
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode, combined
from estimation.values.trend import BeyondReached, FleetWear, TrendPoint

LIMIT_AMPLITUDE = CURVES.limit_amplitude
SAME_AMPLITUDE = CURVES.same_amplitude


@dataclass(frozen=True, slots=True)
class Extrapolation:
    """A conicity at the limit's amplitude, extrapolated."""

    value: float
    measured_std: float  # from the error of what was estimated
    noise: float  # part of that which differs from interval to interval
    spread: float  # std of what wheelsets like it do beyond
    beyond: tuple[float, ...]  # what they do, less the mean: as many values of equal weight

    @property
    def std(self) -> float:
        """Standard deviation of both together."""
        return float(np.hypot(self.measured_std, self.spread))

    def mixture(self) -> NormalMixture:
        """Return the distribution, which is skewed: conicity rises steeply beyond, or stays as it is."""
        count, around = len(self.beyond), np.array(self.beyond)
        rest = float(np.hypot(self.measured_std, CURVES.smoothing_share * self.spread))
        return NormalMixture(np.full(count, 1.0 / count), self.value + around, np.full(count, rest))


def conicity_at_limit_amplitude(geometry: WheelsetGeometry, fleet: FleetWear | None = None) -> Estimate:
    """Return the conicity at 3 mm, which a limit is compared with: as the geometry has it, or extrapolated."""
    pairs = list(zip(geometry.amplitude.tolist(), geometry.conicity, strict=True))
    if np.isfinite(geometry.reported_amplitude):
        pairs.append((geometry.reported_amplitude, geometry.equivalent_conicity))
    estimated = sorted(((a, e) for a, e in pairs if e.status is Status.ESTIMATED), key=lambda pair: pair[0])
    covered = [e for a, e in estimated if abs(a - LIMIT_AMPLITUDE) < SAME_AMPLITUDE]
    if covered:
        return covered[-1]
    below = below_limit(geometry)
    if not estimated:
        return geometry.equivalent_conicity
    if not below:
        return Estimate.unknown(not_comparable(estimated[0][0]), estimated[0][1].count)
    amplitude, count = below[-1].amplitude, estimated[len(below) - 1][1].count
    beyond = extrapolated(below, fleet=fleet)
    if beyond is None:
        return Estimate.unknown(not_comparable(amplitude), count)
    low, high = (beyond.mixture().quantile(share) for share in (0.025, 0.975))
    return Estimate(beyond.value, beyond.std, low, high, count, Status.ESTIMATED, extrapolated_from(amplitude))


def below_limit(geometry: WheelsetGeometry) -> list[KnownConicity]:
    """Return the conicities that are known at smaller amplitudes than the limit's, increasing."""
    return [point for point in known_conicities(geometry) if point.amplitude < LIMIT_AMPLITUDE - SAME_AMPLITUDE]


def extrapolated_from(amplitude: float) -> Reason:
    """Return that a conicity is extrapolated from an amplitude (m)."""
    text = f"at {1e3 * LIMIT_AMPLITUDE:g} mm, extrapolated from {1e3 * amplitude:g} mm, the largest amplitude covered"
    return Reason(ReasonCode.AMPLITUDE_EXTRAPOLATED, text)


def not_comparable(amplitude: float) -> Reason:
    """Return that a conicity at an amplitude (m) cannot be compared with a limit."""
    text = f"the limit is for {1e3 * LIMIT_AMPLITUDE:g} mm, the conicity is known at {1e3 * amplitude:g} mm"
    return Reason(ReasonCode.AMPLITUDE_NOT_COMPARABLE, text)


def extrapolated(
    known: Sequence[KnownConicity], family: WornFamily | None = None, fleet: FleetWear | None = None
) -> Extrapolation | None:
    """Return the conicity at the limit's amplitude from those at smaller ones; None where it cannot be known.

    Wheelsets of its fleet that reach that amplitude go before the catalogue: they show by how much it is off.
    """
    beyond = _of_design_pairs(tuple(known)) if family is None else _extrapolated(tuple(known), family)
    if beyond is None or fleet is None:
        return beyond
    same = (shown for shown in fleet.beyond if abs(shown.amplitude - known[-1].amplitude) < SAME_AMPLITUDE)
    shown = next(same, None)
    if shown is None or shown.std >= beyond.spread:
        return beyond
    narrower = tuple(off * shown.std / beyond.spread for off in beyond.beyond)
    return replace(beyond, value=beyond.value + shown.error, spread=shown.std, beyond=narrower)


def beyond_reached(records: Sequence[IntervalConicities]) -> tuple[BeyondReached, ...]:
    """Return by how much the newest conicities at the limit's amplitude are off what is extrapolated to it."""
    off: defaultdict[int, list[tuple[float, float]]] = defaultdict(list)
    for record in records[-CURVES.covering_intervals :]:
        covered = by_amplitude(record)
        smaller = [covered[key]._replace(amplitude=key * SAME_AMPLITUDE) for key in sorted(covered) if key < _PREFERRED]
        at_limit = covered.get(_PREFERRED) or _nearly_reached(smaller)
        if at_limit is None:
            continue
        for count, largest in enumerate(smaller, start=1):
            beyond = extrapolated(smaller[:count])
            if beyond is not None and largest.amplitude >= CURVES.least_amplitude - SAME_AMPLITUDE:
                key = round(largest.amplitude / SAME_AMPLITUDE)
                off[key].append((at_limit.value - beyond.value, beyond.spread))
    return tuple(
        BeyondReached(key * SAME_AMPLITUDE, *(float(np.median(column)) for column in zip(*pairs, strict=True)))
        for key, pairs in sorted(off.items())
    )


def _nearly_reached(smaller: Sequence[KnownConicity]) -> Extrapolation | None:
    """Return the conicity at the limit's amplitude of a wheelset that moves nearly as far."""
    near = bool(smaller) and smaller[-1].amplitude >= CURVES.nearly_limit_amplitude - SAME_AMPLITUDE
    return extrapolated(smaller) if near else None


@lru_cache(MEMORY.extrapolations)
def _of_design_pairs(known: tuple[KnownConicity, ...]) -> Extrapolation | None:
    return _extrapolated(known, worn_family())


def _extrapolated(points: tuple[KnownConicity, ...], family: WornFamily) -> Extrapolation | None:
    largest = points[-1]
    if largest.amplitude < CURVES.least_amplitude - SAME_AMPLITUDE:
        return None
    used = [largest, *_below(points, family.amplitude[0])]
    if len(used) == 1:
        return None
    # level and differences (n, n) of the conicities at falling amplitudes (n,)
    steps = -np.eye(len(used)) + np.eye(len(used), k=-1)
    steps[0, 0] = 1.0
    members = np.stack([_at(family, point.amplitude) for point in used], axis=1)
    error = (members - [point.value for point in used]) @ steps.T
    covariance, noise = (steps @ _covariance(used, of) @ steps.T for of in ("std", "noise"))
    # by how much level and slopes of a member may differ
    alike = max(CURVES.least_alike_difference, CURVES.alike_share * largest.value) * np.array(
        [1.0] + [CURVES.slope_alike_share] * (len(used) - 1)
    )
    weighed = _alike(error, covariance, alike, _stopped(family, largest.amplitude, members[:, 0]))
    if weighed is None:
        return None
    weight, width = weighed
    counts = weight > CURVES.negligible_weight
    weight, change = weight[counts], (_at(family, LIMIT_AMPLITUDE) - members[:, 0])[counts]
    level, gradient, rest = _local_fit(error[counts], width, weight, change)
    spread = float(np.sqrt(weight @ rest**2 / weight.sum()))
    measured_std, noise_std = (float(np.sqrt(gradient @ of @ gradient)) for of in (covariance, noise))
    result = Extrapolation(largest.value + level, measured_std, noise_std, spread, _quantiles(rest, weight))
    return result if result.std <= CURVES.largest_conicity_std and result.value > 0.0 else None


def _below(points: Sequence[KnownConicity], least: float) -> list[KnownConicity]:
    lower = [point for point in points[:-1] if point.amplitude >= least - SAME_AMPLITUDE]
    wanted = [points[-1].amplitude - below for below in CURVES.shape_distances] if lower else []
    nearest = {min(lower, key=lambda point: abs(point.amplitude - amplitude)) for amplitude in wanted}
    return sorted(nearest, key=lambda point: -point.amplitude)


def _at(family: WornFamily, amplitude: float) -> FloatArray:
    upper = min(max(int(np.searchsorted(family.amplitude, amplitude)), 1), len(family.amplitude) - 1)
    low, high = family.amplitude[upper - 1], family.amplitude[upper]
    share = (amplitude - low) / (high - low)
    return np.asarray((1.0 - share) * family.conicity[:, upper - 1] + share * family.conicity[:, upper])


def _covariance(shown: Sequence[KnownConicity], of: str) -> FloatArray:
    amplitude, std = (np.array([getattr(conicity, name) for conicity in shown]) for name in ("amplitude", of))
    near = np.exp(-np.abs(np.subtract.outer(amplitude, amplitude)) / CURVES.near_amplitude)
    return np.asarray(np.outer(std, std) * (CURVES.shared_error_share + (1.0 - CURVES.shared_error_share) * near))


def _stopped(family: WornFamily, amplitude: float, conicity: FloatArray) -> FloatArray:
    """Return how likely (m,) the motion of the members ends before the next amplitude (m); 1 where conicity is even."""
    beyond = np.maximum(_at(family, amplitude + CURVES.uncovered_step), CURVES.flat_conicity)
    ratio = 2.0 * np.log1p(CURVES.uncovered_step / amplitude)
    return np.asarray(
        np.clip(1.0 + np.log(beyond / np.maximum(conicity, CURVES.flat_conicity)) / ratio, *CURVES.stop_weights)
    )


def _alike(
    error: FloatArray, covariance: FloatArray, width: FloatArray, stopped: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Return the weights (m,) of the members and the width (n,) within which enough are alike.

    None where too few are alike. Members count by how far level and slopes (m, n) are from the wheelset's, in the
    errors of the estimate and the width of what is alike, and by how likely their motion ends there (m,). That all of
    them lie to one side is no reason to say nothing: the fit is carried on to the wheelset.
    """
    for wider in CURVES.widening_factors:
        inverse = np.linalg.inv(covariance + np.diag((wider * width) ** 2))
        weight = stopped * np.exp(-0.5 * ((error @ inverse) * error).sum(axis=1))
        if weight.sum() >= CURVES.least_members:
            return weight, wider * width
    return None


def _local_fit(
    error: FloatArray, width: FloatArray, weight: FloatArray, change: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Return the change up to the limit's amplitude, what it does with level and slopes (n,), and what is left (m,)."""
    # the changes (m,) are fitted as linear in level and slopes (m, n), by the weights (m,)
    design = np.column_stack([np.ones(len(error)), error / width])
    normal = (design * weight[:, np.newaxis]).T @ design + CURVES.ridge_weight * np.diag([0.0] + [1.0] * len(width))
    level, *slopes = np.linalg.solve(normal, design.T @ (weight * change))
    rest = change - design @ np.array([level, *slopes])
    gradient = np.array(slopes) / width
    gradient[0] += 1.0
    return float(level), gradient, rest


def _quantiles(rest: FloatArray, weight: FloatArray) -> tuple[float, ...]:
    order = np.argsort(rest)
    counted = np.cumsum(weight[order]) - 0.5 * weight[order]
    shares = (np.arange(CURVES.spread_values) + 0.5) / CURVES.spread_values
    values = np.interp(shares * weight.sum(), counted, rest[order])
    return tuple((values - values.mean()).tolist())


QUANTITY = "equivalent_conicity"  # at the limit's amplitude; at another one its name has the amplitude
_PREFERRED = round(LIMIT_AMPLITUDE / SAME_AMPLITUDE)

_Covered = tuple[IntervalConicities, Mapping[int, KnownConicity]]  # with its conicities by amplitude in micrometres


@dataclass(frozen=True, slots=True)
class TrendPoints:
    """Points of one quantity, and a note where they are extrapolated, at another amplitude, or intervals were left out.

    ``not_comparable`` says why no limit is held against them; None where one is.
    """

    quantity: str
    amplitude: float  # m, of the points
    points: tuple[TrendPoint, ...]
    note: Reason | None
    not_comparable: Reason | None = None


def conicity_points(records: Sequence[IntervalConicities], fleet: FleetWear | None = None) -> TrendPoints:
    """Return the equivalent conicity of each interval, at one amplitude."""
    # The amplitude is 3 mm where three quarters of the latest eight intervals cover it. Else every interval is
    # extrapolated to 3 mm from the largest amplitude that as many cover (else the one that most of them cover). Where
    # that is not possible the points are at that amplitude, and no limit is compared with them. Conicity depends on
    # amplitude, so values at different amplitudes are never mixed in one trend.
    covered = [by_amplitude(record) for record in records]
    if not any(covered):
        given = ", ".join(sorted(map(str, {r.reason for r in records} - {None}))[:3])
        why = Reason(ReasonCode.NO_CONICITY, f"no interval has an equivalent conicity: {given}")
        if not records:
            why = Reason(ReasonCode.NO_GEOMETRY_SINCE_REPROFILING, "no geometry since the last reprofiling")
        return TrendPoints(QUANTITY, LIMIT_AMPLITUDE, (), why)
    chosen = _amplitude([c for c in covered if c])
    having = [(r, c) for r, c in zip(records, covered, strict=True) if chosen in c]
    notes = []
    if len(having) < len(records):
        text = f"{len(records) - len(having)} of {len(records)} intervals do not cover it"
        notes.append(Reason(ReasonCode.INTERVALS_LEFT_OUT, text))
    if chosen == _PREFERRED:
        points = tuple(_point(r, c[chosen]) for r, c in having)
        return TrendPoints(QUANTITY, LIMIT_AMPLITUDE, points, combined(notes))
    extrapolations = _extrapolated_points(having, chosen, notes, fleet)
    if extrapolations is not None:
        return extrapolations
    amplitude, name = chosen * SAME_AMPLITUDE, f"{chosen / 1000:g}"
    text = f"at {name} mm, the largest amplitude that most intervals cover"
    note = combined([Reason(ReasonCode.OTHER_AMPLITUDE, text), *notes])
    points = tuple(_point(r, c[chosen]) for r, c in having)
    quantity = f"{QUANTITY}_{name}_mm"
    return TrendPoints(quantity, amplitude, points, note, not_comparable=not_comparable(amplitude))


def _extrapolated_points(
    having: Sequence[_Covered], chosen: int, notes: Sequence[Reason], fleet: FleetWear | None
) -> TrendPoints | None:
    tried = []
    for record, covered in having if chosen < _PREFERRED else ():
        smaller = [covered[key]._replace(amplitude=key * SAME_AMPLITUDE) for key in sorted(covered) if key <= chosen]
        tried.append((record, extrapolated(smaller, fleet=fleet)))
    extrapolations = [(record, extrapolation) for record, extrapolation in tried if extrapolation is not None]
    if not extrapolations or tried[-1][1] is None or len(extrapolations) < CURVES.covering_share * len(tried):
        return None
    points = tuple(_point(record, extrapolation) for record, extrapolation in extrapolations)
    note = combined([extrapolated_from(chosen * SAME_AMPLITUDE), *notes])
    return TrendPoints(QUANTITY, LIMIT_AMPLITUDE, points, note)


def _amplitude(covered: Sequence[Mapping[int, KnownConicity]]) -> int:
    """Return the key of the amplitude to show, from what each interval covers, which is something."""
    keys = sorted({key for c in covered for key in c})
    keys = [key for key in keys if key <= _PREFERRED] or keys
    counts = {key: sum(key in c for c in covered) for key in keys}
    latest = covered[-CURVES.covering_intervals :]
    enough = [key for key in keys if sum(key in c for c in latest) >= CURVES.covering_share * len(latest)]
    return max(enough) if enough else max(counts, key=lambda key: (counts[key], key))


def by_amplitude(record: IntervalConicities) -> dict[int, KnownConicity]:
    """Return the conicities of an interval by amplitude in ``SAME_AMPLITUDE``."""
    return {round(conicity.amplitude / SAME_AMPLITUDE): conicity for conicity in record.known}


def _point(record: IntervalConicities, conicity: KnownConicity | Extrapolation) -> TrendPoint:
    at_ns = (record.from_ns + record.to_ns) // 2
    return TrendPoint(record.mileage_km, at_ns, conicity.value, conicity.std, conicity.noise)


TABLE = "worn_family.npy"  # written by ``python -m bench.worn_family``
AMPLITUDES: FloatArray = np.array(CURVES.table_amplitudes)


@dataclass(frozen=True, slots=True)
class WornFamily(FrozenArrays):
    """Conicities by amplitude of many wheelsets, new and worn: how conicity goes on with amplitude."""

    amplitude: Annotated[FloatArray, "a"]  # m
    conicity: Annotated[FloatArray, "m", "a"]
    pair: Annotated[IntArray, "m"]  # number of the pair of design wheel and rail


@cache
def worn_family() -> WornFamily:
    """Return all pairs, as they are kept beside this module."""
    with as_file(files("estimation.contact") / TABLE) as path:
        stored = np.load(path, allow_pickle=False)
    return WornFamily(AMPLITUDES, np.asarray(stored[:, 1:] * CURVES.stored_unit), stored[:, 0].astype(np.int64))
