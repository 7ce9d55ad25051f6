"""A window without its blows: what a flat adds once a turn is taken out, and what rings is not used as a sample.

A bridge over every blow would lose a fourth of the motion, and the integrals with it. But a flat strikes alike turn
after turn, while the motion of the wheelset is another each time: the mean over hundreds of turns is the blow. It is
taken out of each, as large as that one was, so that the integrals go through what is left. Samples that clipped are
bridged; they are few.

Blows once a turn of the wheel: a wheel with a flat.

Blows are events on the distance run. Over some seconds the length of a turn is sought at which most of them fall on one
place of the wheel. What a track does cannot: its joints are several turns apart, so most turns have none, and sleepers
are a fifth of a turn apart, so no place of the wheel has most of the blows. A wheel out of round has no blows.

Blows: accelerations of an axle box that rise and fall within some ms, as no wheelset moves.

A wheel with a flat, a joint or a switch strikes the axle box, which rings. The lateral and the roll acceleration show
it by far more than the motion of a wheelset has there; yaw does not, for a wheelset that passes a contact jump turns
as suddenly. What rings is no motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import binary_closing, binary_dilation, median_filter, uniform_filter1d
from scipy.special import betainc

from estimation.values.arrays import BoolArray, FloatArray, IntArray, runs
from estimation.values.units import MAD_PER_STD
from estimation.values.windows import ACCELERATIONS, NO_BLOWS, Hunting, TurnBlows, Window, fast_enough


@dataclass(frozen=True, slots=True)
class BlowParameters:
    """What a blow is, what a flat makes of a turn, and how blows are taken out."""

    motion_mean_s: float = 0.05  # running mean over this is motion
    motion_median_s: float = 0.1  # running median over this is motion even where a blow rings
    scale_s: float = 2.0  # over which vibration is judged
    least_blow_acceleration: float = 8.0  # m/s2 and rad/s2; smooth track stays below 3, flange contact below 6
    least_blow_stds: float = 6.0  # of the vibration
    ringing_share: float = 0.12  # of the largest nearby: what still rings
    ringing_stds: float = 3.0
    ringing_reach_s: float = 0.04  # on both sides of a blow, in which it may ring
    guard_s: float = 0.004  # on both sides of what rings
    block_s: float = 10.0
    least_speed: float = 5.0  # m/s
    known_share: float = 0.5  # share of a block's samples
    least_event_acceleration: float = 4.0  # m/s2 and rad/s2
    event_stds: float = 4.0  # of the vibration
    apart_s: float = 0.02  # what is nearer is one blow
    shortest_turn: float = 1.9  # m, wheels of 0.30 to 0.57 m; less than twice apart, so no turn is half another
    longest_turn: float = 3.6
    turn_places: int = 12  # of a wheel; blows of one flat are in two that are neighbours
    least_turn_share: float = 0.6  # share of the turns that have their blow
    least_event_share: float = 0.35  # share of the blows that are on the place of the wheel
    most_turn_events: float = 4.0  # by turn; more are vibration
    most_chance_count: float = 1e-6  # of as many on one place, over all lengths tried
    turn_tolerance: float = 0.02  # relative, by which blocks of one window may differ
    one_sided_share: float = 0.8  # of the blows have the signs of one wheel
    fewest_turns: float = 12.0
    alternating_share: float = 0.8  # share of the blows that come from the other side than the one before
    longest_bridged_s: float = 0.06
    bridge_support_s: float = 0.05  # on both sides, by which a bridge is drawn
    shape_before_s: float = 0.04  # of a blow, over which it rings
    shape_behind_s: float = 0.08
    most_turn_share: float = 0.8  # where turns are short
    knot_s: float = 0.002  # of the shape of a blow
    fewest_blows: int = 20
    clipped_ridge: float = 1e-3  # of a sample, where all samples of a place clipped
    size_range: tuple[float, float] = (0.3, 3.0)  # of a blow over the mean one
    most_late_s: float = 0.003  # against the turn of the wheel
    shape_rounds: int = 5
    smoothed_blows: int = 31  # blows, over which sizes and delays are alike but for noise


BLOWS = BlowParameters()


def sharp(signals: FloatArray, interval_s: float) -> FloatArray:
    """Return signals (m, n), NaN where not known, less their running mean; there 0."""
    known = np.isfinite(signals)
    width = max(round(BLOWS.motion_mean_s / interval_s), 3) | 1
    filled = np.where(known, signals, 0.0)
    share = uniform_filter1d(known.astype(np.float64), width, axis=1, mode="nearest")
    means = uniform_filter1d(filled, width, axis=1, mode="nearest") / np.maximum(share, 1.0 / width)
    return np.where(known, filled - means, 0.0)


def vibration(sharp_signals: FloatArray, interval_s: float) -> FloatArray:
    """Return the standard deviation (m, n) of what is sharp, blows apart: by the median of some seconds."""
    size = min(max(round(BLOWS.scale_s / interval_s), 1), sharp_signals.shape[1])
    count = max(sharp_signals.shape[1] // size, 1)
    blocks = np.abs(sharp_signals[:, : count * size]).reshape(len(sharp_signals), count, size)
    stds = np.median(blocks, axis=2) / MAD_PER_STD
    block = np.minimum(np.arange(sharp_signals.shape[1]) // size, count - 1)
    return np.asarray(stds[:, block])


def struck(lateral: FloatArray, roll: FloatArray, interval_s: float, lost: BoolArray | None = None) -> BoolArray:
    """Return which samples (n,) a blow has spoilt until it has died down; it rings too near those ``lost`` in blows."""
    both = np.stack([lateral, roll])
    lost = np.zeros(len(lateral), np.bool_) if lost is None else lost
    if not (lost.any() or np.nanmax(np.abs(both), initial=0.0) > BLOWS.least_blow_acceleration):
        return lost
    fast = np.abs(sharp(both, interval_s))
    std = vibration(fast, interval_s)
    spoilt = lost.copy()
    reach = max(round(BLOWS.ringing_reach_s / interval_s), 1)
    for signal, values, noise in zip(both, fast, std, strict=True):
        blows = values > np.maximum(BLOWS.least_blow_acceleration, BLOWS.least_blow_stds * noise)
        if not (blows | lost).any():
            continue
        near = binary_dilation(blows | lost, iterations=reach)
        motion = median_filter(np.nan_to_num(signal), round(BLOWS.motion_median_s / interval_s) | 1)
        rest = np.abs(np.nan_to_num(signal) - motion)
        size = float(np.median(values[blows])) if blows.any() else BLOWS.least_blow_acceleration
        rings = near & (rest > np.maximum(BLOWS.ringing_stds * noise, BLOWS.ringing_share * size))
        spoilt |= binary_closing(rings | blows | lost, iterations=2)
    guard = max(round(BLOWS.guard_s / interval_s), 1)
    return np.asarray(binary_dilation(spoilt, iterations=guard) if spoilt.any() else spoilt)


@dataclass(frozen=True, slots=True)
class _Comb:
    """The turn of a block, and the blows on one place of the wheel."""

    turn: float  # m
    first: float  # m run at one of the blows
    on_place: BoolArray  # (k,) of the events


@dataclass(frozen=True, slots=True)
class _Events:
    middle: FloatArray  # (k,) samples, as fractions: the centre of what is over the vibration
    lateral: FloatArray  # (k,) m/s2, where it is largest
    roll: FloatArray  # (k,) rad/s2, there


@dataclass(frozen=True, slots=True)
class _Block:
    start: int  # first sample
    run: FloatArray  # (n,) m
    events: _Events
    comb: _Comb | None


def blows_unless_hunting(
    hunting: Hunting, lateral: FloatArray, roll: FloatArray, speed: FloatArray, interval_s: float
) -> TurnBlows:
    """Return the blows once a turn, none of a wheelset that hunts: flanges strike at its own wavelength."""
    return NO_BLOWS if hunting.sustained else find_turn_blows(lateral, roll, speed, interval_s)


def find_turn_blows(lateral: FloatArray, roll: FloatArray, speed: FloatArray, interval_s: float) -> TurnBlows:
    """Return for how much of some running time a wheel strikes once a turn, how hard, and which."""
    blocks = list(_blocks(lateral, roll, speed, interval_s))
    striking = [(block.comb, block.events) for block in blocks if block.comb is not None]
    turn = float(np.median([comb.turn for comb, _ in striking])) if striking else 0.0
    alike = [(comb, events) for comb, events in striking if abs(comb.turn / turn - 1.0) <= BLOWS.turn_tolerance]
    if not alike:
        return NO_BLOWS
    lateral, roll = (
        np.concatenate([getattr(events, name)[comb.on_place] for comb, events in alike]) for name in ("lateral", "roll")
    )
    left, right = float(np.mean((roll > 0) & (lateral < 0))), float(np.mean((roll < 0) & (lateral > 0)))
    side = 1 if left >= BLOWS.one_sided_share else -1 if right >= BLOWS.one_sided_share else 0
    size, turn = float(np.median(np.abs(lateral))), float(np.median([comb.turn for comb, _ in alike]))
    return TurnBlows(len(alike) / len(blocks), size, turn, side)


def blow_times(
    lateral: FloatArray, roll: FloatArray, speed: FloatArray, interval_s: float, lost: BoolArray
) -> FloatArray:
    """Return where on the samples (k,) a wheel with a flat strikes each turn; ``lost`` (n,) clipped in blows."""
    times = []
    for block in _blocks(lateral, roll, speed, interval_s, lost):
        if block.comb is not None:
            first = np.ceil((block.run[0] - block.comb.first) / block.comb.turn)
            last = np.floor((block.run[-1] - block.comb.first) / block.comb.turn)
            places = block.comb.first + block.comb.turn * np.arange(first, last + 1.0)
            times.append(block.start + np.interp(places, block.run, np.arange(len(block.run))))
    return np.concatenate(times) if times else np.empty(0)


def _blocks(
    lateral: FloatArray, roll: FloatArray, speed: FloatArray, interval_s: float, lost: BoolArray | None = None
) -> Iterator[_Block]:
    both = np.stack([lateral, roll])
    fast = sharp(both, interval_s)
    std = vibration(fast, interval_s)
    size = round(BLOWS.block_s / interval_s)
    for start in range(0, len(lateral) - size + 1, size):
        part = slice(start, start + size)
        known = np.isfinite(speed[part]) & np.isfinite(lateral[part])
        if known.mean() < BLOWS.known_share or not fast_enough(float(np.mean(speed[part][known])), BLOWS.least_speed):
            continue
        run = np.cumsum(np.nan_to_num(speed[part], nan=float(np.mean(speed[part][known])))) * interval_s
        events = _events(fast[:, part], std[:, part], interval_s, None if lost is None else lost[part])
        comb = _comb(np.interp(events.middle, np.arange(size), run), float(run[-1]))
        if comb is not None:
            blows = events.lateral[comb.on_place]
            if np.mean(blows[1:] * blows[:-1] < 0.0) > BLOWS.alternating_share:  # from either side in turn: flanges
                comb = None
        yield _Block(start, run, events, comb)


def _events(fast: FloatArray, std: FloatArray, interval_s: float, lost: BoolArray | None) -> _Events:
    level = np.maximum(BLOWS.least_event_acceleration, BLOWS.event_stds * std)
    excess = np.max(np.abs(fast) / level, axis=0)
    if lost is not None and lost.any():
        excess = np.where(lost, max(float(excess.max()), 2.0), excess)
    over = np.flatnonzero(excess > 1.0)
    if not len(over):
        none = np.empty(0)
        return _Events(none, none, none)
    first = np.concatenate([[0], np.flatnonzero(np.diff(over) > round(BLOWS.apart_s / interval_s)) + 1])
    groups = np.split(over, first[1:])
    largest = np.array([group[int(np.argmax(excess[group]))] for group in groups], np.int64)
    middle = np.array([np.average(group, weights=excess[group]) for group in groups])
    return _Events(middle, fast[0, largest], fast[1, largest])


def _comb(events: FloatArray, run: float) -> _Comb | None:
    fewest = max(BLOWS.least_turn_share * run / BLOWS.longest_turn, BLOWS.fewest_turns * BLOWS.least_turn_share)
    if not fewest <= len(events) <= BLOWS.most_turn_events * run / BLOWS.shortest_turn:
        return None
    places = BLOWS.turn_places
    step = 0.25 * BLOWS.shortest_turn / (places * run)
    turns = np.exp(np.arange(np.log(BLOWS.shortest_turn), np.log(BLOWS.longest_turn), step))
    place = np.floor(np.mod(events[None, :] / turns[:, None], 1.0) * places).astype(np.int64) % places
    cells = (np.arange(len(turns))[:, None] * places + place).ravel()
    counts = np.bincount(cells, minlength=len(turns) * places).reshape(len(turns), places)
    pairs = counts + np.roll(counts, -1, axis=1)
    best, where = np.unravel_index(int(np.argmax(pairs)), pairs.shape)
    on = (place[best] == where) | (place[best] == (where + 1) % places)
    turn = float(turns[best])
    number = np.round((events[on] - events[on][0]) / turn)
    tries = len(turns) * places
    chance = tries * float(betainc(on.sum(), len(events) - on.sum() + 1, 2.0 / places))
    few_turns = len(np.unique(number)) < BLOWS.least_turn_share * run / turn
    if few_turns or on.sum() < BLOWS.least_event_share * len(events) or chance > BLOWS.most_chance_count:
        return None
    fitted, first = np.polyfit(number, events[on], 1)
    return _Comb(float(fitted), float(first), np.asarray(on))


def without_blows(window: Window) -> Window:
    """Return the window with the blows of a flat taken out; samples that a blow has spoilt are ``bridged``."""
    # blows of joints and switches are single: the integrals go through them as they were measured
    dt, n = window.sample_interval_s, len(window.valid)
    lost = np.zeros(n, np.bool_)
    if window.quality.blows.share > 0.0:
        lost = _short_gaps(window, round(BLOWS.longest_bridged_s / dt))
    spoilt = struck(window.lateral_acceleration, window.roll_acceleration, dt, lost)
    if not spoilt.any():
        return window
    if window.quality.blows.share == 0.0:
        return replace(window, bridged=spoilt & window.valid)
    times = blow_times(window.lateral_acceleration, window.roll_acceleration, window.speed, dt, lost)
    signals = np.stack([getattr(window, name) for name in ACCELERATIONS])
    if len(times) >= BLOWS.fewest_blows:
        signals = signals - turn_blows(signals, times, dt)
    valid = window.valid | lost
    for first, behind in runs(lost):
        _bridge(signals, window.valid, int(first), int(behind), round(BLOWS.bridge_support_s / dt))
    smooth: dict[str, Any] = dict(zip(ACCELERATIONS, signals, strict=True))
    return replace(window, valid=valid, bridged=spoilt & valid, **smooth)


def _short_gaps(window: Window, most: int) -> BoolArray:
    """Return the samples (n,) of gaps inside the window, up to ``most`` long, where speed and place are known."""
    short = np.zeros(len(window.valid), np.bool_)
    for first, behind in runs(~window.valid):
        part = slice(int(first), int(behind))
        inside = first > 0 and behind < len(short) and behind - first <= most
        short[part] = inside and np.isfinite(window.speed[part]).all() and np.isfinite(window.distance[part]).all()
    return short


def _bridge(signals: FloatArray, known: BoolArray, first: int, behind: int, support: int) -> None:
    low = max(first - support, 0)
    beside = low + np.flatnonzero(known[low : behind + support])
    middle, half = 0.5 * (first + behind - 1), 0.5 * (behind - first) + support
    terms = np.polynomial.polynomial.polyvander((beside - middle) / half, 3)
    cubic, *_ = np.linalg.lstsq(terms, signals[:, beside].T, rcond=None)
    inside = np.polynomial.polynomial.polyvander((np.arange(first, behind) - middle) / half, 3)
    signals[:, first:behind] = (inside @ cubic).T


def turn_blows(signals: FloatArray, times: FloatArray, interval_s: float) -> FloatArray:
    """Return what the blows of a flat are of signals (m, n), lateral, yaw and roll acceleration first; NaN: unknown."""
    turn = float(np.median(np.diff(times))) * interval_s
    longest_s = BLOWS.shape_before_s + BLOWS.shape_behind_s
    reach = min(longest_s, BLOWS.most_turn_share * turn) / longest_s
    knots = np.arange(-BLOWS.shape_before_s * reach, BLOWS.shape_behind_s * reach + BLOWS.knot_s, BLOWS.knot_s)
    index = np.arange(signals.shape[1])
    number = np.searchsorted(times, index + BLOWS.shape_before_s * reach / interval_s) - 1
    number = np.clip(number, 0, len(times) - 1)
    since = (index - times[number]) * interval_s
    inside = (since >= knots[0]) & (since < knots[-1]) & np.isfinite(signals).all(axis=0)
    number, since, measured = number[inside], since[inside], signals[:, inside]
    sizes, late = np.ones(len(times)), np.zeros(len(times))
    shapes = np.zeros((len(signals), len(knots)))
    for _ in range(BLOWS.shape_rounds):
        shapes = _shapes(measured, since - late[number], sizes[number], knots)
        sizes, late = _fitted(measured, shapes, since, (sizes, late), number, knots)
    blows = np.zeros_like(signals)
    blows[:, inside] = _valued(shapes, since - late[number], knots) * sizes[number]
    return blows


def _shapes(measured: FloatArray, since: FloatArray, size: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the mean blow (m, k) at the knots, straight between them, by least squares; it begins and ends at zero."""
    place = (since - knots[0]) / BLOWS.knot_s
    low = np.minimum(place.astype(np.int64), len(knots) - 2)
    upper = place - low
    gram = BLOWS.clipped_ridge * np.eye(len(knots))
    right = np.zeros((len(knots), len(measured)))
    for first, weight in ((0, 1.0 - upper), (1, upper)):
        np.add.at(right, low + first, (measured * (weight * size)).T)
        for second, other in ((0, 1.0 - upper), (1, upper)):
            np.add.at(gram, (low + first, low + second), weight * other * size**2)
    shapes = np.linalg.solve(gram, right).T
    edge = max(len(knots) // 12, 1)
    begin, end = shapes[:, :edge].mean(axis=1), shapes[:, -edge:].mean(axis=1)
    return np.asarray(shapes - np.linspace(begin, end, len(knots)).T)


def _valued(shapes: FloatArray, since: FloatArray, knots: FloatArray) -> FloatArray:
    return np.stack([np.interp(since, knots, shape) for shape in shapes])


def _fitted(
    measured: FloatArray,
    shapes: FloatArray,
    since: FloatArray,
    before: tuple[FloatArray, FloatArray],
    number: IntArray,
    knots: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return how large each blow (k,) is over the mean one and how late, s, by its lateral and roll acceleration."""
    sizes, late = before
    struck_axes = [0, 2]  # a blow hardly turns the wheelset
    place = since - late[number]
    mean = _valued(shapes[struck_axes], place, knots)
    slope = -_valued(np.gradient(shapes[struck_axes], BLOWS.knot_s, axis=1), place, knots) * sizes[number]
    rest = measured[struck_axes] - mean * sizes[number]

    def summed(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(number, values.sum(axis=0), len(sizes)), np.float64)

    a, b, c = summed(mean**2), summed(mean * slope), summed(slope**2)
    p, q = summed(mean * rest), summed(slope * rest)
    determinant = np.maximum(a * c - b * b, 1e-9 * np.maximum(a * c, 1e-12))
    noise = float(np.median(rest**2)) / MAD_PER_STD**2
    sizes = np.clip(sizes + (c * p - b * q) / determinant, *BLOWS.size_range)
    late = np.clip(late + (a * q - b * p) / determinant, -BLOWS.most_late_s, BLOWS.most_late_s)
    sizes, late = _shrunk(sizes, noise * c / determinant), _shrunk(late, noise * a / determinant)
    return sizes / np.median(sizes), late - np.median(late)


def _shrunk(values: FloatArray, variance: FloatArray) -> FloatArray:
    usual = uniform_filter1d(values, BLOWS.smoothed_blows, mode="nearest")
    apart = values - usual
    true = max(float(np.median(apart**2)) / MAD_PER_STD**2 - float(np.median(variance)), 0.0)
    return np.asarray(usual + apart * true / np.maximum(true + variance, 1e-30))
