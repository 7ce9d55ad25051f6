"""A window without its blows: what a flat adds once a turn is taken out, and what rings is not used as a sample.

A bridge over every blow would lose a fourth of the motion, and the integrals with it. But a flat strikes alike turn
after turn, while the motion of the wheelset is another each time: the mean over hundreds of turns is the blow. It is
taken out of each, as large as that one was, so that the integrals go through what is left. Samples that clipped are
bridged; they are few.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from estimation.motion.blows import SAID_BY_MEDIAN, struck
from estimation.motion.turn_blows import blow_times
from estimation.values.arrays import BoolArray, FloatArray, IntArray, runs
from estimation.values.windows import ACCELERATIONS, Window

LONGEST_BRIDGED_S = 0.06
SUPPORT_S = 0.05  # on both sides, by which a bridge is drawn
BEFORE_S, BEHIND_S = 0.04, 0.08  # of a blow, over which it rings
MOST_OF_TURN = 0.8  # where turns are short
KNOT_S = 0.002  # of the shape of a blow
FEWEST_BLOWS = 20
RIDGE = 1e-3  # of a sample, where all samples of a place clipped
SIZES = (0.3, 3.0)  # of a blow over the mean one
MOST_LATE_S = 0.003  # against the turn of the wheel
ROUNDS = 5
AROUND = 31  # blows, over which sizes and delays are alike but for noise


def without_blows(window: Window) -> Window:
    """Return the window with the blows of a flat taken out; samples that a blow has spoilt are ``bridged``.

    Blows of joints and switches are single: the integrals go through them as they were measured.
    """
    dt, n = window.sample_interval_s, len(window.valid)
    lost = np.zeros(n, np.bool_)
    if window.quality.blows.share > 0.0:
        lost = _short_gaps(window, round(LONGEST_BRIDGED_S / dt))
    spoilt = struck(window.lateral_acceleration, window.roll_acceleration, dt, lost)
    if not spoilt.any():
        return window
    if window.quality.blows.share == 0.0:
        return replace(window, bridged=spoilt & window.valid)
    at = blow_times(window.lateral_acceleration, window.roll_acceleration, window.speed, dt, lost)
    signals = np.stack([getattr(window, name) for name in ACCELERATIONS])
    if len(at) >= FEWEST_BLOWS:
        signals = signals - turn_blows(signals, at, dt)
    valid = window.valid | lost
    for first, behind in runs(lost):
        _bridge(signals, window.valid, int(first), int(behind), round(SUPPORT_S / dt))
    smooth: dict[str, Any] = dict(zip(ACCELERATIONS, signals, strict=True))
    return replace(window, valid=valid, bridged=spoilt & valid, **smooth)


def _short_gaps(window: Window, most: int) -> BoolArray:
    """Return the samples (n,) of gaps inside the window, up to ``most`` long, where speed and place are known."""
    found = np.zeros(len(window.valid), np.bool_)
    for first, behind in runs(~window.valid):
        part = slice(int(first), int(behind))
        inside = first > 0 and behind < len(found) and behind - first <= most
        found[part] = inside and np.isfinite(window.speed[part]).all() and np.isfinite(window.distance[part]).all()
    return found


def _bridge(signals: FloatArray, known: BoolArray, first: int, behind: int, support: int) -> None:
    """Put the cubic of least squares through what is near in place of a gap of signals (m, n)."""
    low = max(first - support, 0)
    at = low + np.flatnonzero(known[low : behind + support])
    middle, half = 0.5 * (first + behind - 1), 0.5 * (behind - first) + support
    terms = np.polynomial.polynomial.polyvander((at - middle) / half, 3)
    found, *_ = np.linalg.lstsq(terms, signals[:, at].T, rcond=None)
    inside = np.polynomial.polynomial.polyvander((np.arange(first, behind) - middle) / half, 3)
    signals[:, first:behind] = (inside @ found).T


def turn_blows(signals: FloatArray, at: FloatArray, interval_s: float) -> FloatArray:
    """Return what the blows of a flat are of signals (m, n).

    Args:
        signals: (m, n) lateral, yaw and roll acceleration first; NaN where not known.
        at: (k,) where on the samples they are, increasing.
    """
    turn = float(np.median(np.diff(at))) * interval_s
    reach = min(BEFORE_S + BEHIND_S, MOST_OF_TURN * turn) / (BEFORE_S + BEHIND_S)
    knots = np.arange(-BEFORE_S * reach, BEHIND_S * reach + KNOT_S, KNOT_S)
    index = np.arange(signals.shape[1])
    number = np.clip(np.searchsorted(at, index + BEFORE_S * reach / interval_s) - 1, 0, len(at) - 1)
    since = (index - at[number]) * interval_s
    inside = (since >= knots[0]) & (since < knots[-1]) & np.isfinite(signals).all(axis=0)
    number, since, measured = number[inside], since[inside], signals[:, inside]
    sizes, late = np.ones(len(at)), np.zeros(len(at))
    shapes = np.zeros((len(signals), len(knots)))
    for _ in range(ROUNDS):
        shapes = _shapes(measured, since - late[number], sizes[number], knots)
        sizes, late = _fitted(measured, shapes, since, (sizes, late), number, knots)
    found = np.zeros_like(signals)
    found[:, inside] = _valued(shapes, since - late[number], knots) * sizes[number]
    return found


def _shapes(measured: FloatArray, since: FloatArray, size: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the mean blow (m, k) at the knots, straight between them, by least squares; it begins and ends at zero."""
    place = (since - knots[0]) / KNOT_S
    low = np.minimum(place.astype(np.int64), len(knots) - 2)
    upper = place - low
    gram = RIDGE * np.eye(len(knots))
    right = np.zeros((len(knots), len(measured)))
    for first, weight in ((0, 1.0 - upper), (1, upper)):
        np.add.at(right, low + first, (measured * (weight * size)).T)
        for second, other in ((0, 1.0 - upper), (1, upper)):
            np.add.at(gram, (low + first, low + second), weight * other * size**2)
    found = np.linalg.solve(gram, right).T
    edge = max(len(knots) // 12, 1)
    begin, end = found[:, :edge].mean(axis=1), found[:, -edge:].mean(axis=1)
    return np.asarray(found - np.linspace(begin, end, len(knots)).T)


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
    felt = [0, 2]
    at = since - late[number]
    mean = _valued(shapes[felt], at, knots)
    slope = -_valued(np.gradient(shapes[felt], KNOT_S, axis=1), at, knots) * sizes[number]
    rest = measured[felt] - mean * sizes[number]

    def summed(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(number, values.sum(axis=0), len(sizes)), np.float64)

    a, b, c = summed(mean**2), summed(mean * slope), summed(slope**2)
    p, q = summed(mean * rest), summed(slope * rest)
    determinant = np.maximum(a * c - b * b, 1e-9 * np.maximum(a * c, 1e-12))
    noise = float(np.median(rest**2)) / SAID_BY_MEDIAN**2
    sizes = np.clip(sizes + (c * p - b * q) / determinant, *SIZES)
    late = np.clip(late + (a * q - b * p) / determinant, -MOST_LATE_S, MOST_LATE_S)
    sizes, late = _shrunk(sizes, noise * c / determinant), _shrunk(late, noise * a / determinant)
    return sizes / np.median(sizes), late - np.median(late)


def _shrunk(values: FloatArray, variance: FloatArray) -> FloatArray:
    """Return what is drawn towards that of the blows around by as much as the noise explains of what differs."""
    usual = uniform_filter1d(values, AROUND, mode="nearest")
    apart = values - usual
    true = max(float(np.median(apart**2)) / SAID_BY_MEDIAN**2 - float(np.median(variance)), 0.0)
    return np.asarray(usual + apart * true / np.maximum(true + variance, 1e-30))
