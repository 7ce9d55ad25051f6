"""What an epoch found, into the store: version, report, positions, and what it shows of the suspension of vehicles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimation.jobs.job import JobContext
from estimation.jobs.parameters import JOBS
from estimation.jobs.steps.assumptions import ClassLookup
from estimation.jobs.steps.epoch_inputs import Due, given
from estimation.jobs.steps.epoch_passes import Solved, place_windows
from estimation.jobs.steps.load_window import assemble_if_lost
from estimation.storage import UnitOfWork
from estimation.track.parameters import TRACK
from estimation.track.passes import Journey
from estimation.track.settings import AlignmentSettings, changed_vehicles, requires_reestimation
from estimation.track.update import AlignmentUpdate
from estimation.values.fields import JsonValue
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of
from estimation.values.track import Correction, FoldState, FoundOfVehicles, TrackAlignment, TrackEpoch, TrackReport
from estimation.values.trend import SuspensionFinding
from estimation.values.windows import WindowKey, WindowRecord
from estimation.vehicle.vehicle_class import ClassOnFile

_UNDECIDED = {None, ReasonCode.SURVEY_NOT_ASSESSABLE, ReasonCode.MODEL_CONTRADICTED}  # a survey is judged again


@dataclass(frozen=True, slots=True)
class Computed:
    """An epoch with what was found; the first part makes the version, the others are placed on it."""

    due: Due
    before: TrackAlignment | None
    parts: Sequence[Solved]
    classes: Mapping[str, ClassOnFile]  # by vehicle; those on file when it was read
    notes: tuple[str, ...]  # on evidence that could not be used
    alone: Mapping[Journey, Correction]  # journeys on the alignment before, each by itself

    @property
    def update(self) -> AlignmentUpdate:
        """What the epoch makes of the alignment."""
        return self.parts[0].update


def survey_checked(survey: Reason | None) -> bool:
    """Return whether a survey has been decided on, by what the fleet has found of it; None: it was not checked."""
    return code_of(survey) not in _UNDECIDED


def store_epoch(
    unit: UnitOfWork, computed: Computed, context: JobContext, standing: Mapping[WindowKey, WindowRecord]
) -> None:
    """Store what an epoch makes of a section.

    Windows of an epoch that identified nothing are left for the next, but for those that hold no pass: it is computed
    again with them. This transaction holds its windows as they are ``standing``.
    """
    due, section = computed.due, computed.due.section.code
    after = _after(unit, computed, context)
    report = _report(unit, computed, after.version, context)
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
        report=report,
        recorded_ns=context.clock.now_ns(),
    )
    behind = due.old is None or due.old.after != after  # the epochs behind it start from something else
    if behind and due.number < len(due.stored):
        unit.epochs.start_again(section, due.number)
    _supersede(unit, due, after, context, kept=0 if behind else due.number)
    unit.suspensions.forget(section, due.number, behind=behind)
    _store_suspensions(unit, epoch, computed, context)
    for part in computed.parts:
        for record in part.records:
            if (refusal := part.passes.refused.get((record.wheelset, record.start_ns))) is not None:
                assemble_if_lost(unit, record, refusal)
        alone = computed.alone if epoch.estimated_on == due.before.version else {}
        place_windows(unit, part, after.version, alone, standing, waits=epoch.waits)
    of_vehicles = _of_vehicles(unit, computed, after, context.settings.alignment)
    unit.epochs.put(epoch, due.own)
    if due.old is not None or of_vehicles is not None:
        unit.epochs.put_found(section, due.number, of_vehicles)
    if epoch.waits and not behind and due.number < len(due.stored):
        unit.epochs.stale(section, due.number + 1)


def _store_suspensions(unit: UnitOfWork, epoch: TrackEpoch, computed: Computed, context: JobContext) -> None:
    """Store the stiffness ratio of every vehicle that the epoch shows."""
    update, records = computed.update, computed.parts[0].records
    iterated = update.estimate.iterated
    if iterated is None or not update.estimate.report.converged or update.outcome.windows_wait:
        return
    most_std = JOBS.learnt_std_share * TRACK.ratio_prior_std
    for code, ratio in sorted(iterated.ratios.items()):
        windows = [record for record in records if record.vehicle == code]
        if not windows or code not in computed.classes or not 0.0 < ratio.std <= most_std:
            continue
        vehicle = computed.classes[code].vehicle_class.parameters
        finding = SuspensionFinding(
            vehicle=code,
            section=epoch.section,
            from_ns=min(record.start_ns for record in windows),
            to_ns=max(record.start_ns + record.length_ns for record in windows),
            ratio=ratio.value,
            ratio_std=ratio.std,
            assumed=vehicle.yaw_stiffness / vehicle.longitudinal_creep_coefficient,
            code_version=context.code_version,
            recorded_ns=context.clock.now_ns(),
        )
        unit.suspensions.put(finding, epoch.number)


def cut(unit: UnitOfWork, due: Due, context: JobContext) -> None:
    """Forget an epoch that has no window any more, and those behind it."""
    unit.epochs.start_again(due.section.code, due.number - 1)
    unit.suspensions.forget(due.section.code, due.number, behind=True)
    _supersede(unit, due, due.before, context, kept=0)


def rests_on_other(unit: UnitOfWork, due: Due, classes: Mapping[str, ClassOnFile], context: JobContext) -> bool:
    """Return whether what is on file of the section of an epoch, or of its vehicles, is another by now."""
    if given(unit, due.section, context.settings)[0] != due.basis:
        return True
    records = [record for record, _ in due.entries]
    return classes_of(ClassLookup(unit, context.settings.estimation), records) != classes


def _after(unit: UnitOfWork, computed: Computed, context: JobContext) -> FoldState:
    """Return what is known after an epoch, with its alignment stored where that is a version of its own."""
    due, update = computed.due, computed.update
    before, section = due.before, due.section.code
    survey = update.survey or before.survey
    if not update.outcome.makes_version or update.alignment is None:
        return FoldState(before.version, before.same_since, survey)
    base = None if before.same_since is None else unit.tracks.alignment(section, before.same_since)
    same = is_hardly_another(base, update, context.settings.alignment)
    since = before.same_since if same else None
    old = due.old.after.version if due.old is not None else None
    if old is not None and old > (before.version or 0):
        oldest = old if since is None else since
        if unit.tracks.same_content(section, old, update.alignment, oldest):
            return FoldState(old, oldest, survey)
    _supersede(unit, due, before, context, kept=0)
    version = unit.tracks.add_alignment(update.alignment, same_since=since, recorded_ns=context.clock.now_ns())
    return FoldState(version, version if since is None else since, survey)


def is_hardly_another(base: TrackAlignment | None, update: AlignmentUpdate, settings: AlignmentSettings) -> bool:
    """Return whether what an epoch makes of the alignment is, for its windows, the one that was in force before.

    ``base`` is the oldest version from which the one in force does not differ materially.
    """
    if base is None:
        return False
    if not update.outcome.makes_version or update.alignment is None:
        return True
    return not requires_reestimation(base, update.alignment, settings)


def _estimated_on(computed: Computed, after: FoldState) -> int | None:
    """Return the version that windows of an epoch are estimated on: the one before where its own is hardly another.

    Then an epoch that is computed again with windows that have come does not change those that had. What the gauge does
    to a wheelset changes on the lathe, and is always that of its own epoch.
    """
    before, alignment = computed.due.before, computed.update.alignment
    if before.version is None or after.same_since != before.same_since:
        return after.version
    moved_by_gauge = alignment is not None and alignment.findings is not None and bool(alignment.findings.gauge_shifts)
    return after.version if moved_by_gauge else before.version


def _of_vehicles(
    unit: UnitOfWork, computed: Computed, after: FoldState, settings: AlignmentSettings
) -> FoundOfVehicles | None:
    """Return which vehicles' windows are to be estimated on a version that is no other for the rest; None for none."""
    due, alignment = computed.due, computed.update.alignment
    before = due.before
    if after.version is None or after.version == before.version or alignment is None:
        return None
    if before.same_since is None or after.same_since != before.same_since:
        return None
    base = unit.tracks.alignment(due.section.code, before.same_since)
    assert base is not None
    vehicles = {record.wheelset: record.vehicle for record, _ in due.entries}
    since = unit.epochs.found(due.section.code, due.number, before.same_since)
    changed = changed_vehicles(base, alignment, settings, vehicles, since, computed.before)
    return FoundOfVehicles(after.version, changed) if changed else None


def _supersede(unit: UnitOfWork, due: Due, after: FoldState, context: JobContext, *, kept: int) -> None:
    """Mark what no longer follows from what is stored; the epochs behind number ``kept`` count where it is not 0."""
    chain = [*due.stored[: due.number - 1], *(due.stored[kept:] if kept else ())]
    versions = {epoch.after.version for epoch in chain} | {after.version}
    standing = {version for version in versions if version is not None}
    unit.tracks.supersede(due.section.code, standing, context.clock.now_ns())


def _report(unit: UnitOfWork, computed: Computed, version: int | None, context: JobContext) -> int:
    update, refused = computed.update, computed.parts[0].passes.refused
    report = update.estimate.report
    survey = update.survey or computed.due.before.survey
    extra: dict[str, JsonValue] = {
        "evidence": [*report.evidence, *computed.notes],
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
            status=report.status,
            reason=report.reason,
            windows=len(computed.due.entries),
            input_digest=computed.due.digest,
            code_version=context.code_version,
            report=dict(report.as_json()) | extra,
            recorded_ns=context.clock.now_ns(),
        )
    )


def classes_of(classes: ClassLookup, records: Sequence[WindowRecord]) -> dict[str, ClassOnFile]:
    """Return the class of each vehicle of windows, where it is on file."""
    vehicles = sorted({record.vehicle for record in records})
    classes.look_up((), vehicles)
    on_file = {vehicle: classes.of_vehicle(vehicle) for vehicle in vehicles}
    return {vehicle: of_class for vehicle, of_class in on_file.items() if not isinstance(of_class, Reason)}


def _provenance(classes: Mapping[str, ClassOnFile]) -> JsonValue:
    by_code = {on_file.vehicle_class.code: on_file for on_file in classes.values()}
    return {code: {"version": stored.version, "digest": stored.digest} for code, stored in sorted(by_code.items())}


def _counted(reasons: Sequence[str]) -> JsonValue:
    return {reason: reasons.count(reason) for reason in sorted(set(reasons))}
