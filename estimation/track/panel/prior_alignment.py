"""What was known of a section before an epoch, as the panel takes it: one more pass of a wheelset with R = 0."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.filters.local_cubic import high_pass, local_cubic_kernel, valid_support
from estimation.track.gridded_pass import SectionGrid
from estimation.track.panel.normal_equations import PanelState, groups_of
from estimation.track.panel.solution import PanelSolution
from estimation.values.arrays import FloatArray
from estimation.values.track import AlignmentSource, TrackAlignment


@dataclass(frozen=True, slots=True)
class PriorAlignment:
    """Evidence on the grid: filtered alignment (n,), zero where there is none, and its std (n,), inf there."""

    alignment: FloatArray
    std: FloatArray
    passes: FloatArray
    gauge: FloatArray
    gauge_std: FloatArray
    gauge_known: bool
    surveyed: bool = False  # and not what passes have found

    @property
    def has_alignment(self) -> bool:
        """Whether it holds an alignment anywhere; it may hold the gauge alone."""
        return bool(np.isfinite(self.std).any())


def prior_on_grid(evidence: TrackAlignment, grid: SectionGrid, cutoff_wavelength: float) -> PriorAlignment:
    """Return the prior alignment on the grid of the panel.

    Args:
        evidence: Alignment of the section, from a survey or an earlier version, on its own grid.
        cutoff_wavelength: Of the panel's high-pass, m; an alignment filtered at this wavelength is not filtered again.
    """
    s = grid.s
    certain = np.isfinite(evidence.alignment) & np.isfinite(evidence.alignment_std)
    inside = np.interp(s, evidence.s, certain.astype(np.float64), left=0.0, right=0.0) > 1.0 - 1e-9
    d = np.interp(s, evidence.s, np.where(certain, evidence.alignment, 0.0))
    std = np.interp(s, evidence.s, np.where(certain, evidence.alignment_std, 0.0))
    if evidence.cutoff_wavelength != cutoff_wavelength:
        weights = local_cubic_kernel(cutoff_wavelength, grid.step)
        inside = valid_support(np.asarray(inside), weights)
        d = high_pass(d, weights)
    passes = np.interp(s, evidence.s, evidence.passes.astype(np.float64))
    return PriorAlignment(
        np.where(inside, d, 0.0),
        np.where(inside, std, np.inf),
        np.where(inside, np.rint(passes), 0.0),
        np.interp(s, evidence.s, evidence.gauge_deviation),
        np.interp(s, evidence.s, evidence.gauge_deviation_std),
        evidence.gauge_known,
        surveyed=evidence.source == AlignmentSource.RECORDED,
    )


def add_prior(state: PanelState, known: PriorAlignment, noise: float, most_weight: float) -> PanelState:
    """Return the sums with the evidence added, as heavy as its variance makes it against a pass's ``noise`` (m).

    Args:
        noise: Std of y - d - h(R) of a pass, m.
    """
    with np.errstate(divide="ignore"):
        weight = np.minimum((noise / known.std) ** 2, most_weight)
    d = known.alignment
    panel = state.panel
    group = groups_of(np.arange(panel.grid.points), panel)
    square = state.square + np.bincount(group, weights=weight * d * d, minlength=panel.parameters.groups)
    return replace(
        state,
        panel=replace(panel, parameters=replace(panel.parameters, least_passes=1)),
        displacement=state.displacement + weight * d,
        passes=state.passes + weight,
        square=square,
        has_alignment=known.has_alignment,
    )


def fleet_step(state: PanelState, solution: PanelSolution, known: PriorAlignment) -> float | None:
    """Return by how much the fleet as a whole is to be moved onto the prior alignment, m; None where they do not meet.

    Journeys move towards the alignment of all, most of which they have made themselves: as a whole they would come
    nearer by the share of the evidence in it, round by round, while stiffness ratios make up for what is left.
    """
    weight = solution.passes - state.passes
    observed = (weight > 0) & (state.passes > 0) & np.isfinite(solution.alignment)
    passes_of_fleet = np.where(observed, state.passes, 1)
    of_passes = (solution.passes * np.nan_to_num(solution.alignment) - weight * known.alignment) / passes_of_fleet
    slope = np.where(observed, np.gradient(np.where(observed, of_passes, 0.0), state.panel.grid.step), 0.0)
    square = float(slope @ slope)
    return float(slope @ np.where(observed, of_passes - known.alignment, 0.0)) / square if square > 0.0 else None
