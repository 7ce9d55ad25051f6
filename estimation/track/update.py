"""What an epoch makes of the alignment in force: the next version, or the recording kept.

Where a recorded gauge varies, the recording is kept with what its gauge does to the wheelsets that have been met.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.track.gauge.initial_shape import LEAST_GAUGE
from estimation.track.panel.measured_curves import MeasuredCurve
from estimation.track.passes import Pass
from estimation.track.screening.screen import PassOutcome, Screened, screen
from estimation.track.section import SectionEstimate, estimate_section
from estimation.track.section_parameters import SectionParameters
from estimation.track.settings import AlignmentSettings
from estimation.track.survey_check import check_survey
from estimation.track.versions import carry_over_findings, gauge_shift_changed, requires_reestimation
from estimation.values.track import RECORDED, TrackAlignment, TrackSectionRecord


@dataclass(frozen=True, slots=True)
class Finding:
    """What the passes of an epoch say.

    ``alignment`` is what is in force from now on, None where nobody knows any; ``made`` that it is new. ``trusted``
    positions are believed unless they are far off. ``outcomes`` are of the passes in their order. ``recording`` says
    what the fleet thinks of the recording in force, where it was asked and could tell.
    """

    estimate: SectionEstimate
    alignment: TrackAlignment | None
    made: bool
    trusted: bool
    outcomes: tuple[PassOutcome, ...]
    recording: str | None = None


def find(
    section: TrackSectionRecord,
    passes: Sequence[Pass],
    in_force: TrackAlignment | None,
    settings: AlignmentSettings,
    *,
    judge: bool,
    measured: Mapping[str, MeasuredCurve] | None = None,
) -> Finding:
    """Return what an epoch of passes says of a section.

    Parameters
    ----------
    section
        The section.
    passes
        Of the epoch.
    in_force
        Its alignment so far.
    settings
        Grid, filter, limits.
    judge
        Hold a recording against what the fleet finds without it.
    measured
        What measured profiles say, by the name of the wheelset in ``passes``.
    """
    panel = replace(settings.section.panel, length=section.length_m)
    parameters = replace(settings.section, panel=panel)
    recording = in_force is not None and in_force.source == RECORDED
    on_record = recording and in_force is not None and bool(np.isfinite(in_force.alignment).any())
    screened = screen(passes, in_force, replace(settings.screening, positions=parameters.positions))
    if in_force is not None and on_record:
        beside = _beside_recording(section.code, screened, in_force, parameters, measured, judge=judge)
        return beside if beside.made else _with_gauge_shifts(beside, in_force, settings)
    evidence = (
        in_force
        if in_force is not None and (recording or in_force.cutoff_wavelength == parameters.cutoff_wavelength)
        else None
    )
    estimate = estimate_section(section.code, screened.used, evidence, parameters, measured)
    if estimate.alignment is None:
        kept = None if recording else in_force  # a recording of the gauge alone says of no place how it lies
        return Finding(estimate, kept, made=False, trusted=False, outcomes=screened.outcomes)
    told = carry_over_findings(estimate.alignment, in_force)
    return Finding(estimate, told, made=True, trusted=False, outcomes=screened.outcomes)


def _beside_recording(
    section: str,
    screened: Screened,
    recorded: TrackAlignment,
    parameters: SectionParameters,
    measured: Mapping[str, MeasuredCurve] | None,
    *,
    judge: bool,
) -> Finding:
    verdict = None
    if judge:
        blind = estimate_section(section, screened.used, None, parameters, measured)
        if blind.alignment is not None:
            judgement = check_survey(recorded, blind.alignment, place_std=_place_std(blind))
            if not judgement.usable:
                told = f"not used: {judgement.reason}"
                return Finding(blind, blind.alignment, True, False, screened.outcomes, told)  # noqa: FBT003 - made, not trusted
            verdict = None if judgement.reason else "agrees with what the fleet has felt"
    estimate = estimate_section(section, screened.used, recorded, parameters, measured)
    if estimate.alignment is not None and better(estimate.alignment, recorded):
        return Finding(estimate, estimate.alignment, True, False, screened.outcomes, verdict)  # noqa: FBT003 - the same
    return Finding(estimate, recorded, False, True, screened.outcomes, verdict)  # noqa: FBT003 - kept, trusted


def _with_gauge_shifts(kept: Finding, recorded: TrackAlignment, settings: AlignmentSettings) -> Finding:
    """Return the recording with what its gauge does to wheelsets, as a version of its own where that says more."""
    found = kept.estimate.alignment
    varies = recorded.gauge_known and float(np.std(recorded.gauge_deviation)) >= LEAST_GAUGE
    if not varies or found is None or found.findings is None or not found.findings.gauge_shifts:
        return kept
    told = carry_over_findings(replace(recorded, findings=found.findings), recorded)
    if not (requires_reestimation(recorded, told, settings) or gauge_shift_changed(recorded, told, settings)):
        return kept
    return replace(kept, alignment=told, made=True)


def _place_std(estimate: SectionEstimate) -> float:
    """Return how well the fleet knows where it lies: the scatter of its journeys over the root of their number, m."""
    offsets = [correction.offset for correction in estimate.corrections.values()]
    return float(np.std(offsets) / np.sqrt(len(offsets))) if offsets else 0.0


def better(fleet: TrackAlignment, recorded: TrackAlignment, share: float = 0.5) -> bool:
    """Whether the fleet's alignment knows all that the recording knows, and knows it far better."""
    if fleet.cutoff_wavelength < recorded.cutoff_wavelength or (recorded.gauge_known and not fleet.gauge_known):
        return False
    held = np.interp(fleet.s, recorded.s, recorded.alignment_std)
    known = np.isfinite(fleet.alignment_std)
    return bool(known.all() and np.median(fleet.alignment_std) < share * np.median(held))
