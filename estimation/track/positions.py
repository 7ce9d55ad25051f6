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

from estimation.filters import high_pass
from estimation.track.gridded_pass import Placed, SectionGrid
from estimation.track.panel.basis import Panel, pass_residual
from estimation.track.panel.solution import PanelSolution
from estimation.track.passes import Journey, Pass, PositionParameters, gridded
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.track import Correction


def peak_position(score: FloatArray, k: int) -> float:
    """Return the position, in samples, of the vertex of the parabola through a peak of a score and its neighbours."""
    # the largest one itself is returned at an end, and where the three do not bend downwards
    if not 0 < k < len(score) - 1:
        return float(k)
    before, at, after = score[k - 1 : k + 2]
    bend = before - 2.0 * at + after
    return float(k + (0.5 * (before - after) / bend if bend < 0.0 else 0.0))


@dataclass(frozen=True, slots=True)
class Peak:
    """Where a piece of a signal agrees best with another one."""

    middle: float  # m, of the piece
    shift: float  # m, by which it must be moved
    correlation: float  # there


def filtered_displacements(passes: Sequence[Pass], grid: SectionGrid) -> list[tuple[IntArray, FloatArray]]:
    """Return grid points (m,) and high-passed y (m,), m, of each pass that the filter does not use up."""
    found, m = [], len(grid.kernel) // 2
    for item in passes:
        first, displacement, _ = gridded(item, grid.step)
        if len(displacement) > 2 * m + 1:
            y = high_pass(displacement, grid.kernel)[m:-m]
            points = np.arange(first + m, first + m + len(y), dtype=np.int64)
            inside = grid.contains(points)
            found.append((points[inside], y[inside]))
    return found


def clear_peaks(
    points: IntArray, y: FloatArray, reference: FloatArray, grid: SectionGrid, parameters: PositionParameters
) -> list[Peak]:
    """Return where pieces of a signal (m,) agree with a reference (n,) clearly: over all of it scales may differ."""
    pieces = max(round(len(points) * grid.step / parameters.piece), 1)
    parts = [part for part in np.array_split(np.arange(len(points)), pieces) if len(part)]
    peaks = [peak(points[part], y[part], reference, grid, parameters) for part in parts]
    return [item for item in peaks if item is not None and not item.correlation < parameters.least_correlation]


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
    size = fft.next_fast_len(len(part), real=True)
    products = fft.irfft(fft.rfft(part, size) * np.conj(fft.rfft(y, size)), size)[: len(part) - len(y) + 1]
    energy = np.convolve(part * part, np.ones(len(y)), mode="valid")
    scores = products / np.sqrt(np.maximum(energy, 1e-30) * max(float(y @ y), 1e-30))
    k = int(np.argmax(scores))
    shift = peak_position(scores, k) - reach
    return Peak(0.5 * (points[0] + points[-1]) * grid.step, shift * grid.step, float(scores[k]))


_Extent = tuple[int, int]  # grid points between which a journey has a displacement; nowhere where they are equal


def adjusted_positions(
    grouped: Mapping[Journey, Sequence[Pass]], grid: SectionGrid, parameters: PositionParameters
) -> dict[Journey, Correction]:
    """Return a correction for every journey; one that agrees with no other keeps its place."""
    signals, extents = [], []
    for members in grouped.values():
        total, count = np.zeros(grid.points), np.zeros(grid.points)
        for points, y in filtered_displacements(members, grid):
            total[points] += y
            count[points] += 1.0
        signals.append(total / np.maximum(count, 1.0))
        met = np.flatnonzero(count)
        extents.append((int(met[0]), int(met[-1]) + 1) if len(met) else (0, 0))
    shifts = [
        (first, second, clear_peak)
        for first, second in _pairs(extents, 4 * int(parameters.largest_offset / grid.step), parameters)
        for points in (_shared(extents[first], extents[second]),)
        for clear_peak in clear_peaks(points, signals[first][points], signals[second], grid, parameters)
    ]
    middle = 0.5 * grid.length
    reported = np.array([0.5 * (first + last) * grid.step - middle for first, last in extents])
    offset, scale = _adjusted(shifts, reported, middle, parameters)
    return {
        journey: Correction(offset=float(offset[i]), scale=float(scale[i]), middle=middle)
        for i, journey in enumerate(grouped)
    }


def _shared(first: _Extent, second: _Extent) -> IntArray:
    return np.arange(max(first[0], second[0]), min(first[1], second[1]), dtype=np.int64)


def _pairs(extents: Sequence[_Extent], least: int, parameters: PositionParameters) -> list[tuple[int, int]]:
    pairs = set()
    order = sorted(range(len(extents)), key=lambda i: (0.5 * (extents[i][0] + extents[i][1]), i))
    for i, extent in enumerate(extents):
        others = [j for j in order if j != i and len(_shared(extent, extents[j])) >= least]
        chosen = {others[round(k)] for k in np.linspace(0, len(others) - 1, parameters.partners)} if others else set()
        pairs |= {(min(i, j), max(i, j)) for j in chosen}
    return sorted(pairs)


def _adjusted(
    shifts: Sequence[tuple[int, int, Peak]], reported: FloatArray, middle: float, parameters: PositionParameters
) -> tuple[FloatArray, FloatArray]:
    """Return offset (n,), m, and scale error (n,) of journeys ``reported`` (n,) m from the middle, by shifts."""
    n = len(reported)
    first, second = (np.array([shift[number] for shift in shifts], np.int64) for number in (0, 1))
    u, lag = (np.array([getattr(peak, name) for _, _, peak in shifts]) for name in ("middle", "shift"))
    explained = np.array([peak.correlation**2 for _, _, peak in shifts])
    columns = np.stack([first, n + first, second, n + second], axis=1).reshape(-1, 4)
    ones = np.ones(len(shifts))
    rows = np.stack([ones, u - middle, -ones, middle - u], axis=1).reshape(-1, 4) / parameters.shift_std
    squares = rows[:, :, None] * rows[:, None, :]
    # journeys are near where they report
    place = np.concatenate([np.eye(n), np.diag(reported)], axis=1) / parameters.offset_std
    scale = np.concatenate([np.zeros((n, n)), np.eye(n)], axis=1) / parameters.scale_std
    prior = place.T @ place + scale.T @ scale
    solution: FloatArray = np.zeros(2 * n)
    weights: FloatArray = explained
    for _ in range(parameters.network_reweightings):
        normal, right = prior.copy(), np.zeros(2 * n)
        np.add.at(normal, (columns[:, :, None], columns[:, None, :]), weights[:, None, None] * squares)
        np.add.at(right, columns, (weights * lag / parameters.shift_std)[:, None] * rows)
        solution = np.asarray(np.linalg.solve(normal, right))
        rest = np.abs(lag - parameters.shift_std * (rows * solution[columns]).sum(axis=1))
        spread = 2.0 * max(float(np.median(rest)), parameters.least_spread) if len(rest) else parameters.least_spread
        weights = np.asarray(explained / (1.0 + (rest / spread) ** 2))
    return solution[:n], solution[n:]


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
            clear_peak
            for points, y in filtered_displacements(members, grid)
            for clear_peak in clear_peaks(points, y, alignment, grid, parameters)
        ]
        corrections[journey] = _fitted(Correction(middle=0.5 * grid.length), peaks, parameters)
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
    for journey, where in placed.items():
        correction = where.correction
        normal, right = 1e-12 * np.eye(2), np.zeros(2)
        for item, curve in solution.used(where.passes):
            at = item.used_points
            residual = pass_residual(item, curve, panel)[item.inside] - np.nan_to_num(solution.alignment[at])
            design = np.stack([slope[at], slope[at] * (at * panel.grid.step - correction.middle)]) * certain[at]
            normal += design @ design.T
            right += design @ (residual * certain[at])
        step = np.linalg.solve(normal + np.diag([0.0, 1e-9 * normal[1, 1]]), right)
        better[journey] = correction.moved(*step.tolist())
    if anchored:
        return better
    offset, scale = (float(np.mean([getattr(c, name) for c in better.values()])) for name in ("offset", "scale"))
    return {journey: correction.moved(-offset, -scale) for journey, correction in better.items()}


def register(
    signal: FloatArray, reference: FloatArray, grid: SectionGrid, parameters: PositionParameters
) -> tuple[Correction, float]:
    """Return how a signal (n,) must be moved onto ``reference`` (n,), and the mean correlation of its pieces."""
    pieces = np.array_split(np.arange(grid.points), max(round(grid.length / (2 * parameters.piece)), 1))
    tried = (peak(part, signal[part], reference, grid, parameters) for part in pieces)
    peaks = [item for item in tried if item is not None]
    score = float(np.mean([item.correlation for item in peaks])) if peaks else 0.0
    return _fitted(Correction(middle=0.5 * grid.length), peaks, parameters), score


def compose(first: Correction, second: Correction) -> Correction:
    """Return the correction that does what ``first`` and then ``second`` do, both small."""
    at = first.middle - second.middle
    return replace(first, offset=first.offset + second.offset + second.scale * at, scale=first.scale + second.scale)


def _fitted(correction: Correction, peaks: Sequence[Peak], parameters: PositionParameters) -> Correction:
    if not peaks:
        return correction
    s, lag = np.array([(item.middle, item.shift) for item in peaks]).T
    u = s - correction.middle
    weights = np.ones(len(u))
    line = np.zeros(2)
    for _ in range(parameters.reweightings):
        design = np.stack([weights, weights * u])
        ridge = np.diag([0.0, 1e-6 * float(u @ u) + 1e4])  # a short journey hardly determines its scale
        line = np.linalg.solve(design @ np.stack([np.ones(len(u)), u]).T + ridge, design @ lag)
        error = np.abs(lag - line[0] - line[1] * u)
        weights = 1.0 / (1.0 + (error / max(float(np.median(error)), 0.1)) ** 2)
    return correction.moved(*line.tolist())
