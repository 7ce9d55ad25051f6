"""One fleet with one survey on file, or none: what becomes of the survey, and of the conicities that rest on it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.made_values import made_alignment
from bench.scores import compared_at
from bench.survey_fleets import AMPLITUDES, Fleet, drawn_track
from estimation.filters import high_pass, local_cubic_kernel, valid_support
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.uncertainty import ParameterUncertainty, alignment_std
from estimation.motion.window_motion import alignment_at
from estimation.tables.bin_table import bin_parameters, cells_of_window, merge_all
from estimation.track.passes import PassStatus, PositionParameters, journeys
from estimation.track.settings import AlignmentSettings
from estimation.track.update import NOT_USED, AlignmentUpdate, UpdateOutcome, update_alignment
from estimation.values.arrays import FloatArray
from estimation.values.geometry import FilledCells
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.track import Correction, TrackAlignment, TrackSectionRecord
from ingest.simulator.track import TrackTruth

CHORD = 4.0  # m: errors of a survey are white, smoothed over it by a Hann window
SURVEY_STEP = 0.25  # m
TRUSTED = 0.3  # m, offsets up to which the rival takes positions as they are
SHIFTS = np.arange(-1.5, 1.51, 0.05)  # m, over which the place of an alignment is searched
UNCERTAIN = Reason(ReasonCode.POSITION_UNCERTAIN, "its position along the section is not certain")


@dataclass(frozen=True, slots=True)
class SurveyPlan:
    """What is on file of the section besides its gauge; ``std`` None for no alignment."""

    std: float | None  # m, of the file's own errors
    stated: float | None = None  # m; None is the true one
    shift: float = 0.0  # m along the section
    scale: float = 1.0
    other_section: bool = False

    @property
    def right(self) -> bool:
        """Whether nothing is wrong with it but its errors."""
        return self.shift == 0.0 and self.scale == 1.0 and not self.other_section


@dataclass(frozen=True, slots=True)
class Conicity:
    """One published conicity against the truth."""

    key: str  # serial and amplitude in mm
    error: float
    half_width: float
    covered: bool


@dataclass(frozen=True, slots=True)
class SurveyScore:
    """One fleet, one survey, one error of positions."""

    code: str  # of the verdict; empty for none
    refused: bool
    alignment_std: float | None  # m, of what is in force at the wavelengths of the motion; None for nothing
    alignment_error: float | None  # m, rms, against the truth
    asked: int
    published: tuple[Conicity, ...]


def on_file(fleet: Fleet, plan: SurveyPlan, seed: int) -> TrackAlignment:
    """Return what is on file of a fleet's section: the gauge, and the alignment where the plan has one.

    The gauge is on file without an alignment too: what is compared knows the same else.
    """
    s = np.asarray(np.arange(0.0, fleet.track.s[-1] + 1e-9, SURVEY_STEP))
    d, stated = np.full(len(s), np.nan), plan.std if plan.stated is None else plan.stated
    if plan.std is not None:
        source = drawn_track(seed + 7919) if plan.other_section else fleet.track
        window = np.hanning(max(3, round(CHORD / SURVEY_STEP)))
        white = np.random.default_rng([seed, 3501]).standard_normal(len(s))
        error = plan.std * np.convolve(white, window / np.sqrt((window**2).sum()), mode="same")
        d = plan.scale * np.interp(s - plan.shift, source.s, source.alignment) + error
    return made_alignment(s, d, np.nan if stated is None else stated)


def moved(fleet: Fleet, position_std: float, seed: int) -> Fleet:
    """Return the fleet with every journey off by a draw of its own of this std, m."""
    rng = np.random.default_rng([seed, 3502])
    keys = sorted({(one.vehicle, one.start_ns) for one in fleet.windows})
    off = {key: position_std * float(rng.standard_normal()) for key in keys}
    passes = tuple(replace(one, at=one.at + off[one.vehicle, one.start_ns]) for one in fleet.passes)
    windows = tuple(replace(one, distance=one.distance + off[one.vehicle, one.start_ns]) for one in fleet.windows)
    return replace(fleet, windows=windows, passes=passes)


def score(fleet: Fleet, survey: TrackAlignment, *, rival: bool = False) -> tuple[SurveyScore, SurveyScore | None]:
    """Return what a fleet makes of a section with this survey on file, and what the rival does, where asked for.

    The rival takes the survey as it is on file, and corrects positions only from ``TRUSTED`` on. Without a survey it is
    the fleet's own alignment with the std that it truly has, which nobody but the bench knows.
    """
    section = TrackSectionRecord("S", 1, "S", "56E1", 0.05, 1.435, float(fleet.track.s[-1]))
    update = update_alignment(section, list(fleet.passes), survey, AlignmentSettings(), survey_checked=False)
    found = _scored(fleet, update)
    if not rival:
        return found, None
    if not np.isfinite(survey.alignment).any():
        return found, None if found.alignment_error is None else _scored(fleet, _honest(update, found.alignment_error))
    far = {journey: one for journey, one in update.estimate.corrections.items() if abs(one.offset) > TRUSTED}
    kept = replace(update, outcome=UpdateOutcome.SURVEY_KEPT, alignment=survey)
    return found, _scored(fleet, replace(kept, estimate=replace(update.estimate, corrections=far)))


def _honest(update: AlignmentUpdate, error: float) -> AlignmentUpdate:
    """Return an update whose alignment states this std, m, at the wavelengths of the motion."""
    track = update.alignment
    assert track is not None
    stated = alignment_std(replace(track, alignment_std=np.ones(len(track.s))), ParameterUncertainty())
    return replace(update, alignment=replace(track, alignment_std=np.full(len(track.s), error / stated)))


def _alignment_error(truth: TrackTruth, track: TrackAlignment) -> float | None:
    """Return the rms error of an alignment in the motion, m, where it is used, at the place where that is least.

    Without a survey nothing says where the fleet is as a whole; None where no part of it is long enough.
    """
    s = np.asarray(np.arange(0.0, truth.s[-1], SURVEY_STEP))
    d = alignment_at(s, track, ParameterUncertainty().usual_cutoff)
    kernel = local_cubic_kernel(ParameterUncertainty().usual_cutoff, SURVEY_STEP)
    inside = valid_support(np.isfinite(d), kernel)
    if not inside.any():
        return None
    seen = high_pass(np.nan_to_num(d), kernel)[inside]
    true = high_pass(np.interp(s, truth.s, truth.alignment), kernel)
    return float(min(np.sqrt(np.mean((seen - np.interp(s + shift, s, true)[inside]) ** 2)) for shift in SHIFTS))


def _scored(fleet: Fleet, update: AlignmentUpdate) -> SurveyScore:
    track = update.alignment
    known = None if track is None or not np.isfinite(track.alignment).any() else track
    return SurveyScore(
        code=str(code_of(update.survey) or ""),
        refused=str(update.survey or "").startswith(NOT_USED),
        alignment_std=None if known is None else alignment_std(known, ParameterUncertainty()),
        alignment_error=None if known is None else _alignment_error(fleet.track, known),
        asked=len(fleet.conicity) * len(AMPLITUDES),
        published=tuple(_conicities(fleet, update)),
    )


def _conicities(fleet: Fleet, update: AlignmentUpdate) -> list[Conicity]:
    track = update.alignment
    if track is None or not np.isfinite(track.alignment).any():
        return []
    placed, tables = places(fleet, update), defaultdict[str, list[FilledCells]](list)
    for window in fleet.windows:
        place = placed[window.wheelset, window.start_ns]
        table = place if isinstance(place, Reason) else cells_of_window(window, track, fleet.parameters, place)
        if not isinstance(table, Reason):
            tables[window.wheelset].append(table)
    of_each = (_compared(fleet, track, serial, tables[serial], true) for serial, true in fleet.conicity.items())
    return [one for compared in of_each for one in compared]


def _compared(
    fleet: Fleet, track: TrackAlignment, serial: str, tables: Sequence[FilledCells], true: FloatArray
) -> list[Conicity]:
    if not tables:
        return []
    bins = bin_parameters(fleet.parameters)
    uncertainty = ParameterUncertainty.of(fleet.parameters.vehicle_class).on([track], serial)
    geometry = estimate_geometry(merge_all(tables, bins), bins, GeometryParameters(uncertainty=uncertainty))
    if geometry.status is Status.MODEL_MISMATCH:
        return []
    found = compared_at(AMPLITUDES, true, geometry.amplitude, geometry.conicity)
    keys = (f"{serial} {1e3 * amplitude:g}" for amplitude in AMPLITUDES)
    return [Conicity(key, *one) for key, one in zip(keys, found, strict=True) if one is not None]


def places(fleet: Fleet, update: AlignmentUpdate) -> dict[tuple[str, int], Correction | Reason | None]:
    """Return by wheelset and start where the windows were, or why not, as the job of the alignment stores it."""
    grouped = journeys(fleet.passes, PositionParameters())
    members = {(item.wheelset, item.start_ns): journey for journey, items in grouped.items() for item in items}
    refused = {
        (item.wheelset, item.start_ns): outcome.reason
        for item, outcome in zip(fleet.passes, update.pass_outcomes, strict=True)
        if outcome.status is PassStatus.REFUSED and outcome.reason is not None
    }
    outliers = {(one.vehicle, one.from_ns): one.reason for one in update.estimate.report.journeys if not one.used}
    found: dict[tuple[str, int], Correction | Reason | None] = {}
    for window in fleet.windows:
        key = (window.wheelset, window.start_ns)
        journey = members.get(key)
        correction = None if journey is None else update.estimate.corrections.get(journey)
        if key in refused:
            found[key] = refused[key]
        elif not update.outcome.positions_valid:
            reason = UNCERTAIN if correction is None else None
            found[key] = (outliers.get(journey) if journey in outliers else reason) or correction
        else:
            found[key] = correction
    return found
