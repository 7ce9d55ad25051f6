"""What an epoch found, into the store: the version, the report, and where each window was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.jobs.job import JobContext
from estimation.jobs.steps.lost_windows import assemble_if_lost
from estimation.jobs.steps.suspension import store_suspension
from estimation.jobs.steps.vehicle_classes import ClassLookup
from estimation.storage import UnitOfWork
from estimation.track.journeys import Journey
from estimation.track.passes import Pass
from estimation.track.screening.screen import PassStatus
from estimation.track.settings import AlignmentSettings
from estimation.track.update import AlignmentUpdate
from estimation.track.versions import requires_reestimation
from estimation.values.json_value import JsonValue
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of
from estimation.values.track import Correction, TrackAlignment, TrackReport, TrackSectionRecord
from estimation.values.windows import WindowPosition, WindowRecord, WindowState
from estimation.vehicle.class_on_file import ClassOnFile

WindowKey = tuple[str, int]  # wheelset, start


@dataclass(frozen=True, slots=True)
class EpochPasses:
    """Passes, the windows that each was made of (by its wheelset and start), and why others hold none."""

    found: Sequence[Pass]
    members: Mapping[WindowKey, Sequence[WindowKey]]
    refused: Mapping[WindowKey, Reason]

    def windows(self, item: Pass) -> Sequence[WindowKey]:
        """Return the windows of a pass."""
        return self.members[item.wheelset, item.start_ns]


@dataclass(frozen=True, slots=True)
class Epoch:
    """The windows of an epoch, what was known before, and the passes that were made of them."""

    section: TrackSectionRecord
    records: Sequence[WindowRecord]
    before: TrackAlignment | None
    digest: str
    passes: EpochPasses
    notes: tuple[str, ...] = ()  # on evidence that could not be used
    classes: Mapping[str, ClassOnFile] = field(default_factory=dict)  # by vehicle; those on file when it was read


def store(unit: UnitOfWork, epoch: Epoch, update: AlignmentUpdate, context: JobContext) -> bool:
    """Store what an epoch makes of a section, unless its alignment or a class has changed since the epoch was read.

    Windows of an epoch that identified nothing are left for the next, but for those that hold no pass.

    Parameters
    ----------
    unit
        A transaction to write in.
    epoch
        Its windows and passes.
    update
        What was found.
    context
        Settings, clock and code version of the job.

    Returns
    -------
    bool
        Whether it was stored.
    """
    now = unit.tracks.in_force(epoch.section.code)
    expected = epoch.before.version if epoch.before is not None else None
    if (now.version if now is not None else None) != expected:
        return False
    if classes_of(ClassLookup(unit, context.settings.estimation), epoch.records) != epoch.classes:
        return False
    version = expected
    if update.outcome.makes_version and update.alignment is not None:
        version = _next_version(unit, epoch, update.alignment, context)
    _report(unit, epoch, update, version, context)
    store_suspension(unit, epoch.section.code, epoch.records, update, epoch.classes, context)
    for position in _positions(epoch, update, version, context.settings.alignment):
        _place(unit, position)
    for record in epoch.records:
        if (refusal := epoch.passes.refused.get((record.wheelset, record.start_ns))) is not None:
            assemble_if_lost(unit, record, refusal)
    return True


def _next_version(unit: UnitOfWork, epoch: Epoch, alignment: TrackAlignment, context: JobContext) -> int:
    """Store an alignment with the oldest version whose results need not be estimated again."""
    now = unit.tracks.in_force(epoch.section.code)
    base = unit.tracks.alignment(epoch.section.code, now.same_since) if now is not None else None
    same_since = None
    if base is not None and not requires_reestimation(base, alignment, context.settings.alignment):
        same_since = base.version
    return unit.tracks.add_alignment(alignment, same_since=same_since, recorded_ns=context.clock.now_ns())


def _report(unit: UnitOfWork, epoch: Epoch, update: AlignmentUpdate, version: int | None, context: JobContext) -> None:
    found = update.estimate.report
    extra: dict[str, JsonValue] = {
        "evidence": [*found.evidence, *epoch.notes],
        "recording": text_of(update.survey),
        "recording_code": code_of(update.survey),
        "refused_windows": _counted([reason.text for reason in epoch.passes.refused.values()]),
        "refused_windows_by_code": _counted([reason.code for reason in epoch.passes.refused.values()]),
        "parameters": context.settings.alignment_parameters() | {"vehicle_classes": _provenance(epoch.classes)},
    }
    unit.tracks.add_report(
        TrackReport(
            section=epoch.section.code,
            version=version,
            made=update.outcome.makes_version,
            status=found.status,
            reason=found.reason,
            windows=len(epoch.records),
            input_digest=epoch.digest,
            code_version=context.code_version,
            report=dict(found.as_json()) | extra,
            recorded_ns=context.clock.now_ns(),
        )
    )


def classes_of(classes: ClassLookup, records: Sequence[WindowRecord]) -> dict[str, ClassOnFile]:
    """Return the class of each vehicle of windows, where it is on file.

    Parameters
    ----------
    classes
        As on file.
    records
        Windows.
    """
    found = {vehicle: classes.of_vehicle(vehicle) for vehicle in sorted({record.vehicle for record in records})}
    return {vehicle: one for vehicle, one in found.items() if not isinstance(one, Reason)}


def _provenance(classes: Mapping[str, ClassOnFile]) -> JsonValue:
    """Return version and digest of each class, by code."""
    by_code = {one.vehicle_class.code: one for one in classes.values()}
    return {code: {"version": one.version, "digest": one.digest} for code, one in sorted(by_code.items())}


def _counted(reasons: Sequence[str]) -> JsonValue:
    """Return how often each reason occurs."""
    return {reason: reasons.count(reason) for reason in sorted(set(reasons))}


def _positions(
    epoch: Epoch, update: AlignmentUpdate, version: int | None, settings: AlignmentSettings
) -> Sequence[WindowPosition]:
    """Return where the windows were, as far as it has been found."""
    journey_of = _journeys_of_windows(epoch, update)
    unused = {
        key: outcome
        for item, outcome in zip(epoch.passes.found, update.pass_outcomes, strict=True)
        for key in epoch.passes.windows(item)
        if outcome.reason and key not in journey_of
    }
    contradicted = {key for key, outcome in unused.items() if outcome.status is PassStatus.REFUSED}
    refusals = {**epoch.passes.refused, **{key: outcome.reason for key, outcome in unused.items() if outcome.reason}}
    outliers = {(one.vehicle, one.from_ns): one.reason for one in update.estimate.report.journeys if not one.used}
    found = []
    for record in epoch.records:
        key = (record.wheelset, record.start_ns)
        uncorrected = WindowPosition(record.wheelset, record.start_ns, record.content_digest, version)
        if key in refusals and (key in epoch.passes.refused or not update.outcome.windows_wait):
            # on a survey a window needs no pass, unless its pass contradicts the survey
            accepted = update.outcome.positions_valid and key not in contradicted
            found.append(uncorrected if accepted else replace(uncorrected, reason=refusals[key]))
        elif not update.outcome.windows_wait and key in journey_of:
            found.append(_corrected(uncorrected, journey_of[key], update, outliers, settings))
    return found


def _journeys_of_windows(epoch: Epoch, update: AlignmentUpdate) -> dict[WindowKey, Journey]:
    """Return the journey of every window whose pass was used."""
    return {
        key: journey
        for journey, members in update.estimate.grouped.items()
        for item in members
        for key in epoch.passes.windows(item)
    }


def _corrected(
    uncorrected: WindowPosition,
    journey: Journey,
    update: AlignmentUpdate,
    outliers: Mapping[Journey, Reason | None],
    settings: AlignmentSettings,
) -> WindowPosition:
    correction = update.estimate.corrections.get(journey)
    if update.outcome.positions_valid:
        far = correction is not None and _largest(correction) > settings.trusted_offset
        return uncorrected if correction is None or not far else _moved(uncorrected, correction)
    if journey in outliers:
        return replace(uncorrected, reason=_uncertain(f": {outliers[journey]}"))
    if correction is None:
        return replace(uncorrected, reason=_uncertain())
    return _moved(uncorrected, correction)


def _uncertain(why: str = "") -> Reason:
    return Reason(ReasonCode.POSITION_UNCERTAIN, f"its position along the section is not certain{why}")


def _moved(uncorrected: WindowPosition, correction: Correction) -> WindowPosition:
    return replace(uncorrected, offset_m=correction.offset, scale=correction.scale, middle_m=correction.middle)


def _largest(correction: Correction) -> float:
    """Return the largest shift between the begin and twice the middle of the section, m."""
    ends = np.array([0.0, 2.0 * correction.middle])
    return float(np.abs(correction.at(ends) - ends).max())


def _place(unit: UnitOfWork, position: WindowPosition) -> None:
    """Store where a window was; one that had been estimated elsewhere waits again."""
    before = unit.tracks.position(position.wheelset, position.start_ns)
    if not unit.tracks.put_position(position):
        return
    now = (position.offset_m, position.scale, code_of(position.reason))
    was = (before.offset_m, before.scale, code_of(before.reason)) if before is not None else (0.0, 0.0, None)
    window = unit.windows.get(position.wheelset, position.start_ns)
    if now != was and window is not None and window.state is not WindowState.PENDING:
        unit.windows.mark(position.wheelset, position.start_ns, WindowState.PENDING)
