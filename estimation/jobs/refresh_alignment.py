"""Job: new windows of a section improve its alignment, which corrects their positions.

Each section is done in epochs: windows that have not been placed yet, a bounded number, become passes;
these and the alignment in force become the next version. So a run costs its new windows and not the history. Windows of
an epoch that identifies nothing stay, and are looked at again together with those that come.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from estimation.errors import DamagedError
from estimation.jobs.isolation import Isolation
from estimation.jobs.job import Job, JobContext
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.load_window import load_window
from estimation.jobs.steps.measured_wheelsets import Measured, measured
from estimation.jobs.steps.store_alignment import Epoch, EpochPasses, WindowKey, classes_of, store
from estimation.jobs.steps.vehicle_classes import ClassLookup
from estimation.motion.checks import gate
from estimation.motion.joined_windows import following, joined
from estimation.motion.usable_samples import straight_part
from estimation.storage import UnitOfWork
from estimation.track.epochs import epoch_digest, limit_batch, resampled
from estimation.track.examination import examine
from estimation.track.passes import Pass
from estimation.track.profile_life import ProfileLife, profile_life
from estimation.track.update import UpdateOutcome, update_alignment
from estimation.values.quarantine import SubjectKind
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.track import TrackAlignment, TrackReport, TrackSectionRecord
from estimation.values.windows import Window, WindowRecord
from estimation.vehicle.class_on_file import ClassOnFile

_COUNTED = {
    UpdateOutcome.UNESTIMATED: "unestimated",
    UpdateOutcome.KEPT: "kept",
    UpdateOutcome.SURVEY_KEPT: "kept",
    UpdateOutcome.NEW_VERSION: "versions",
    UpdateOutcome.SURVEY_EXTENDED: "versions",
    UpdateOutcome.SURVEY_REFUSED: "versions",
}
_UNDECIDED = {None, ReasonCode.SURVEY_NOT_ASSESSABLE, ReasonCode.MODEL_CONTRADICTED}  # a survey is judged again
_COUNTS = ("sections", "windows", "passes", "versions", "kept", "unestimated", "unchanged", "changed_meanwhile")


def run(context: JobContext) -> Mapping[str, int]:
    """Look at the new windows of every section; each epoch is committed together."""
    counts: Counter[str] = Counter(dict.fromkeys(_COUNTS, 0))
    isolation = Isolation(context, "refresh_alignment")
    with context.storage.read() as unit:
        sections = unit.tracks.sections()
    for section in sections:
        if isolation.waits(SubjectKind.SECTION, section.code):
            continue
        counts["sections"] += 1
        with isolation.alone(SubjectKind.SECTION, section.code):
            while _next_epoch(context, section, counts):
                pass
    counts["quarantined"] = isolation.quarantined
    return counts


JOB = Job("refresh_alignment", "Find the alignment of sections and the positions of windows", every_s=600.0, run=run)


@dataclass(frozen=True, slots=True)
class _Waiting:
    """New windows of a section and what was known of it when they were read."""

    records: Sequence[WindowRecord]
    lives: Sequence[ProfileLife]
    in_force: TrackAlignment | None
    looked_at: str | None  # digest of the last report
    verdict: Reason | None  # on the survey, while the version of the report that holds it is in force
    measured: Measured
    classes: Mapping[str, ClassOnFile]  # by vehicle, those on file
    assumed: Mapping[WindowKey, str]  # digest of what each window is looked at with


def _next_epoch(context: JobContext, section: TrackSectionRecord, counts: Counter[str]) -> bool:
    """Do one epoch of a section; return whether there may be another."""
    with context.storage.read() as unit:
        waiting = _waiting(unit, section, context)
    version = waiting.in_force.version if waiting.in_force is not None else None
    measured_curves = waiting.measured.curves
    digest = epoch_digest(waiting.records, version, context.code_version, measured_curves, waiting.assumed)
    if not waiting.records or digest == waiting.looked_at:
        counts["unchanged"] += 1
        return False
    epoch_passes = _passes(context, waiting)
    left = [record for record in waiting.records if (record.wheelset, record.start_ns) not in epoch_passes.refused]
    # what the next run would find again
    digest = epoch_digest(left, version, context.code_version, measured_curves, waiting.assumed)
    notes = waiting.measured.notes
    epoch = Epoch(section, waiting.records, waiting.in_force, digest, epoch_passes, notes, waiting.classes)
    update = update_alignment(
        section,
        epoch_passes.found,
        waiting.in_force,
        context.settings.alignment,
        survey_checked=code_of(waiting.verdict) not in _UNDECIDED,
        measured=measured_curves,
    )
    update = replace(update, survey=update.survey or waiting.verdict)
    with context.storage.write() as unit:
        stored = store(unit, epoch, update, context)
    counts[_COUNTED[update.outcome] if stored else "changed_meanwhile"] += 1
    counts["windows"] += len(waiting.records)
    counts["passes"] += len(epoch_passes.found)
    return stored and not update.outcome.windows_wait


def _waiting(unit: UnitOfWork, section: TrackSectionRecord, context: JobContext) -> _Waiting:
    settings, interval_km = context.settings.alignment, context.settings.estimation.interval_km
    records = unit.windows.unplaced(section.code, settings.most_windows)
    wheelsets = {serial: unit.registry.wheelset(serial) for serial in {record.wheelset for record in records}}
    lives = [profile_life(wheelsets[record.wheelset], record, interval_km) for record in records]
    chosen = limit_batch(records, lives, settings.most_wheelsets)
    in_force = unit.tracks.alignment(section.code)
    report = unit.tracks.report(section.code)
    current = report is not None and in_force is not None and report.version == in_force.version
    chosen_records, chosen_lives = [record for record, _ in chosen], [life for _, life in chosen]
    classes = ClassLookup(unit, context.settings.estimation)
    return _Waiting(
        records=chosen_records,
        lives=chosen_lives,
        in_force=in_force,
        looked_at=report.input_digest if report is not None else None,
        verdict=_verdict(report) if current and report is not None else None,
        measured=measured(unit, section, chosen_records, chosen_lives, settings.measured_km),
        classes=classes_of(classes, chosen_records),
        assumed={(r.wheelset, r.start_ns): classes.digest(r.vehicle, r.wheelset) for r in chosen_records},
    )


def _verdict(report: TrackReport) -> Reason | None:
    """Return what the report holds of the survey; None where the survey was not checked."""
    code, text = report.report.get("recording_code"), report.report.get("recording")
    return None if code is None else Reason(ReasonCode(str(code)), str(text))


def _passes(context: JobContext, waiting: _Waiting) -> EpochPasses:
    """Return the passes of the windows, and the reasons of windows that hold none; a few windows at a time in memory.

    Windows that follow each other are one pass, for its ends are lost to the filter.
    """
    settings, step = context.settings.estimation, context.settings.alignment.pass_step
    found: list[Pass] = []
    members: dict[WindowKey, tuple[WindowKey, ...]] = {}
    refused: dict[WindowKey, Reason] = {}
    clean = []
    for record, name in zip(waiting.records, waiting.lives, strict=True):
        gated = gate(record.quality, record.track_section, settings.gates)
        if gated is None:
            clean.append((record, name))
        else:
            refused[record.wheelset, record.start_ns] = gated
    keys = [((r.vehicle, r.axle, name), r.start_ns, r.start_ns + r.length_ns) for r, name in clean]
    done = len(refused)
    for group in following(clean, keys):
        context.checkpoint(done, len(waiting.records))
        done += len(group)
        for serials, made, reason in _examined(context, [record for record, _ in group], settings):
            found += [resampled(item, group[0][1], step) for item in made]
            members[serials[0]] = serials
            if not made and reason is not None:
                refused |= dict.fromkeys(serials, reason)
    return EpochPasses(found, members, refused)


def _examined(
    context: JobContext, records: Sequence[WindowRecord], settings: EstimationSettings
) -> list[tuple[tuple[WindowKey, ...], Sequence[Pass], Reason | None]]:
    """Return windows that follow each other, their passes, and why there is none."""
    windows: list[Window] = []
    found: list[tuple[tuple[WindowKey, ...], Sequence[Pass], Reason | None]] = []
    with context.storage.read() as unit:
        assumed = ClassLookup(unit, settings).assumed(records[0].vehicle, records[0].wheelset)
        if isinstance(assumed, Reason):
            return [(((record.wheelset, record.start_ns),), (), assumed) for record in records]
        mounting = unit.registry.mounting_at(records[0].vehicle, records[0].axle, records[0].start_ns)
        section = records[0].track_section
        layout = unit.tracks.layout(section) if section is not None else None
        for record in records:
            try:
                window = load_window(unit, record, assumed.windows.vehicle_class)
            except DamagedError as error:  # names the file; the other windows go on
                window = Reason(ReasonCode.FILE_DAMAGED, str(error))
            if not isinstance(window, Reason):
                window = straight_part(window, layout, settings.signals)
            if isinstance(window, Reason):
                found.append((((record.wheelset, record.start_ns),), (), window))
            else:
                windows.append(window)
    turned = mounting is not None and mounting.reversed
    keys = [(w.sample_interval_s, w.start_ns, w.start_ns + w.length_ns) for w in windows]
    for group in following(windows, keys):
        examined = examine(joined(group), assumed.windows, mounted_reversed=turned)
        serials = tuple((window.wheelset, window.start_ns) for window in group)
        found.append((serials, examined.passes, examined.outcome.reason))
    return found
