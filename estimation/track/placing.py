"""Journeys placed on an alignment that is known, each by itself.

Windows that are estimated on the alignment before their epoch are placed on that very alignment: where one journey is
found does not depend on which others have come, so that a journey that comes later moves none of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from estimation.track.iteration import Grouped, Setting, first_rounds
from estimation.track.journeys import Journey
from estimation.track.panel.basis import KnownBeforehand, Panel
from estimation.track.panel.measured_curves import MeasuredCurve
from estimation.track.panel.prior_alignment import PriorAlignment, prior_on_grid
from estimation.track.passes import Pass
from estimation.track.position_std import shrunk
from estimation.track.positions import correlate_positions
from estimation.track.profile_life import ProfileLife
from estimation.track.section_parameters import SectionParameters
from estimation.values.track import Correction, TrackAlignment, TrackSectionRecord


def place_alone(
    section: TrackSectionRecord,
    grouped: Grouped,
    alignment: TrackAlignment,
    parameters: SectionParameters,
    measured: Mapping[ProfileLife, MeasuredCurve] | None = None,
) -> dict[Journey, Correction]:
    """Return where each journey was on an alignment, whatever others show; those whose place is not found are left out.

    Nothing is placed on an alignment whose gauge is known to vary: that takes the wheels of all.

    Args:
        grouped: Passes as measured, by journey.
        measured: Curves of measured profiles, by profile life.
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
