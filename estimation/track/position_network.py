"""The journeys of a section placed against each other: a network of shifts between pairs, adjusted by least squares.

Journeys cover parts of a section, each with its own error. The mean of all is blurred by these errors, and where few
overlap it is one journey's own. So journeys are compared in pairs: of each pair the lateral displacements, averaged
over the axles, are correlated piece by piece, and each piece gives one equation,

    o_i + c_i u - o_j - c_j u = shift,

with the offset o and the scale error c of both journeys and the distance u from the middle of the section. All pieces
together determine all journeys, up to what is common to those that are connected; equations that contradict the others
lose their weight. What the equations leave open stays near what was reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.track.correlation import clear_peaks, filtered_displacements, mean_displacement
from estimation.track.journeys import Journey, PositionParameters
from estimation.track.passes import Pass
from estimation.track.section_grid import SectionGrid
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.track import Correction

PARTNERS = 16  # journeys that each is compared with
NETWORK_REWEIGHTINGS = 20
LEAST_SPREAD = 0.1  # m, of the shifts about the adjustment
SHIFT_STD = 0.5  # m, of a shift, against:
OFFSET_STD = 20.0  # m, of a reported position
SCALE_STD = 3e-3  # of an odometer


@dataclass(frozen=True, slots=True)
class _Shift:
    """A piece of the first journey agrees with the second one where it is moved by ``shift``."""

    first: int
    second: int
    middle: float  # m, of the piece
    shift: float  # m
    weight: float


@dataclass(frozen=True, slots=True)
class _Extent:
    """Grid points between which a journey has a lateral displacement, and its middle; nowhere where they are equal."""

    first: int
    last: int  # behind the last

    @property
    def middle(self) -> float:
        return 0.5 * (self.first + self.last)

    def shared(self, other: _Extent) -> IntArray:
        """Return the grid points of both."""
        return np.arange(max(self.first, other.first), min(self.last, other.last), dtype=np.int64)


def adjusted_positions(
    grouped: Mapping[Journey, Sequence[Pass]], grid: SectionGrid, parameters: PositionParameters
) -> dict[Journey, Correction]:
    """Return a correction for every journey; one that agrees with no other keeps its place.

    Args:
        grouped: Passes by journey.
        parameters: How far positions may be off.
    """
    signals, extents = [], []
    for members in grouped.values():
        filtered = filtered_displacements(members, grid)
        points = np.concatenate([one.points for one in filtered]) if filtered else np.empty(0, dtype=np.int64)
        signals.append(mean_displacement(filtered, grid))
        extents.append(_Extent(int(points.min()), int(points.max()) + 1) if len(points) else _Extent(0, 0))
    shifts = [
        _Shift(first, second, one.middle, one.shift, one.correlation**2)
        for first, second in _pairs(extents, 4 * int(parameters.largest_offset / grid.step))
        for points in (extents[first].shared(extents[second]),)
        for one in clear_peaks(points, signals[first][points], signals[second], grid, parameters)
    ]
    middle = 0.5 * grid.length
    reported = np.array([one.middle * grid.step - middle for one in extents])
    offset, scale = _adjusted(shifts, reported, middle)
    return {
        journey: Correction(offset=float(offset[i]), scale=float(scale[i]), middle=middle)
        for i, journey in enumerate(grouped)
    }


def _pairs(extents: Sequence[_Extent], least: int) -> list[tuple[int, int]]:
    """Return the pairs of journeys to compare: of each those evenly spread over all that share ``least`` points."""
    pairs = set()
    order = sorted(range(len(extents)), key=lambda i: (extents[i].middle, i))
    for i, own in enumerate(extents):
        others = [j for j in order if j != i and len(own.shared(extents[j])) >= least]
        chosen = {others[round(k)] for k in np.linspace(0, len(others) - 1, PARTNERS)} if others else set()
        pairs |= {(min(i, j), max(i, j)) for j in chosen}
    return sorted(pairs)


def _adjusted(shifts: Sequence[_Shift], reported: FloatArray, middle: float) -> tuple[FloatArray, FloatArray]:
    """Return offset (n,), m, and scale error (n,) of every journey: a fixed number of reweightings.

    ``reported`` is the distance (n,) of the middle of each journey from the middle of the section, m.
    """
    n = len(reported)
    first, second = (np.array([getattr(one, name) for one in shifts], np.int64) for name in ("first", "second"))
    u, lag, known = (np.array([getattr(one, name) for one in shifts]) for name in ("middle", "shift", "weight"))
    columns = np.stack([first, n + first, second, n + second], axis=1).reshape(-1, 4)
    ones = np.ones(len(shifts))
    rows = np.stack([ones, u - middle, -ones, middle - u], axis=1).reshape(-1, 4) / SHIFT_STD
    prior = _prior(reported)
    found: FloatArray = np.zeros(2 * n)
    weights: FloatArray = known
    for _ in range(NETWORK_REWEIGHTINGS):
        normal, right = prior.copy(), np.zeros(2 * n)
        np.add.at(normal, (columns[:, :, None], columns[:, None, :]), weights[:, None, None] * _squares(rows))
        np.add.at(right, columns, (weights * lag / SHIFT_STD)[:, None] * rows)
        found = np.asarray(np.linalg.solve(normal, right))
        left = np.abs(lag - SHIFT_STD * (rows * found[columns]).sum(axis=1))
        spread = 2.0 * max(float(np.median(left)), LEAST_SPREAD) if len(left) else LEAST_SPREAD
        weights = np.asarray(known / (1.0 + (left / spread) ** 2))
    return found[:n], found[n:]


def _squares(rows: FloatArray) -> FloatArray:
    return np.asarray(rows[:, :, None] * rows[:, None, :])


def _prior(reported: FloatArray) -> FloatArray:
    """Return the normal matrix (2n, 2n) of what is known: journeys are near where they reported to be."""
    n = len(reported)
    at = np.concatenate([np.eye(n), np.diag(reported)], axis=1) / OFFSET_STD
    scale = np.concatenate([np.zeros((n, n)), np.eye(n)], axis=1) / SCALE_STD
    return np.asarray(at.T @ at + scale.T @ scale)
