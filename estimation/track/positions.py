"""Passes put where they were: odometer offsets and scale errors found from what the passes have in common.

What every wheelset feels at a place is mostly the track. So each journey (the windows of one vehicle on one run over
the section) is shifted and stretched until its lateral displacement agrees with the mean of the others: first by
correlation, then by least squares on the slope of the alignment that the panel has found. Where the whole fleet lies
is nobody's to say: the mean journey keeps its place.

A worn and a new wheelset answer the track with different lags, so the offset of a journey and the slope of its
wheelsets' curves trade off; a vehicle whose wheelsets differ in wear tells them apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import signal

from estimation.filters.local_cubic import high_pass, local_cubic_kernel
from estimation.track.journeys import Journey, PositionParameters, apply_correction
from estimation.track.panel.basis import PanelParameters, pass_residual
from estimation.track.panel.solution import PanelSolution
from estimation.track.passes import Pass, gridded
from estimation.values.arrays import FloatArray
from estimation.values.track import Correction


def correlate_positions(
    grouped: Mapping[Journey, Sequence[Pass]],
    panel: PanelParameters,
    parameters: PositionParameters,
    anchor: FloatArray | None = None,
) -> dict[Journey, Correction]:
    """Return a correction for every journey from the correlation of lateral displacements.

    The longest journey is the first reference; then, twice, the mean of all. A journey that agrees with nothing
    keeps its place with no correction. An ``anchor`` (n,), the alignment as known, is the reference instead, and the
    fleet as a whole is then moved to where that lies.
    """
    corrections = {journey: Correction(middle=0.5 * panel.length) for journey in grouped}
    if anchor is not None:
        return {
            journey: _fitted(corrections[journey], _lags(members, corrections[journey], anchor, panel, parameters))
            for journey, members in grouped.items()
        }
    first = max(grouped, key=lambda journey: sum(item.at[-1] - item.at[0] for item in grouped[journey]))
    reference = _mean_displacement({first: grouped[first]}, corrections, panel)
    for _ in range(3):
        for journey, members in grouped.items():
            lags = _lags(members, corrections[journey], reference, panel, parameters)
            corrections[journey] = _fitted(corrections[journey], lags)
        corrections = _centred(corrections)
        reference = _mean_displacement(grouped, corrections, panel)
    return corrections


def refine(
    grouped: Mapping[Journey, Sequence[Pass]],
    corrections: Mapping[Journey, Correction],
    solution: PanelSolution,
    panel: PanelParameters,
    *,
    anchored: bool = False,
) -> dict[Journey, Correction]:
    """Return better corrections: one Gauss-Newton step on y - d - h(R) = d' (offset + scale (s - middle)).

    ``anchored`` where the alignment holds evidence of where the place lies; else the mean journey keeps its place.
    """
    slope = np.gradient(np.nan_to_num(solution.alignment), panel.step)
    certain = np.isfinite(solution.alignment)
    better = {}
    for journey, members in grouped.items():
        correction = corrections[journey]
        normal, right = 1e-12 * np.eye(2), np.zeros(2)
        for item in apply_correction(members, correction):
            rest = pass_residual(item, solution.curves[0, solution.wheelsets.index(item.wheelset)], panel)
            if rest is None:
                continue
            at, own = rest
            residual = (own - np.nan_to_num(solution.alignment[at])) * certain[at]
            design = np.stack([slope[at], slope[at] * (at * panel.step - correction.middle)]) * certain[at]
            normal += design @ design.T
            right += design @ residual
        step = np.linalg.solve(normal + np.diag([0.0, 1e-9 * normal[1, 1]]), right)
        better[journey] = replace(
            correction, offset=correction.offset + float(step[0]), scale=correction.scale + float(step[1])
        )
    return better if anchored else _centred(better)


def _mean_displacement(
    grouped: Mapping[Journey, Sequence[Pass]], corrections: Mapping[Journey, Correction], panel: PanelParameters
) -> FloatArray:
    """Return the mean filtered y (n,) over all passes; zero where there is none."""
    weights = local_cubic_kernel(panel.cutoff_wavelength, panel.step)
    total, count = np.zeros(panel.points), np.zeros(panel.points)
    for journey, members in grouped.items():
        for item in apply_correction(members, corrections[journey]):
            points, y = _filtered_displacement(item, weights, panel)
            np.add.at(total, points, y)
            np.add.at(count, points, 1.0)
    return np.asarray(total / np.maximum(count, 1.0))


def _filtered_displacement(item: Pass, weights: FloatArray, panel: PanelParameters) -> tuple[np.ndarray, FloatArray]:
    first, displacement, _ = gridded(item, panel.step)
    m = len(weights) // 2
    if len(displacement) <= 2 * m + 1:
        return np.empty(0, dtype=np.int64), np.empty(0)
    y = high_pass(displacement, weights)[m:-m]
    points = np.arange(first + m, first + m + len(y))
    inside = (points >= 0) & (points < panel.points)
    return points[inside], y[inside]


def _lags(
    members: Sequence[Pass],
    correction: Correction,
    reference: FloatArray,
    panel: PanelParameters,
    parameters: PositionParameters,
) -> list[tuple[float, float]]:
    """Return (middle, offset) in m of the pieces of a journey's passes that have a clear one.

    In pieces, because over a long pass an error of the scale moves the two ends against each other.
    """
    weights = local_cubic_kernel(panel.cutoff_wavelength, panel.step)
    found = []
    for item in apply_correction(members, correction):
        points, y = _filtered_displacement(item, weights, panel)
        pieces = max(round(len(points) * panel.step / parameters.piece), 1)
        parts = [part for part in np.array_split(np.arange(len(points)), pieces) if len(part)]
        lags = [_lag(points[part], y[part], reference, panel, parameters) for part in parts]
        found += [lag for lag in lags if lag is not None]
    return found


def _lag(
    points: np.ndarray, y: FloatArray, reference: FloatArray, panel: PanelParameters, parameters: PositionParameters
) -> tuple[float, float] | None:
    """Return (middle of the piece, its offset) in m, from the peak of the correlation; None without a clear one."""
    found = _peak(points, y, reference, panel, parameters)
    return None if found is None or found[2] < parameters.least_correlation else found[:2]


def _peak(
    points: np.ndarray, y: FloatArray, reference: FloatArray, panel: PanelParameters, parameters: PositionParameters
) -> tuple[float, float, float] | None:
    """Return (middle of the piece, m, its offset, m, the correlation there); None where it is too short."""
    reach = int(parameters.largest_offset / panel.step)
    if len(points) < 4 * reach:
        return None
    low, high = points[0] - reach, points[-1] + reach + 1
    padded = np.pad(reference, (max(-low, 0), max(high - panel.points, 0)))
    base = max(-low, 0)
    part = padded[low + base : high + base]
    products = signal.correlate(part, y, mode="valid")
    energy = np.convolve(part * part, np.ones(len(y)), mode="valid")
    scores = products / np.sqrt(np.maximum(energy, 1e-30) * max(float(y @ y), 1e-30))
    k = int(np.argmax(scores))
    shift = float(k - reach)
    if 0 < k < len(scores) - 1:
        a, b, c = scores[k - 1 : k + 2]
        shift += 0.5 * (a - c) / (a - 2 * b + c)
    return 0.5 * (points[0] + points[-1]) * panel.step, shift * panel.step, float(scores[k])


def compared(
    found: FloatArray, reference: FloatArray, panel: PanelParameters, parameters: PositionParameters
) -> tuple[Correction, float]:
    """Return how ``found`` (n,) must be moved to lie on ``reference`` (n,), and the mean correlation of its pieces."""
    pieces = np.array_split(np.arange(panel.points), max(round(panel.length / (2 * parameters.piece)), 1))
    peaks = [_peak(part, found[part], reference, panel, parameters) for part in pieces]
    met = [peak for peak in peaks if peak is not None]
    if not met:
        return Correction(middle=0.5 * panel.length), 0.0
    score = float(np.mean([peak[2] for peak in met]))
    return _fitted(Correction(middle=0.5 * panel.length), [peak[:2] for peak in met]), score


def compose(first: Correction, second: Correction) -> Correction:
    """Return the correction that does what ``first`` and then ``second`` do, both small."""
    at = first.middle - second.middle
    return replace(first, offset=first.offset + second.offset + second.scale * at, scale=first.scale + second.scale)


def _fitted(correction: Correction, lags: Sequence[tuple[float, float]]) -> Correction:
    """Return the correction with a robust straight line through the lags added."""
    if not lags:
        return correction
    s, lag = np.array(lags).T
    u = s - correction.middle
    weights = np.ones(len(u))
    line = np.zeros(2)
    for _ in range(10):
        design = np.stack([weights, weights * u])
        ridge = np.diag([0.0, 1e-6 * float(u @ u) + 1e4])  # a short journey says little of its scale
        line = np.linalg.solve(design @ np.stack([np.ones(len(u)), u]).T + ridge, design @ lag)
        error = np.abs(lag - line[0] - line[1] * u)
        weights = 1.0 / (1.0 + (error / max(float(np.median(error)), 0.1)) ** 2)
    return replace(correction, offset=correction.offset + float(line[0]), scale=correction.scale + float(line[1]))


def _centred(corrections: Mapping[Journey, Correction]) -> dict[Journey, Correction]:
    """Return the corrections less their mean: the fleet as a whole stays where it said it was."""
    offset = float(np.mean([c.offset for c in corrections.values()]))
    scale = float(np.mean([c.scale for c in corrections.values()]))
    return {j: replace(c, offset=c.offset - offset, scale=c.scale - scale) for j, c in corrections.items()}
