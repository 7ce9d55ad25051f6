"""Blows once a turn of the wheel: a wheel with a flat.

Blows are events on the distance run. Over some seconds the length of a turn is sought at which most of them fall on one
place of the wheel. What a track does cannot: its joints are several turns apart, so most turns have none, and sleepers
are a fifth of a turn apart, so no place of the wheel has most of the blows. A wheel out of round has no blows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import betainc

from estimation.motion.blows import sharp, vibration
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.windows import NO_BLOWS, Hunting, TurnBlows

BLOCK_S = 10.0
LEAST_SPEED = 5.0  # m/s
LEAST_KNOWN = 0.5  # share of a block's samples
LEAST_EVENT = 4.0  # m/s2 and rad/s2
EVENT_STDS = 4.0  # of the vibration
APART_S = 0.02  # what is nearer is one blow
SHORTEST, LONGEST = 1.9, 3.6  # m, turns of wheels of 0.30 to 0.57 m; less than twice apart, so no turn is half another
PLACES = 12  # of a wheel; blows of one flat are in two that are neighbours
LEAST_TURNS = 0.6  # share of the turns that have their blow
LEAST_EVENTS = 0.35  # share of the blows that are on the place of the wheel
MOST_EVENTS = 4.0  # by turn; more are vibration
MOST_CHANCE = 1e-6  # of as many on one place, over all lengths tried
SAME_TURN = 0.02  # relative, by which blocks of one window may differ
SIDED = 0.8  # of the blows have the signs of one wheel
FEWEST_TURNS = 12.0
MOST_ALTERNATING = 0.8  # share of the blows that come from the other side than the one before


@dataclass(frozen=True, slots=True)
class _Comb:
    """The turn of a block, and the blows on one place of the wheel."""

    turn: float  # m
    first: float  # m run at one of the blows
    on_place: BoolArray  # (k,) of the events


@dataclass(frozen=True, slots=True)
class _Events:
    """Blows of a block, of whatever."""

    middle: FloatArray  # (k,) samples, as fractions: the centre of what is over the vibration
    lateral: FloatArray  # (k,) m/s2, where it is largest
    roll: FloatArray  # (k,) rad/s2, there


@dataclass(frozen=True, slots=True)
class _Block:
    """Some seconds of running."""

    start: int  # first sample
    run: FloatArray  # (n,) m
    events: _Events
    comb: _Comb | None


def blows_unless_hunting(
    hunting: Hunting, lateral: FloatArray, roll: FloatArray, speed: FloatArray, interval_s: float
) -> TurnBlows:
    """Return the blows once a turn, none of a wheelset that hunts: flanges strike at its own wavelength.

    Args:
        hunting: Of the same running time.
    """
    return NO_BLOWS if hunting.sustained else find_turn_blows(lateral, roll, speed, interval_s)


def find_turn_blows(lateral: FloatArray, roll: FloatArray, speed: FloatArray, interval_s: float) -> TurnBlows:
    """Return for how much of some running time a wheel strikes once a turn, how hard, and which.

    Args:
        lateral, roll: (n,) m/s2 and rad/s2, as the sensors gave them, clipped samples too; NaN where nothing is known.
        speed: (n,) m/s; NaN where not known.
    """
    running, found = 0, []
    for block in _blocks(lateral, roll, speed, interval_s):
        running += 1
        if block.comb is not None:
            found.append((block.comb.turn, block.events, block.comb.on_place))
    return _combined(found, running)


def blow_times(
    lateral: FloatArray, roll: FloatArray, speed: FloatArray, interval_s: float, lost: BoolArray
) -> FloatArray:
    """Return where on the samples (k,) a wheel with a flat strikes, as fractions of samples; every turn has its blow.

    Args:
        lost: (n,) samples that clipped in blows.
    """
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
    """Yield the blocks in which the vehicle runs."""
    both = np.stack([lateral, roll])
    fast = sharp(both, interval_s)
    std = vibration(fast, interval_s)
    size = round(BLOCK_S / interval_s)
    for start in range(0, len(lateral) - size + 1, size):
        part = slice(start, start + size)
        known = np.isfinite(speed[part]) & np.isfinite(lateral[part])
        if known.mean() < LEAST_KNOWN or np.mean(speed[part][known]) < LEAST_SPEED:
            continue
        run = np.cumsum(np.nan_to_num(speed[part], nan=float(np.mean(speed[part][known])))) * interval_s
        events = _events(fast[:, part], std[:, part], interval_s, None if lost is None else lost[part])
        comb = _comb(np.interp(events.middle, np.arange(size), run), float(run[-1]))
        yield _Block(start, run, events, None if comb is None or _alternates(events.lateral[comb.on_place]) else comb)


def _alternates(lateral: FloatArray) -> bool:
    """Return whether blows (k,) come from either side in turn, as those of flanges."""
    return bool(np.mean(lateral[1:] * lateral[:-1] < 0.0) > MOST_ALTERNATING)


def _combined(found: list[tuple[float, _Events, BoolArray]], running: int) -> TurnBlows:
    if not found:
        return NO_BLOWS
    turn = float(np.median([one[0] for one in found]))
    alike = [one for one in found if abs(one[0] / turn - 1.0) <= SAME_TURN]
    if not alike:
        return NO_BLOWS
    lateral = np.concatenate([events.lateral[on] for _, events, on in alike])
    roll = np.concatenate([events.roll[on] for _, events, on in alike])
    left, right = float(np.mean((roll > 0) & (lateral < 0))), float(np.mean((roll < 0) & (lateral > 0)))
    side = 1 if left >= SIDED else -1 if right >= SIDED else 0
    size = float(np.median(np.abs(lateral)))
    return TurnBlows(len(alike) / running, size, float(np.median([one[0] for one in alike])), side)


def _events(fast: FloatArray, std: FloatArray, interval_s: float, lost: BoolArray | None) -> _Events:
    """Return the blows of a block."""
    level = np.maximum(LEAST_EVENT, EVENT_STDS * std)
    excess = np.max(np.abs(fast) / level, axis=0)
    if lost is not None and lost.any():
        excess = np.where(lost, max(float(excess.max()), 2.0), excess)
    over = np.flatnonzero(excess > 1.0)
    if not len(over):
        none = np.empty(0)
        return _Events(none, none, none)
    first = np.concatenate([[0], np.flatnonzero(np.diff(over) > round(APART_S / interval_s)) + 1])
    groups = np.split(over, first[1:])
    at = np.array([group[int(np.argmax(excess[group]))] for group in groups], np.int64)
    middle = np.array([np.average(group, weights=excess[group]) for group in groups])
    return _Events(middle, fast[0, at], fast[1, at])


def _comb(events: FloatArray, run: float) -> _Comb | None:
    """Return the turn at which most events (k,), at m run of ``run``, are on one place of a wheel."""
    fewest = max(LEAST_TURNS * run / LONGEST, FEWEST_TURNS * LEAST_TURNS)
    if not fewest <= len(events) <= MOST_EVENTS * run / SHORTEST:
        return None
    step = 0.25 * SHORTEST / (PLACES * run)
    turns = np.exp(np.arange(np.log(SHORTEST), np.log(LONGEST), step))
    place = np.floor(np.mod(events[None, :] / turns[:, None], 1.0) * PLACES).astype(np.int64) % PLACES
    cells = (np.arange(len(turns))[:, None] * PLACES + place).ravel()
    counts = np.bincount(cells, minlength=len(turns) * PLACES).reshape(len(turns), PLACES)
    pairs = counts + np.roll(counts, -1, axis=1)
    best, where = np.unravel_index(int(np.argmax(pairs)), pairs.shape)
    on = (place[best] == where) | (place[best] == (where + 1) % PLACES)
    turn = float(turns[best])
    hit = np.unique(np.round((events[on] - events[on][0]) / turn))
    tries = len(turns) * PLACES
    chance = tries * float(betainc(on.sum(), len(events) - on.sum() + 1, 2.0 / PLACES))
    if len(hit) < LEAST_TURNS * run / turn or on.sum() < LEAST_EVENTS * len(events) or chance > MOST_CHANCE:
        return None
    number = np.round((events[on] - events[on][0]) / turn)
    fitted, first = np.polyfit(number, events[on], 1)
    return _Comb(float(fitted), float(first), np.asarray(on))
