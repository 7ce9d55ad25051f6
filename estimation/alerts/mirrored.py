"""Has a wheelset been turned end for end, by its whole history? The even part of its curve then changes its sign.

From one interval to the next a curve differs by no more than its standard deviations where these are large, although
most of what they hold is common to all intervals of a wheelset. Over a history the noise is known: the even parts are
one pattern of changing size, which wears slowly, and a wheelset that was turned has the same size with the other sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.trend.change_point import BESIDE, Series, StepModel, newest_change
from estimation.values.arrays import FloatArray

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
SAME_SIZE = 0.25  # of the step, by which the size may differ but for its sign
COMMON = 2.0  # published standard deviations besides, of what all intervals have in common
KEPT = 0.35  # of the change of the even part, that the odd part may change by: it is its own mirror image
LEAST_BINS = 4


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
    """Return the newest change of sign since the last known event; None where there is none."""
    bins = np.isfinite(parts.even).mean(axis=0) >= 1.0 - SAME_SIZE
    whole = np.flatnonzero(np.isfinite(parts.even[:, bins]).all(axis=1))
    if bins.sum() < LEAST_BINS or len(whole) < 2 * EVEN.least_points:
        return None
    even, odd, std = (1e3 * table[whole][:, bins] for table in (parts.even, parts.odd, parts.std))
    even = even - even.mean(axis=1, keepdims=True)  # a band-passed signal leaves the level open
    size, error = _sizes(even, std)
    x_km = parts.x_km[whole]
    found = newest_change(Series(x_km, parts.t_ns[whole], size, error), EVEN)
    if found is None:
        return None
    sides = slice(max(0, found.last + 1 - BESIDE), found.last + 1), slice(found.first, found.first + BESIDE)
    before, after = (float(np.median(size[side])) for side in sides)
    odd_change, even_change = (_change(table, x_km, sides) for table in (odd, even))
    unlike, common = abs(after + before), float(np.median(error))
    if odd_change > KEPT * even_change or unlike > SAME_SIZE * abs(found.size) + COMMON * common:
        return None
    left = unlike / float(np.hypot(found.std, COMMON * common))
    return Mirrored(int(whole[found.last]), int(whole[found.first]), abs(found.size) / found.std, left)


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
