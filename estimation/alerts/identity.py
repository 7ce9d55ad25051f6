"""Is a wheelset still the one that the registry names? Judged by its geometry before and after.

Wear changes a rolling radius difference R(y - d) slowly. Where it has jumped, two mistakes explain it exactly: the
wheelset runs the other way round than on file, then R(x) has become -R(-x), which wheels of unequal shape show; or two
wheelsets have been exchanged, then each has what was the other's. Only what is explained is reported, and only where
the explanation fits far better than staying the same.

Distances between curves are root mean squares over the bins that both have, in standard deviations that include wear,
a common error of scale, and what a band-passed signal leaves open of the level.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import combinations

import numpy as np

from estimation.alerts.parameters import FINDINGS
from estimation.trend.change_point import Series, StepModel, newest_change
from estimation.values.arrays import FloatArray
from estimation.values.geometry import WheelsetGeometry
from estimation.values.runs import History, ResultKind, SubjectKind

EVEN = StepModel(
    slope=0.0,
    slope_std=5e-6,  # mm per km, wear that differs between the wheels
    bend_std=2e-6,
    wander_std=0.01,
    step_std=0.3,
    outlier_std=0.2,
    noise_floor=1e-3,
    least_size=0.03,
    sure=0.95,
)  # of the rms of the even part, mm


@dataclass(frozen=True, slots=True)
class Parts:
    """Even and odd parts of the curves of a wheelset for x > 0, in order of mileage; NaN where not known."""

    x_km: FloatArray  # (k,)
    t_ns: FloatArray  # (k,)
    even: FloatArray  # (k, b) m
    odd: FloatArray  # (k, b) m
    std: FloatArray  # (k, b) m, of the even part


@dataclass(frozen=True, slots=True)
class Mirrored:
    """Where the even part has changed its sign."""

    last: int  # curve before it
    first: int  # curve behind it
    jump: float  # standard deviations of the step
    left: float  # standard deviations that the other sign leaves


def newest_mirrored(parts: Parts) -> Mirrored | None:
    """Return the newest change of sign since the last known event, by a whole history; None where there is none."""
    # From one interval to the next a curve differs by no more than its standard deviations where these are large,
    # although most of what they hold is common to all intervals of a wheelset. Over a history the noise is known: the
    # even parts are one pattern of changing size, which wears slowly, and a wheelset that was turned end for end has
    # the same size with the other sign.
    bins = np.isfinite(parts.even).mean(axis=0) >= 1.0 - FINDINGS.size_tolerance
    whole = np.flatnonzero(np.isfinite(parts.even[:, bins]).all(axis=1))
    if bins.sum() < FINDINGS.fewest_mirrored_bins or len(whole) < 2 * EVEN.least_points:
        return None
    even, odd, std = (1e3 * table[whole][:, bins] for table in (parts.even, parts.odd, parts.std))
    even = even - even.mean(axis=1, keepdims=True)  # a band-passed signal leaves the level open
    size, error = _sizes(even, std)
    x_km = parts.x_km[whole]
    step = newest_change(Series(x_km, parts.t_ns[whole], size, error), EVEN)
    if step is None:
        return None
    beside = EVEN.points_beside
    sides = slice(max(0, step.last + 1 - beside), step.last + 1), slice(step.first, step.first + beside)
    before, after = (float(np.median(size[side])) for side in sides)
    odd_change, even_change = (_change(table, x_km, sides) for table in (odd, even))
    unlike, common = abs(after + before), float(np.median(error))
    most_unlike = FINDINGS.size_tolerance * abs(step.size) + FINDINGS.common_stds * common
    if odd_change > FINDINGS.mirrored_odd_share * even_change or unlike > most_unlike:
        return None
    unexplained = unlike / float(np.hypot(step.std, FINDINGS.common_stds * common))
    return Mirrored(int(whole[step.last]), int(whole[step.first]), abs(step.size) / step.std, unexplained)


def _sizes(even: FloatArray, std: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how much each even part (k, b) has of the pattern that varies most, rms in mm, and its std."""
    pattern = np.linalg.svd(even - even.mean(axis=0), full_matrices=False)[2][0]
    root = np.sqrt(len(pattern))
    # errors of neighbouring bins go together
    return even @ pattern / root, np.maximum(std @ np.abs(pattern) / root, EVEN.noise_floor)


def _change(table: FloatArray, x_km: FloatArray, sides: tuple[slice, slice]) -> float:
    """Return by how much the curves change, rms over the bins: as they are, or less for the wear on both sides."""
    rates = [np.diff(table[side], axis=0) / np.maximum(np.diff(x_km[side]), 1.0)[:, np.newaxis] for side in sides]
    wear = np.median(np.concatenate(rates), axis=0)
    changes = []
    for rate in (np.zeros_like(wear), wear):
        before, after = (np.median(table[side] - rate * x_km[side][:, np.newaxis], axis=0) for side in sides)
        changes.append(float(np.sqrt(np.mean((after - before) ** 2))))
    return min(changes)


class Mistake(StrEnum):
    """What the registry has wrong."""

    REVERSED = "reversed"  # left wheel on the other side than on file
    SWAPPED = "swapped"  # two wheelsets, each under the other's name


@dataclass(frozen=True, slots=True)
class IdentityParameters:
    """When a jump is one, and when it is explained."""

    trusted_std: float = 1.4  # by which published standard deviations are multiplied
    floor: float = 0.004e-3  # m of R, besides
    relative: float = 0.02  # of R: errors of scale that differ from interval to interval
    level: float = 0.01e-3  # m of R, of the level that is left open
    wear_per_1000_km: float = 0.02e-3  # m of R, the most that is usual
    uneven: float = 0.3  # share of wear that differs between the two wheels
    least_jump: float = 2.0  # standard deviations, rms over the bins
    most_left: float = 1.2  # standard deviations that an explanation may leave
    least_gain: float = 2.0  # times less than staying the same leaves
    reach: float = 3.5e-3  # m of lateral displacement that is looked at
    least_bins: int = 8
    least_windows: int = 3


@dataclass(frozen=True, slots=True)
class Observation:
    """The geometry of one wheelset over one mileage interval, as an identity is judged by."""

    wheelset: str
    from_ns: int
    to_ns: int
    mileage_km: float
    geometry: WheelsetGeometry


@dataclass(frozen=True, slots=True)
class IdentityEvent:
    """A jump of a wheelset's geometry with its explanation, between ``before_ns`` and ``after_ns``."""

    wheelset: str
    mistake: Mistake
    partner: str | None  # the other wheelset of a swap
    before_ns: int  # end of the last data before
    after_ns: int  # begin of the first data after
    measured_ns: int  # end of the data that showed it
    jump: float  # standard deviations between before and after
    left: float  # standard deviations that the explanation leaves


@dataclass(frozen=True, slots=True)
class IdentityJump:
    """A wheelset whose geometry jumps, so that it must be compared with those of the others."""

    shown: str  # digest of the geometries in which it jumps


JUMP = ResultKind("identity_jump", SubjectKind.WHEELSET, IdentityJump, history=History.NEWEST)
IDENTITY_EVENT = ResultKind("identity", SubjectKind.WHEELSET, IdentityEvent, history=History.NEWEST)


@dataclass(frozen=True, slots=True)
class _Curve:
    at: FloatArray  # (b,) m
    value: FloatArray  # (b,) m, NaN where not known
    std: FloatArray  # (b,) m


def identity_events(
    histories: Mapping[str, Sequence[Observation]], parameters: IdentityParameters | None = None
) -> dict[str, IdentityEvent]:
    """Return by wheelset the first jump of its geometry that a mistake of the registry explains."""
    p = parameters or IdentityParameters()
    jumps = {serial: jump for serial, seen in histories.items() if (jump := _first_jump(seen, p)) is not None}
    events: dict[str, IdentityEvent] = {}
    for serial, seen in histories.items():
        event = reversed_between(*jumps[serial], p) if serial in jumps else None
        if (event := event or _reversed_in(seen, p)) is not None:
            events[serial] = event
    pairs = (swapped_between(jumps[first], jumps[second], p) for first, second in combinations(sorted(jumps), 2))
    swaps = [swap for swap in pairs if swap is not None]
    for swap in sorted(swaps, key=lambda pair: (max(pair[0].left, pair[1].left), pair[0].wheelset)):
        earlier = [events.get(event.wheelset) for event in swap]
        if all(
            old is None or (old.mistake is not Mistake.SWAPPED and event.left < old.left)
            for event, old in zip(swap, earlier, strict=True)
        ):
            events |= {event.wheelset: event for event in swap}
    return events


def jumps(seen: Sequence[Observation], parameters: IdentityParameters) -> bool:
    """Whether the geometry of a wheelset jumps, so that it must be compared with those of the others."""
    # observations before the last two of which one did not jump need not be looked at again
    return _first_jump(seen, parameters) is not None or _reversed_in(seen, parameters) is not None


def _first_jump(seen: Sequence[Observation], p: IdentityParameters) -> tuple[Observation, Observation] | None:
    usable = [item for item in seen if item.geometry.windows >= p.least_windows]
    for i in range(len(usable) - 1):
        before, next_one = usable[i], usable[i + 1]
        if not _jumps(before, next_one, p):
            continue
        if i + 2 == len(usable):
            return before, next_one
        # the interval in which it happened is a mixture: the next interval shows the geometry after it
        after_next = usable[i + 2]
        return (before, after_next) if _jumps(next_one, after_next, p) else (before, next_one)
    return None


def _jumps(before: Observation, after: Observation, p: IdentityParameters) -> bool:
    worn = _worn(before, after, p)
    whole = _distance(_curve(before), _curve(after), worn, p)
    parts = _even(_curve(before)), _even(_curve(after))
    even = _distance(*parts, p.uneven * worn, p)
    return any(value is not None and value >= p.least_jump for value in (whole, even))


def reversed_between(
    before: Observation, after: Observation, parameters: IdentityParameters | None = None
) -> IdentityEvent | None:
    """Return the event where the curve after is the mirror image of the one before; None where it is not."""
    # only the even part of R decides: the odd part is its own mirror image
    p = parameters or IdentityParameters()
    worn = _worn(before, after, p)
    first, second = _curve(before), _curve(after)
    same = _distance(_even(first), _even(second), p.uneven * worn, p)
    mirrored = _distance(_even(_mirrored(first)), _even(second), p.uneven * worn, p)
    whole = _distance(_mirrored(first), second, worn, p)
    if same is None or mirrored is None or whole is None:
        return None
    left = max(mirrored, whole)
    if same < p.least_jump or left > p.most_left or same < p.least_gain * mirrored:
        return None
    return _event(Mistake.REVERSED, None, (before, after), same, left)


def _reversed_in(seen: Sequence[Observation], p: IdentityParameters) -> IdentityEvent | None:
    """Return the event where the even part has changed its sign, by all of a history; None where it has not."""
    # the intervals have to be on the same bins; what is between the two sides is of neither
    usable = [item for item in seen if item.geometry.windows >= p.least_windows]
    evens = [_even(_curve(item)) for item in usable]
    if not evens or any(len(curve.at) != len(evens[0].at) or not np.allclose(curve.at, evens[0].at) for curve in evens):
        return None
    near = evens[0].at <= p.reach
    whole = np.array([_curve(item).value[_curve(item).at > 0.0] for item in usable])
    even = np.array([curve.value for curve in evens])
    mirrored = newest_mirrored(
        Parts(
            np.array([item.mileage_km for item in usable]),
            np.array([0.5 * (item.from_ns + item.to_ns) for item in usable]),
            even[:, near],
            (whole - even)[:, near],
            np.array([curve.std[near] for curve in evens]),
        )
    )
    if mirrored is None:
        return None
    return _event(Mistake.REVERSED, None, (usable[mirrored.last], usable[mirrored.first]), mirrored.jump, mirrored.left)


def swapped_between(
    first: tuple[Observation, Observation],
    second: tuple[Observation, Observation],
    parameters: IdentityParameters | None = None,
) -> tuple[IdentityEvent, IdentityEvent] | None:
    """Return the events of both where each has after what was the other's before, at one time; None where not so."""
    p = parameters or IdentityParameters()
    if max(first[0].to_ns, second[0].to_ns) > min(first[1].from_ns, second[1].from_ns):
        return None  # one had changed while the other had not yet
    before, after = [_curve(pair[0]) for pair in (first, second)], [_curve(pair[1]) for pair in (first, second)]
    worn = max(_worn(*pair, p) for pair in (first, second))
    stayed = [_distance(before[i], after[i], worn, p) for i in (0, 1)]
    crossed = [_distance(before[1 - i], after[i], worn, p) for i in (0, 1)]
    if None in stayed or None in crossed:
        return None
    jumps = [float(value) for value in stayed if value is not None]
    left = [float(value) for value in crossed if value is not None]
    if min(jumps) < p.least_jump or max(left) > p.most_left or min(jumps) < p.least_gain * max(left):
        return None
    of_first = _event(Mistake.SWAPPED, second[0].wheelset, first, jumps[0], left[0])
    of_second = _event(Mistake.SWAPPED, first[0].wheelset, second, jumps[1], left[1])
    # both at one time: it happened after the last data of either before, and before the first of either after
    begin, end = max(of_first.before_ns, of_second.before_ns), min(of_first.after_ns, of_second.after_ns)
    return (
        replace(of_first, before_ns=min(begin, of_first.after_ns), after_ns=max(end, of_first.before_ns)),
        replace(of_second, before_ns=min(begin, of_second.after_ns), after_ns=max(end, of_second.before_ns)),
    )


def _event(
    mistake: Mistake, partner: str | None, pair: tuple[Observation, Observation], jump: float, left: float
) -> IdentityEvent:
    before, after = pair
    return IdentityEvent(before.wheelset, mistake, partner, before.to_ns, after.from_ns, after.to_ns, jump, left)


def _worn(before: Observation, after: Observation, p: IdentityParameters) -> float:
    return p.wear_per_1000_km * abs(after.mileage_km - before.mileage_km) / 1000.0


def _curve(item: Observation) -> _Curve:
    geometry = item.geometry
    centre = geometry.bin_centres
    values = geometry.rolling_radius_difference
    known = np.isfinite(values.value) & np.isfinite(values.std)
    return _Curve(centre, np.where(known, values.value, np.nan), np.where(known, values.std, np.nan))


def _mirrored(curve: _Curve) -> _Curve:
    return _Curve(curve.at, -_at_other_side(curve, curve.value), _at_other_side(curve, curve.std))


def _even(curve: _Curve) -> _Curve:
    other, other_std = _at_other_side(curve, curve.value), _at_other_side(curve, curve.std)
    right = curve.at > 0.0
    return _Curve(curve.at[right], 0.5 * (curve.value + other)[right], 0.5 * np.hypot(curve.std, other_std)[right])


def _at_other_side(curve: _Curve, values: FloatArray) -> FloatArray:
    return np.interp(-curve.at, curve.at, values, left=np.nan, right=np.nan)


def _distance(first: _Curve, second: _Curve, worn: float, p: IdentityParameters) -> float | None:
    """Return the rms of the difference over its standard deviation; None where too few bins are common."""
    if len(first.at) != len(second.at) or not np.allclose(first.at, second.at):
        return None
    common = np.isfinite(first.value + second.value) & (np.abs(first.at) <= p.reach)
    both_sides = bool((first.at < 0.0).any())
    if np.count_nonzero(common) < (p.least_bins if both_sides else p.least_bins // 2):
        return None
    a, b = first.value[common], second.value[common]
    variance = (
        (p.trusted_std**2) * (first.std[common] ** 2 + second.std[common] ** 2)
        + p.floor**2
        + (p.relative * 0.5 * (a + b)) ** 2
        + worn**2
    )
    # the level is a nuisance with a prior of its own
    weight = 1.0 / variance
    level = float((weight * (b - a)).sum() / (weight.sum() + p.level**-2))
    return float(np.sqrt(np.mean((b - a - level) ** 2 / variance)))
