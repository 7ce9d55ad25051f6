"""The lateral displacements of passes compared along the section: mean, and the shift at which a piece agrees best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from estimation.filters.local_cubic import high_pass
from estimation.track.gridded_pass import SectionGrid
from estimation.track.passes import Pass, PositionParameters, gridded
from estimation.values.arrays import FloatArray, IntArray


def peak_position(score: FloatArray, k: int) -> float:
    """Return the position, in samples, of the vertex of the parabola through a peak and its neighbours.

    Args:
        score: (n,) at equal distances.
        k: Of the largest one; itself is returned at an end, and where the three do not bend downwards.
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
    """Return the peaks of the pieces of a signal that agree with a reference clearly.

    In pieces, because over a long pass an error of the scale moves the two ends against each other.

    Args:
        points, y: (m,) grid points, increasing by one, and the signal there.
        reference: (n,) on the grid.
    """
    pieces = max(round(len(points) * grid.step / parameters.piece), 1)
    parts = [part for part in np.array_split(np.arange(len(points)), pieces) if len(part)]
    peaks = [peak(points[part], y[part], reference, grid, parameters) for part in parts]
    return [one for one in peaks if one is not None and not one.correlation < parameters.least_correlation]


def peak(
    points: IntArray, y: FloatArray, reference: FloatArray, grid: SectionGrid, parameters: PositionParameters
) -> Peak | None:
    """Return where a piece of a signal agrees best with a reference; None where the piece is too short.

    Args:
        points, y: (m,) grid points, increasing by one, and the signal there.
        reference: (n,) on the grid.
    """
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
