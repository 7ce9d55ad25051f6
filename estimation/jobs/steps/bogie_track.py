"""The alignment of a section on which stiff bogies alone have run: from both axles of each together.

The passes of single wheelsets leave a yaw spring open that carries nearly all of what they are to show.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.bogie.fit import Beforehand
from estimation.bogie.parameters import BOGIE_TRACK
from estimation.bogie.runs import AxleWindow, bogie_runs
from estimation.bogie.track import BogieAndRun, FoundAlignment, alignment_of_bogies
from estimation.filters import high_pass, local_cubic_kernel
from estimation.geometry.uncertainty import ParameterUncertainty, alignment_std
from estimation.jobs.job import JobContext
from estimation.jobs.steps.assumptions import Assumed
from estimation.jobs.steps.bogie_geometry import held_by_spring, known_well
from estimation.jobs.steps.epoch_passes import EpochPasses, RunsOnFile
from estimation.jobs.steps.load_window import WindowLoader
from estimation.track.passes import Entry, Journey, ProfileLife
from estimation.track.results import merged_alignment
from estimation.track.settings import SectionParameters
from estimation.track.update import AlignmentUpdate, UpdateOutcome
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.track import Correction, TrackAlignment, TrackSectionRecord
from estimation.values.windows import WindowKey, WindowRecord

_Bogie = tuple[str, ProfileLife, ProfileLife]  # vehicle, first and second wheelset


@dataclass(frozen=True, slots=True)
class _Ran:
    """The windows of both axles of a bogie at one time, and where they were."""

    bogie: _Bogie
    records: tuple[WindowRecord, WindowRecord]
    assumed: Assumed
    journey: Journey
    correction: Correction


def with_bogies(
    context: JobContext,
    section: TrackSectionRecord,
    chosen: Sequence[Entry],
    on_file: RunsOnFile,
    passes: EpochPasses,
    update: AlignmentUpdate,
    in_force: TrackAlignment | None,
) -> AlignmentUpdate:
    """Return an update that found no alignment for want of a stiffness with that of the bogies, if they find one."""
    report = update.estimate.report
    enough = report.mean_passes >= 2.0 * BOGIE_TRACK.mean_runs  # of both axles
    if not (enough and update.outcome.windows_wait and code_of(report.reason) is ReasonCode.STIFFNESS_OPEN):
        return update
    ran = _ran(chosen, on_file, passes.journeys(update.estimate.grouped), update)
    bogies = list(dict.fromkeys(item.bogie for item in ran))
    if not bogies:
        return update
    known = {item.bogie: Beforehand.of(item.assumed.window_parameters.vehicle_class) for item in ran}
    of_journeys, runs = _runs(context, section, ran, bogies, on_file)
    found = alignment_of_bogies([known[one] for one in bogies], runs, section.length_m, context.checkpoint)
    if isinstance(found, Reason):
        return update
    return updated(update, section, found, of_journeys, in_force, context.settings.alignment.section)


def _ran(
    chosen: Sequence[Entry], on_file: RunsOnFile, journeys: Mapping[WindowKey, Journey], update: AlignmentUpdate
) -> list[_Ran]:
    iterated = update.estimate.iterated
    corrections = {} if iterated is None else iterated.corrections
    by_axle = {(record.vehicle, record.axle, record.start_ns): (record, life) for record, life in chosen}
    found = []
    for record, life in chosen:
        assumed, journey = on_file.assumed[record.vehicle, record.wheelset], journeys.get(record.key)
        if isinstance(assumed, Reason) or journey not in corrections or journey is None:
            continue
        vehicle_class = assumed.window_parameters.vehicle_class
        partner = vehicle_class.partner(record.axle) or record.axle
        other = by_axle.get((record.vehicle, partner, record.start_ns))
        if other is not None and record.axle < partner and held_by_spring(vehicle_class):
            bogie = record.vehicle, replace(life, interval=0), replace(other[1], interval=0)
            found.append(_Ran(bogie, (record, other[0]), assumed, journey, corrections[journey]))
    by_chance = sorted(found, key=lambda item: hashlib.sha256(item.records[0].content_digest.encode()).digest())
    return sorted(by_chance[: BOGIE_TRACK.most_runs], key=lambda item: item.records[0].key)


def _runs(
    context: JobContext, section: TrackSectionRecord, ran: Sequence[_Ran], bogies: Sequence[_Bogie], on_file: RunsOnFile
) -> tuple[list[Journey], list[BogieAndRun]]:
    flat = _flat(section)
    journeys, runs = list[Journey](), list[BogieAndRun]()
    with context.storage.read() as unit:
        loader = WindowLoader(unit)
        for item in ran:
            parameters = item.assumed.window_parameters
            both = [loader.load(record, parameters.vehicle_class) for record in item.records]
            axles = [AxleWindow(window, item.correction) for window in both if not isinstance(window, Reason)]
            if len(axles) < len(both):
                continue
            swapped = axles[0].window.backwards
            leading, trailing = reversed(axles) if swapped else axles
            for run in bogie_runs(leading, trailing, flat, parameters, on_file.layout, swapped=swapped):
                journeys.append(item.journey)
                runs.append((bogies.index(item.bogie), run))
    return journeys, runs


def _flat(section: TrackSectionRecord) -> TrackAlignment:
    s = np.arange(0.0, section.length_m + 1.0)
    zero = np.zeros(len(s))
    return TrackAlignment(
        section.code, 0, s, zero, zero, zero, zero, np.zeros(len(s), dtype=np.int64), Status.UNESTIMATED
    )


def updated(
    update: AlignmentUpdate,
    section: TrackSectionRecord,
    found: FoundAlignment,
    of_journeys: Sequence[Journey],
    in_force: TrackAlignment | None,
    parameters: SectionParameters,
) -> AlignmentUpdate:
    """Return an update with the alignment of bogies where that has come to rest and is known well enough.

    Args:
        of_journeys: The journey of each of its runs.
    """
    estimate, p = update.estimate, replace(parameters, panel=replace(parameters.panel, length=section.length_m))
    assert estimate.iterated is not None
    merged = merged_alignment(section.code, estimate.iterated, in_force, p)  # for its gauge

    def on_grid(values: FloatArray) -> FloatArray:
        return np.asarray(np.interp(merged.s, found.place, values))

    d, step = on_grid(found.alignment), float(merged.s[1] - merged.s[0])
    filtered = high_pass(np.nan_to_num(d), local_cubic_kernel(p.cutoff_wavelength, step))
    alignment = replace(
        merged,
        alignment=np.where(np.isfinite(d), filtered, np.nan),
        alignment_std=np.ones(len(d)),
        passes=np.rint(2.0 * on_grid(found.runs)).astype(np.int64),
        scale_std=BOGIE_TRACK.scale_std,
        findings=None,
    )
    # of all waves, as of any fleet's: of which the motion has a share
    std = on_grid(found.std) / alignment_std(alignment, ParameterUncertainty())
    alignment = replace(alignment, alignment_std=np.where(np.isfinite(d), std, np.nan))
    if not (known_well(alignment) and found.moved <= BOGIE_TRACK.most_moved and np.isfinite(d).any()):
        return update
    corrections = dict(estimate.iterated.corrections)
    for journey in set(of_journeys):
        own = [shift for shift, other in zip(found.shift, of_journeys, strict=True) if other == journey]
        corrections[journey] = corrections[journey].moved(float(np.mean(own)), 0.0)
    certain = np.isfinite(d)
    report = replace(
        estimate.report,
        status=Status.ESTIMATED,
        reason=None,
        covered=float(certain.mean()),
        alignment_std_m=float(np.nanmedian(alignment.alignment_std)),
    )
    estimate = replace(estimate, alignment=alignment, corrections=corrections, report=report)
    return replace(update, outcome=UpdateOutcome.NEW_VERSION, estimate=estimate, alignment=alignment)
