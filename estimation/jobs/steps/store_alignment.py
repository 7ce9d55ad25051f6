"""What an epoch found, into the store: the version, the report, and where each window was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.jobs.job import JobContext
from estimation.jobs.steps.epoch_inputs import given
from estimation.jobs.steps.epoch_passes import EpochPasses, WindowKey
from estimation.jobs.steps.lost_windows import assemble_if_lost
from estimation.jobs.steps.suspension import store_suspension
from estimation.jobs.steps.vehicle_classes import ClassLookup
from estimation.storage import UnitOfWork
from estimation.track.journeys import Journey
from estimation.track.partition import Entry
from estimation.track.screening.screen import PassStatus
from estimation.track.settings import AlignmentSettings
from estimation.track.update import AlignmentUpdate
from estimation.track.versions import changed_vehicles, requires_reestimation
from estimation.values.json_value import JsonValue
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of
from estimation.values.track import Correction, TrackAlignment, TrackReport, TrackSectionRecord
from estimation.values.track_epochs import EpochMember, FoldState, FoundOfVehicles, TrackEpoch
from estimation.values.windows import WindowPosition, WindowRecord, WindowState
from estimation.vehicle.class_on_file import ClassOnFile

_UNDECIDED = {None, ReasonCode.SURVEY_NOT_ASSESSABLE, ReasonCode.MODEL_CONTRADICTED}  # a survey is judged again


@dataclass(frozen=True, slots=True)
class Due:
    """An epoch that has to be looked at, with the epochs as they were read.

    Without windows of its own it and those behind it have none left. ``same`` is set where it rests on what it did.
    """

    section: TrackSectionRecord
    number: int
    stored: Sequence[TrackEpoch]
    before: FoldState
    basis: str  # digest of what all epochs rest on
    own: Sequence[EpochMember] = ()
    entries: Sequence[Entry] = ()  # its own windows and those that wait
    digest: str = ""
    horizon_ns: int = 0
    same: TrackEpoch | None = None

    @property
    def old(self) -> TrackEpoch | None:
        """The epoch as it was computed last."""
        return self.stored[self.number - 1] if self.number <= len(self.stored) else None


@dataclass(frozen=True, slots=True)
class Solved:
    """Windows, their passes, and what follows from them."""

    records: Sequence[WindowRecord]
    passes: EpochPasses
    update: AlignmentUpdate


@dataclass(frozen=True, slots=True)
class Computed:
    """An epoch with what was found; the first part makes the version, the others are placed on it."""

    due: Due
    before: TrackAlignment | None
    parts: Sequence[Solved]
    classes: Mapping[str, ClassOnFile]  # by vehicle; those on file when it was read
    notes: tuple[str, ...]  # on evidence that could not be used

    @property
    def update(self) -> AlignmentUpdate:
        """What the epoch makes of the alignment."""
        return self.parts[0].update


def survey_checked(survey: Reason | None) -> bool:
    """Return whether a survey has been decided on.

    Parameters
    ----------
    survey
        What the fleet has found of it; None where it was not checked.
    """
    return code_of(survey) not in _UNDECIDED


def store(unit: UnitOfWork, computed: Computed, context: JobContext) -> bool:
    """Store what an epoch makes of a section, unless what it rests on has changed since it was read.

    Windows of an epoch that identified nothing are left for the next, but for those that hold no pass.

    Parameters
    ----------
    unit
        A transaction to write in.
    computed
        What was found.
    context
        Settings, clock and code version of the job.

    Returns
    -------
    bool
        Whether it was stored.
    """
    due, section = computed.due, computed.due.section.code
    if _changed(unit, computed, context):
        return False
    after = _after(unit, computed, context)
    found = _report(unit, computed, after.version, context)
    epoch = TrackEpoch(
        section=section,
        number=due.number,
        before=due.before.key(due.basis),
        input_digest=due.digest,
        horizon_ns=due.horizon_ns,
        windows=len(due.own),
        waits=computed.update.outcome.windows_wait,
        after=after,
        estimated_on=_estimated_on(computed, after),
        report=found,
        recorded_ns=context.clock.now_ns(),
    )
    behind = due.old is None or due.old.after != after  # the epochs behind it start from something else
    if behind:
        unit.epochs.start_again(section, due.number)
    _supersede(unit, due, after, context, kept=0 if behind else due.number)
    unit.suspensions.forget(section, due.number, behind=behind)
    store_suspension(unit, epoch, computed.parts[0].records, computed.update, computed.classes, context)
    for part in computed.parts:
        for record in part.records:
            if (refusal := part.passes.refused.get((record.wheelset, record.start_ns))) is not None:
                assemble_if_lost(unit, record, refusal)
        _place_all(unit, part, after.version, context.settings.alignment, waits=epoch.waits)
    of_vehicles = _of_vehicles(unit, computed, after, context.settings.alignment)
    unit.epochs.put(epoch, due.own)
    unit.epochs.put_found(section, due.number, of_vehicles)
    return True


def cut(unit: UnitOfWork, due: Due, context: JobContext) -> None:
    """Forget an epoch that has no window any more, and those behind it.

    Parameters
    ----------
    unit
        A transaction to write in.
    due
        The epoch.
    context
        Clock of the job.
    """
    unit.epochs.start_again(due.section.code, due.number - 1)
    unit.suspensions.forget(due.section.code, due.number, behind=True)
    _supersede(unit, due, due.before, context, kept=0)


def _changed(unit: UnitOfWork, computed: Computed, context: JobContext) -> bool:
    due = computed.due
    if unit.epochs.list(due.section.code)[: due.number] != due.stored[: due.number]:
        return True
    if given(unit, due.section, context.settings)[0] != due.basis:
        return True
    records = [record for record, _ in due.entries]
    return classes_of(ClassLookup(unit, context.settings.estimation), records) != computed.classes


def _after(unit: UnitOfWork, computed: Computed, context: JobContext) -> FoldState:
    """Return what is known after an epoch, with its alignment stored where that is a version of its own."""
    due, update = computed.due, computed.update
    before, section = due.before, due.section.code
    survey = update.survey or before.survey
    if not update.outcome.makes_version or update.alignment is None:
        return FoldState(before.version, before.same_since, survey)
    base = None if before.same_since is None else unit.tracks.alignment(section, before.same_since)
    same = base is not None and not requires_reestimation(base, update.alignment, context.settings.alignment)
    since = before.same_since if same else None
    old = due.old.after.version if due.old is not None else None
    if old is not None and old > (before.version or 0):
        oldest = old if since is None else since
        if unit.tracks.same_content(section, old, update.alignment, oldest):
            return FoldState(old, oldest, survey)
    _supersede(unit, due, before, context, kept=0)
    version = unit.tracks.add_alignment(update.alignment, same_since=since, recorded_ns=context.clock.now_ns())
    return FoldState(version, version if since is None else since, survey)


def _estimated_on(computed: Computed, after: FoldState) -> int | None:
    """Return the version that windows of an epoch are estimated on: the one before where its own is hardly another.

    Then an epoch that is computed again with windows that have come does not change those that had. What the gauge does
    to a wheelset changes on the lathe, and is always that of its own epoch.
    """
    before, found = computed.due.before, computed.update.alignment
    if before.version is None or after.same_since != before.same_since:
        return after.version
    moved_by_gauge = found is not None and found.findings is not None and bool(found.findings.gauge_shifts)
    return after.version if moved_by_gauge else before.version


def _of_vehicles(
    unit: UnitOfWork, computed: Computed, after: FoldState, settings: AlignmentSettings
) -> FoundOfVehicles | None:
    """Return which vehicles' windows are to be estimated on a version that is no other for the rest; None for none."""
    due, found = computed.due, computed.update.alignment
    before = due.before
    if after.version is None or after.version == before.version or found is None:
        return None
    if before.same_since is None or after.same_since != before.same_since:
        return None
    base = unit.tracks.alignment(due.section.code, before.same_since)
    assert base is not None
    vehicles = {record.wheelset: record.vehicle for record, _ in due.entries}
    since = unit.epochs.found(due.section.code, due.number, before.same_since)
    changed = changed_vehicles(base, found, settings, vehicles, since, computed.before)
    return FoundOfVehicles(after.version, changed) if changed else None


def _supersede(unit: UnitOfWork, due: Due, after: FoldState, context: JobContext, *, kept: int) -> None:
    """Mark what no longer follows from what is stored; the epochs behind number ``kept`` count where it is not 0."""
    chain = [*due.stored[: due.number - 1], *(due.stored[kept:] if kept else ())]
    versions = {epoch.after.version for epoch in chain} | {after.version}
    standing = {version for version in versions if version is not None}
    unit.tracks.supersede(due.section.code, standing, context.clock.now_ns())


def _report(unit: UnitOfWork, computed: Computed, version: int | None, context: JobContext) -> int:
    update, refused = computed.update, computed.parts[0].passes.refused
    found = update.estimate.report
    survey = update.survey or computed.due.before.survey
    extra: dict[str, JsonValue] = {
        "evidence": [*found.evidence, *computed.notes],
        "recording": text_of(survey),
        "recording_code": code_of(survey),
        "refused_windows": _counted([reason.text for reason in refused.values()]),
        "refused_windows_by_code": _counted([reason.code for reason in refused.values()]),
        "parameters": context.settings.alignment_parameters() | {"vehicle_classes": _provenance(computed.classes)},
    }
    return unit.tracks.add_report(
        TrackReport(
            section=computed.due.section.code,
            version=version,
            made=update.outcome.makes_version,
            status=found.status,
            reason=found.reason,
            windows=len(computed.due.entries),
            input_digest=computed.due.digest,
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


def _place_all(
    unit: UnitOfWork, part: Solved, version: int | None, settings: AlignmentSettings, *, waits: bool
) -> None:
    """Store where windows were; what was known of the others is forgotten."""
    found = _positions(part, version, settings, waits=waits)
    for position in found:
        _place(unit, position)
    placed = {(position.wheelset, position.start_ns) for position in found}
    for record in part.records:
        if (record.wheelset, record.start_ns) not in placed:
            unit.tracks.forget_position(record.wheelset, record.start_ns)


def _positions(
    part: Solved, version: int | None, settings: AlignmentSettings, *, waits: bool
) -> Sequence[WindowPosition]:
    """Return where the windows were, as far as it has been found."""
    epoch, update = part, part.update
    journey_of = _journeys_of_windows(part)
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
        if key in refusals and (key in epoch.passes.refused or not waits):
            # on a survey a window needs no pass, unless its pass contradicts the survey
            accepted = update.outcome.positions_valid and key not in contradicted
            found.append(uncorrected if accepted else replace(uncorrected, reason=refusals[key]))
        elif not waits and key in journey_of:
            found.append(_corrected(uncorrected, journey_of[key], update, outliers, settings))
    return found


def _journeys_of_windows(part: Solved) -> dict[WindowKey, Journey]:
    """Return the journey of every window whose pass was used."""
    return {
        key: journey
        for journey, members in part.update.estimate.grouped.items()
        for item in members
        for key in part.passes.windows(item)
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
    now = (position.offset_m, position.scale, position.reason)
    was = (before.offset_m, before.scale, before.reason) if before is not None else (0.0, 0.0, None)
    window = unit.windows.get(position.wheelset, position.start_ns)
    if now != was and window is not None and window.state is not WindowState.PENDING:
        unit.windows.mark(position.wheelset, position.start_ns, WindowState.PENDING)
