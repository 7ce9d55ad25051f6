"""Journeys placed on an alignment that is known, each by itself.

Windows that are estimated on the alignment before their epoch are placed on that very alignment: where one journey is
found does not depend on which others have come, so that a journey that comes later moves none of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.track.iteration import Grouped, IterationResult, Setting, first_rounds
from estimation.track.panel.basis import KnownBeforehand, Panel
from estimation.track.panel.measured_curves import MeasuredCurve
from estimation.track.panel.prior_alignment import PriorAlignment, prior_on_grid
from estimation.track.passes import Journey, Pass, ProfileLife
from estimation.track.positions import correlate_positions
from estimation.track.settings import SectionParameters
from estimation.values.track import Correction, TrackAlignment, TrackSectionRecord

CORRELATED = 20.0  # m along the track over which the error of y - d - h(R) of a pass is one
REPORTED_STD = 1.0  # m, of a position as it was reported


def position_std(iterated: IterationResult) -> dict[Journey, float]:
    """Return the std of each journey's offset, m, by the slope of the alignment and the residuals; inf for none."""
    panel, solution = iterated.panel, iterated.solution
    slope = np.gradient(np.nan_to_num(solution.alignment), panel.grid.step)
    weight = panel.grid.step / CORRELATED / max(iterated.noise, 1e-9) ** 2
    information = {
        journey: weight * sum(float(np.sum(slope[item.used_points] ** 2)) for item in one.passes if not item.empty)
        for journey, one in iterated.placed.items()
    }
    return {journey: one**-0.5 if one > 0.0 else float("inf") for journey, one in information.items()}


def shrunk(iterated: IterationResult) -> Mapping[Journey, Correction]:
    """Return the corrections of journeys, each as far as it is better known than the reported position."""
    found = {}
    for journey, std in position_std(iterated).items():
        share = REPORTED_STD**2 / (REPORTED_STD**2 + std**2)
        one = iterated.corrections[journey]
        found[journey] = replace(one, offset=share * one.offset, scale=share * one.scale)
    return found


def place_alone(
    section: TrackSectionRecord,
    grouped: Grouped,
    alignment: TrackAlignment,
    parameters: SectionParameters,
    measured: Mapping[ProfileLife, MeasuredCurve] | None = None,
) -> dict[Journey, Correction]:
    """Return where each journey was on an alignment, whatever others show; those whose place is not found are left out.

    Nothing is placed on an alignment whose gauge is known to vary: that takes the wheels of all.
    """
    panel = Panel.of(replace(parameters.panel, length=section.length_m), KnownBeforehand(measured=measured or {}))
    prior = prior_on_grid(alignment, panel.grid, parameters.panel.cutoff_wavelength)
    if not prior.has_alignment or (prior.gauge_known and prior.gauge.any()):
        return {}
    found = {}
    for journey, members in grouped.items():
        correction = _placed(journey, members, prior, panel, parameters)
        if correction is not None:
            found[journey] = correction
    return found


def _placed(
    journey: Journey, members: Sequence[Pass], prior: PriorAlignment, panel: Panel, p: SectionParameters
) -> Correction | None:
    """Return the correction of one journey; None where the rounds do not end."""
    alone: Grouped = {journey: members}
    setting = Setting(alone, prior, anchored=True, parameters=p.iteration)
    start = correlate_positions(alone, panel.grid, p.positions, prior.alignment)
    found = first_rounds(setting, panel, start, std=False)
    if found.moved >= p.iteration.position_tolerance:
        return None
    return shrunk(found)[journey] if prior.surveyed else found.corrections[journey]
