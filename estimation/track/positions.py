"""Passes put where they were: odometer offsets and scale errors found from what the passes have in common.

The motion of every wheelset at a place is mostly that of the track. So each journey (the windows of one vehicle on one
run over the section) is shifted and stretched until its lateral displacement agrees with those of the others: first by
correlation (``position_network``), then by least squares on the slope of the alignment that the panel has found. Where
the whole fleet is is not observable: the mean journey keeps its place.

A worn and a new wheelset answer the track with different lags, so the offset of a journey and the slope of its
wheelsets' curves trade off; a vehicle whose wheelsets differ in wear separates them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.track.correlation import Peak, clear_peaks, filtered_displacements, peak
from estimation.track.gridded_pass import Placed
from estimation.track.journeys import Journey, PositionParameters
from estimation.track.panel.basis import Panel, pass_residual
from estimation.track.panel.solution import PanelSolution
from estimation.track.passes import Pass
from estimation.track.position_network import adjusted_positions
from estimation.track.section_grid import SectionGrid
from estimation.values.arrays import FloatArray
from estimation.values.track import Correction

REWEIGHTINGS = 10  # of the line through the lags


def correlate_positions(
    grouped: Mapping[Journey, Sequence[Pass]],
    grid: SectionGrid,
    parameters: PositionParameters,
    alignment: FloatArray | None = None,
) -> dict[Journey, Correction]:
    """Return a correction for every journey from the correlation of lateral displacements.

    A journey that agrees with nothing keeps its place.

    Args:
        grouped: Passes by journey.
        parameters: How far positions may be off.
        alignment: (n,) m, as known: every journey is placed by it, and the fleet as a whole is moved to it. By default,
            journeys are placed by each other.
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

    Args:
        anchored: Whether the alignment holds prior knowledge of positions; else the mean journey keeps its place.
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
    """Return how ``found`` (n,) must be moved onto ``reference`` (n,), and the mean correlation of its pieces.

    Args:
        found: (n,) signal along the section.
        reference: (n,) signal to compare with.
        parameters: How far positions may be off.
    """
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
    """Return the corrections less their mean: the fleet as a whole stays at its reported positions."""
    offset = float(np.mean([c.offset for c in corrections.values()]))
    scale = float(np.mean([c.scale for c in corrections.values()]))
    return {j: replace(c, offset=c.offset - offset, scale=c.scale - scale) for j, c in corrections.items()}
