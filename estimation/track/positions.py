"""Passes put where they were: odometer offsets and scale errors found from what the passes have in common.

Each journey (the windows of one vehicle on one run over the section) is shifted and stretched until its lateral
displacement agrees with those of the others: first by correlation, then by least squares on the slope of the alignment
that the panel has found. Where the whole fleet is is not observable: the mean journey keeps its place.

The mean of all is blurred by the errors of each, so journeys are compared in pairs, piece by piece, and each piece
gives one equation,

    o_i + c_i u - o_j - c_j u = shift,

with the offset o and the scale error c of both journeys and the distance u from the middle of the section. All pieces
together determine all journeys; equations that contradict the others lose their weight. What the equations leave open
stays near what was reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from estimation.filters.local_cubic import high_pass
from estimation.track.gridded_pass import Placed, SectionGrid
from estimation.track.panel.basis import Panel, pass_residual
from estimation.track.panel.solution import PanelSolution
from estimation.track.passes import Journey, Pass, PositionParameters, gridded
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.track import Correction


def peak_position(score: FloatArray, k: int) -> float:
    """Return the position, in samples, of the vertex of the parabola through a peak of a score and its neighbours.

    The largest one itself is returned at an end, and where the three do not bend downwards.
    """
    if not 0 < k < len(score) - 1:
        return float(k)
    before, at, after = score[k - 1 : k + 2]
    bend = before - 2.0 * at + after
    return float(k + (0.5 * (before - after) / bend if bend < 0.0 else 0.0))


@dataclass(frozen=True, slots=True)
class FilteredDisplacement:
    """High-passed y of a pass at the grid points on the section that the filter reaches."""

    points: IntArray  # (m,)
    displacement: FloatArray  # (m,) m


@dataclass(frozen=True, slots=True)
class Peak:
    """Where a piece of a signal agrees best with another one."""

    middle: float  # m, of the piece
    shift: float  # m, by which it must be moved
    correlation: float  # there


def filtered_displacements(passes: Sequence[Pass], grid: SectionGrid) -> list[FilteredDisplacement]:
    """Return the high-passed lateral displacements of passes; empty ones of passes that the filter uses up."""
    found, m = [], len(grid.kernel) // 2
    for item in passes:
        first, displacement, _ = gridded(item, grid.step)
        if len(displacement) <= 2 * m + 1:
            found.append(FilteredDisplacement(np.empty(0, dtype=np.int64), np.empty(0)))
            continue
        y = high_pass(displacement, grid.kernel)[m:-m]
        points = np.arange(first + m, first + m + len(y), dtype=np.int64)
        inside = grid.contains(points)
        found.append(FilteredDisplacement(points[inside], y[inside]))
    return found


def mean_displacement(filtered: Sequence[FilteredDisplacement], grid: SectionGrid) -> FloatArray:
    """Return the mean filtered y (n,), m, over all passes; zero where there is none."""
    total, count = np.zeros(grid.points), np.zeros(grid.points)
    for one in filtered:
        np.add.at(total, one.points, one.displacement)
        np.add.at(count, one.points, 1.0)
    return np.asarray(total / np.maximum(count, 1.0))


def clear_peaks(
    points: IntArray, y: FloatArray, reference: FloatArray, grid: SectionGrid, parameters: PositionParameters
) -> list[Peak]:
    """Return the peaks of the pieces of a signal (m,) that agree with a reference (n,) on the grid clearly.

    In pieces, because over a long pass an error of the scale moves the two ends against each other.
    """
    pieces = max(round(len(points) * grid.step / parameters.piece), 1)
    parts = [part for part in np.array_split(np.arange(len(points)), pieces) if len(part)]
    peaks = [peak(points[part], y[part], reference, grid, parameters) for part in parts]
    return [one for one in peaks if one is not None and not one.correlation < parameters.least_correlation]


def peak(
    points: IntArray, y: FloatArray, reference: FloatArray, grid: SectionGrid, parameters: PositionParameters
) -> Peak | None:
    """Return where a piece (m,) of a signal agrees best with a reference (n,); None where the piece is too short."""
    reach = int(parameters.largest_offset / grid.step)
    if len(points) < 4 * reach:
        return None
    low, high = points[0] - reach, points[-1] + reach + 1
    padded = np.pad(reference, (max(-low, 0), max(high - grid.points, 0)))
    base = max(-low, 0)
    part = padded[low + base : high + base]
    products = _sliding_products(part, y)
    energy = np.convolve(part * part, np.ones(len(y)), mode="valid")
    scores = products / np.sqrt(np.maximum(energy, 1e-30) * max(float(y @ y), 1e-30))
    k = int(np.argmax(scores))
    shift = peak_position(scores, k) - reach
    return Peak(0.5 * (points[0] + points[-1]) * grid.step, shift * grid.step, float(scores[k]))


def _sliding_products(longer: FloatArray, shorter: FloatArray) -> FloatArray:
    """Return the sum of products of the shorter with the longer, from each place at which it fits."""
    size = fft.next_fast_len(len(longer), real=True)
    products = fft.irfft(fft.rfft(longer, size) * np.conj(fft.rfft(shorter, size)), size)
    return np.asarray(products[: len(longer) - len(shorter) + 1])


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
    """Return a correction for every journey; one that agrees with no other keeps its place."""
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


REWEIGHTINGS = 10  # of the line through the lags


def correlate_positions(
    grouped: Mapping[Journey, Sequence[Pass]],
    grid: SectionGrid,
    parameters: PositionParameters,
    alignment: FloatArray | None = None,
) -> dict[Journey, Correction]:
    """Return a correction for every journey from the correlation of lateral displacements.

    Journeys are placed by a known alignment (n,), m, and without one by each other; one that agrees with nothing keeps
    its place.
    """
    if alignment is None:
        return adjusted_positions(grouped, grid, parameters)
    corrections = {}
    for journey, members in grouped.items():
        peaks = [
            one
            for each in filtered_displacements(members, grid)
            for one in clear_peaks(each.points, each.displacement, alignment, grid, parameters)
        ]
        corrections[journey] = _fitted(Correction(middle=0.5 * grid.length), peaks)
    return corrections


def refine(
    placed: Placed, solution: PanelSolution, panel: Panel, *, anchored: bool = False
) -> dict[Journey, Correction]:
    """Return better corrections: one Gauss-Newton step on y - d - h(R) = d' (offset + scale (s - middle)).

    The mean journey keeps its place, unless the alignment is ``anchored``: it holds prior knowledge of positions.
    """
    slope = np.gradient(np.nan_to_num(solution.alignment), panel.grid.step)
    certain = np.isfinite(solution.alignment)
    better = {}
    for journey, one in placed.items():
        correction = one.correction
        normal, right = 1e-12 * np.eye(2), np.zeros(2)
        for item in one.passes:
            curve = solution.curve_of(item.life)
            if item.empty or curve is None:
                continue
            at, own = item.used_points, pass_residual(item, curve, panel)[item.inside]
            residual = (own - np.nan_to_num(solution.alignment[at])) * certain[at]
            design = np.stack([slope[at], slope[at] * (at * panel.grid.step - correction.middle)]) * certain[at]
            normal += design @ design.T
            right += design @ residual
        step = np.linalg.solve(normal + np.diag([0.0, 1e-9 * normal[1, 1]]), right)
        better[journey] = replace(
            correction, offset=correction.offset + float(step[0]), scale=correction.scale + float(step[1])
        )
    return better if anchored else _centred(better)


def register(
    found: FloatArray, reference: FloatArray, grid: SectionGrid, parameters: PositionParameters
) -> tuple[Correction, float]:
    """Return how ``found`` (n,) must be moved onto ``reference`` (n,), and the mean correlation of its pieces."""
    pieces = np.array_split(np.arange(grid.points), max(round(grid.length / (2 * parameters.piece)), 1))
    peaks = [peak(part, found[part], reference, grid, parameters) for part in pieces]
    known = [one for one in peaks if one is not None]
    if not known:
        return Correction(middle=0.5 * grid.length), 0.0
    score = float(np.mean([one.correlation for one in known]))
    return _fitted(Correction(middle=0.5 * grid.length), known), score


def compose(first: Correction, second: Correction) -> Correction:
    """Return the correction that does what ``first`` and then ``second`` do, both small."""
    at = first.middle - second.middle
    return replace(first, offset=first.offset + second.offset + second.scale * at, scale=first.scale + second.scale)


def _fitted(correction: Correction, peaks: Sequence[Peak]) -> Correction:
    """Return the correction with a robust straight line through the shifts added: a fixed number of reweightings."""
    if not peaks:
        return correction
    s, lag = np.array([(one.middle, one.shift) for one in peaks]).T
    u = s - correction.middle
    weights = np.ones(len(u))
    line = np.zeros(2)
    for _ in range(REWEIGHTINGS):
        design = np.stack([weights, weights * u])
        ridge = np.diag([0.0, 1e-6 * float(u @ u) + 1e4])  # a short journey hardly determines its scale
        line = np.linalg.solve(design @ np.stack([np.ones(len(u)), u]).T + ridge, design @ lag)
        error = np.abs(lag - line[0] - line[1] * u)
        weights = 1.0 / (1.0 + (error / max(float(np.median(error)), 0.1)) ** 2)
    return replace(correction, offset=correction.offset + float(line[0]), scale=correction.scale + float(line[1]))


def _centred(corrections: Mapping[Journey, Correction]) -> dict[Journey, Correction]:
    offset = float(np.mean([c.offset for c in corrections.values()]))
    scale = float(np.mean([c.scale for c in corrections.values()]))
    return {j: replace(c, offset=c.offset - offset, scale=c.scale - scale) for j, c in corrections.items()}
