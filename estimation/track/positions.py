"""Passes put where they were: odometer offsets and scale errors found from what the passes have in common.

The motion of every wheelset at a place is mostly that of the track. So each journey (the windows of one vehicle on one
run over the section) is shifted and stretched until its lateral displacement agrees with the mean of the others: first
by correlation, then by least squares on the slope of the alignment that the panel has found. Where the whole fleet is
is not observable: the mean journey keeps its place.

A worn and a new wheelset answer the track with different lags, so the offset of a journey and the slope of its
wheelsets' curves trade off; a vehicle whose wheelsets differ in wear separates them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from estimation.filters.local_cubic import high_pass
from estimation.filters.peak import peak_position
from estimation.track.gridded_pass import Placed
from estimation.track.journeys import Journey, PositionParameters, apply_correction
from estimation.track.panel.basis import Panel, pass_residual
from estimation.track.panel.solution import PanelSolution
from estimation.track.passes import Pass, gridded
from estimation.track.section_grid import SectionGrid
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.track import Correction

REWEIGHTINGS = 10  # of the line through the lags


def correlate_positions(
    grouped: Mapping[Journey, Sequence[Pass]],
    grid: SectionGrid,
    parameters: PositionParameters,
    alignment: FloatArray | None = None,
) -> dict[Journey, Correction]:
    """Return a correction for every journey from the correlation of lateral displacements.

    The longest journey is the first reference; then, twice, the mean of all: a fixed number of rounds, for what is
    left moves with the panel until it converges. A journey that agrees with nothing keeps its place.

    Parameters
    ----------
    grouped
        Passes by journey.
    grid
        Of the section.
    parameters
        How far positions may be off.
    alignment
        (n,) m, as known: it is the reference instead, and the fleet as a whole is moved to it. None by default.
    """
    corrections = {journey: Correction(middle=0.5 * grid.length) for journey in grouped}
    filtered = {journey: _filtered_displacements(members, grid) for journey, members in grouped.items()}
    if alignment is not None:
        return {
            journey: _fitted(corrections[journey], _lags(filtered[journey], alignment, grid, parameters))
            for journey in grouped
        }
    first = max(grouped, key=lambda journey: sum(item.at[-1] - item.at[0] for item in grouped[journey]))
    reference = _mean_displacement(filtered[first], grid)
    for last in (False, False, True):
        corrections = _centred(
            {
                journey: _fitted(corrections[journey], _lags(filtered[journey], reference, grid, parameters))
                for journey in grouped
            }
        )
        if not last:
            filtered = {
                journey: _filtered_displacements(apply_correction(members, corrections[journey]), grid)
                for journey, members in grouped.items()
            }
            reference = _mean_displacement([one for journey in grouped for one in filtered[journey]], grid)
    return corrections


def refine(
    placed: Placed, solution: PanelSolution, panel: Panel, *, anchored: bool = False
) -> dict[Journey, Correction]:
    """Return better corrections: one Gauss-Newton step on y - d - h(R) = d' (offset + scale (s - middle)).

    Parameters
    ----------
    placed
        Passes at their corrections so far.
    solution, panel
        As solved.
    anchored
        Whether the alignment holds prior knowledge of positions; else the mean journey keeps its place.
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


@dataclass(frozen=True, slots=True)
class _FilteredDisplacement:
    """High-passed y of a pass at the grid points on the section that the filter reaches."""

    points: IntArray  # (m,)
    displacement: FloatArray  # (m,) m


def _filtered_displacements(passes: Sequence[Pass], grid: SectionGrid) -> list[_FilteredDisplacement]:
    found, m = [], len(grid.kernel) // 2
    for item in passes:
        first, displacement, _ = gridded(item, grid.step)
        if len(displacement) <= 2 * m + 1:
            found.append(_FilteredDisplacement(np.empty(0, dtype=np.int64), np.empty(0)))
            continue
        y = high_pass(displacement, grid.kernel)[m:-m]
        points = np.arange(first + m, first + m + len(y), dtype=np.int64)
        inside = grid.contains(points)
        found.append(_FilteredDisplacement(points[inside], y[inside]))
    return found


def _mean_displacement(filtered: Sequence[_FilteredDisplacement], grid: SectionGrid) -> FloatArray:
    """Return the mean filtered y (n,) over all passes; zero where there is none."""
    total, count = np.zeros(grid.points), np.zeros(grid.points)
    for one in filtered:
        np.add.at(total, one.points, one.displacement)
        np.add.at(count, one.points, 1.0)
    return np.asarray(total / np.maximum(count, 1.0))


def _lags(
    filtered: Sequence[_FilteredDisplacement], reference: FloatArray, grid: SectionGrid, parameters: PositionParameters
) -> list[tuple[float, float]]:
    """Return (middle, offset) in m of the pieces of a journey's passes that have a clear one.

    In pieces, because over a long pass an error of the scale moves the two ends against each other.
    """
    found = []
    for one in filtered:
        pieces = max(round(len(one.points) * grid.step / parameters.piece), 1)
        parts = [part for part in np.array_split(np.arange(len(one.points)), pieces) if len(part)]
        peaks = [_peak(one.points[part], one.displacement[part], reference, grid, parameters) for part in parts]
        found += [peak[:2] for peak in peaks if peak is not None and not peak[2] < parameters.least_correlation]
    return found


def _peak(
    points: np.ndarray, y: FloatArray, reference: FloatArray, grid: SectionGrid, parameters: PositionParameters
) -> tuple[float, float, float] | None:
    """Return (middle of the piece, m, its offset, m, the correlation there); None where it is too short."""
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
    return 0.5 * (points[0] + points[-1]) * grid.step, shift * grid.step, float(scores[k])


def _sliding_products(longer: FloatArray, shorter: FloatArray) -> FloatArray:
    """Return the sum of products of the shorter with the longer, from each place at which it fits."""
    size = fft.next_fast_len(len(longer), real=True)
    products = fft.irfft(fft.rfft(longer, size) * np.conj(fft.rfft(shorter, size)), size)
    return np.asarray(products[: len(longer) - len(shorter) + 1])


def register(
    found: FloatArray, reference: FloatArray, grid: SectionGrid, parameters: PositionParameters
) -> tuple[Correction, float]:
    """Return how ``found`` (n,) must be moved onto ``reference`` (n,), and the mean correlation of its pieces.

    Parameters
    ----------
    found
        (n,) signal along the section.
    reference
        (n,) signal to compare with.
    grid
        Of the section.
    parameters
        How far positions may be off.
    """
    pieces = np.array_split(np.arange(grid.points), max(round(grid.length / (2 * parameters.piece)), 1))
    peaks = [_peak(part, found[part], reference, grid, parameters) for part in pieces]
    known = [peak for peak in peaks if peak is not None]
    if not known:
        return Correction(middle=0.5 * grid.length), 0.0
    score = float(np.mean([peak[2] for peak in known]))
    return _fitted(Correction(middle=0.5 * grid.length), [peak[:2] for peak in known]), score


def compose(first: Correction, second: Correction) -> Correction:
    """Return the correction that does what ``first`` and then ``second`` do, both small."""
    at = first.middle - second.middle
    return replace(first, offset=first.offset + second.offset + second.scale * at, scale=first.scale + second.scale)


def _fitted(correction: Correction, lags: Sequence[tuple[float, float]]) -> Correction:
    """Return the correction with a robust straight line through the lags added: a fixed number of reweightings."""
    if not lags:
        return correction
    s, lag = np.array(lags).T
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
    """Return the corrections less their mean: the fleet as a whole stays at its reported positions."""
    offset = float(np.mean([c.offset for c in corrections.values()]))
    scale = float(np.mean([c.scale for c in corrections.values()]))
    return {j: replace(c, offset=c.offset - offset, scale=c.scale - scale) for j, c in corrections.items()}
