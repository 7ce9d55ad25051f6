"""Stage: windows of a section, in epochs of vehicle time, give its alignment, which corrects their positions.

The windows of each section are divided into epochs, a function of the set of windows. Those of an epoch become passes;
these and what was known after the epoch before become the next version. So what is known of a section does not depend
on when its windows came. An epoch is computed again when one of its windows has changed, or what it started from; so a
run costs its new windows and not the history. Windows of an epoch that identifies nothing are looked at again together
with those of the next. One epoch is computed at a time; a section on which nothing has happened is not read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import attrgetter

from estimation.errors import ConflictError
from estimation.jobs.job import Job, JobContext
from estimation.jobs.runner import run
from estimation.jobs.settings import JobSettings
from estimation.jobs.stage import Counted, Outcome, Part, Stage, made_from
from estimation.jobs.steps.assumptions import ClassLookup
from estimation.jobs.steps.bogie_track import with_bogies
from estimation.jobs.steps.epoch_inputs import Due, EpochSearch, FileLookup, Found, changed_from, otherwise_on_file
from estimation.jobs.steps.epoch_passes import RunsOnFile, Solved, epoch_passes
from estimation.jobs.steps.measured_wheelsets import Measured, measured
from estimation.jobs.steps.store_alignment import (
    Computed,
    classes_of,
    cut,
    is_hardly_another,
    rests_on_other,
    store_epoch,
    survey_checked,
)
from estimation.storage import UnitOfWork
from estimation.track.passes import Entry, Journey, newest_within
from estimation.track.results import place_alone
from estimation.track.settings import AlignmentSettings
from estimation.track.update import UpdateOutcome, update_alignment
from estimation.values.runs import Due as Seen
from estimation.values.runs import Facet, Mark, StageInputs, SubjectKind
from estimation.values.track import Correction, TrackAlignment, TrackSectionRecord
from estimation.values.units import LATEST_NS
from estimation.values.windows import DueStage, WindowKey, WindowRecord
from estimation.vehicle.vehicle_class import ClassOnFile

_COUNTED = {
    UpdateOutcome.UNESTIMATED: "unestimated",
    UpdateOutcome.KEPT: "kept",
    UpdateOutcome.SURVEY_KEPT: "kept",
    UpdateOutcome.NEW_VERSION: "versions",
    UpdateOutcome.SURVEY_EXTENDED: "versions",
    UpdateOutcome.SURVEY_REFUSED: "versions",
}
_COUNTS = ("epochs", "windows", "passes", "kept", "unestimated", "changed_meanwhile")
_HELD = attrgetter("track_section", "vehicle", "content_digest", "mileage_km", "samples_purged")


@dataclass(frozen=True, slots=True)
class OnFile:
    """What has been seen of the files of a section, and what follows from it."""

    seen: Seen | None = None  # as it is to be noted; None where nothing is on file that was not seen
    # starts of windows that are looked at otherwise, by key
    changed: Mapping[WindowKey, int] = field(default_factory=dict)
    # vehicle, wheelset and digest of what is on file where it changes nothing
    unaffected: Sequence[tuple[str, str, str]] = ()


@dataclass(frozen=True, slots=True)
class Known:
    """What an epoch is solved with."""

    alignment: TrackAlignment | None  # after the epoch before; None where nothing is known
    base: TrackAlignment | None  # the oldest version from which that does not differ materially
    classes: Mapping[str, ClassOnFile]  # by vehicle
    on_file: RunsOnFile  # what else windows are looked at with
    # windows that are solved together, those that make the version first, with what was measured of their wheelsets
    chosen: Sequence[tuple[Sequence[Entry], Measured]]


@dataclass(frozen=True, slots=True)
class FoldInputs:
    """What is to be done of the epochs of a section; samples are read where they are looked at."""

    section: str
    versions: int  # of what is declared, as of these inputs
    number: int | None  # of the epoch that is due; None for none
    digest: str  # of what that rests on
    later: bool  # whether the last epoch is left for a later run
    last: bool  # whether nothing else is due once the epoch is stored
    # windows that are listed and done with when this is stored, with the versions that were read
    seen: Mapping[WindowKey, int]
    on_file: OnFile
    found: Found = field(metadata={"made_from": False})
    known: Known | None = field(metadata={"made_from": False})  # None where no epoch is due, or it has no window left
    context: JobContext = field(metadata={"made_from": False})

    @property
    def writes(self) -> bool:
        """Whether anything is to be stored: else the section is at rest."""
        return bool(self.found.due or self.found.kept or self.seen or self.on_file.seen)


def load(unit: UnitOfWork, codes: Sequence[str], context: JobContext) -> Mapping[str, FoldInputs]:
    """Return what is to be done of some sections; those that are not on file any more are left out."""
    sections = {section.code: section for section in unit.tracks.sections()}
    return {code: _inputs(unit, sections[code], context) for code in codes if code in sections}


def _inputs(unit: UnitOfWork, section: TrackSectionRecord, context: JobContext) -> FoldInputs:
    code, settings = section.code, context.settings.alignment
    lookup = FileLookup(unit, context.settings, ClassLookup(unit, context.settings.estimation))
    stored = unit.epochs.list(code)
    on_file = _on_file(unit, lookup, code, context) if stored else OnFile()
    listed_ns = changed_from(unit, lookup, code) if stored else None
    starts = (listed_ns, *on_file.changed.values())
    changed_ns = min((start_ns for start_ns in starts if start_ns is not None), default=None)
    search = EpochSearch(unit, context, section, lookup, stored, changed_ns).found()
    due = search.due
    held = {member.record.key for kept in search.kept for member in kept.own}
    held |= {member.record.key for member in due.own} if due is not None else set()
    until_ns = max((start_ns for _, start_ns in held), default=0)
    last = search.last and all(key in held for key in on_file.changed)
    at_rest = last or (due is None and not search.later)
    seen = unit.due.of_section(DueStage.ALIGNMENT, code, None if at_rest else until_ns)
    return FoldInputs(
        section=code,
        versions=_versions(unit, code, context),
        number=None if due is None else due.number,
        digest="" if due is None else due.digest,
        later=search.later,
        last=last,
        seen={key: version for key, version in seen.items() if at_rest or key in held},
        on_file=on_file,
        found=search,
        known=_known(unit, due, lookup.classes, settings) if due is not None and due.own else None,
        context=context,
    )


def _versions(unit: UnitOfWork, code: str, context: JobContext) -> int:
    """Return the sum of the versions of what the stage declares of a section that is due; 0 where it is at rest."""
    return unit.marks.due(ALIGNMENT.inputs(context), context.clock.now_ns(), [code]).get(code, Seen(0)).seen


def _on_file(unit: UnitOfWork, lookup: FileLookup, code: str, context: JobContext) -> OnFile:
    seen = unit.marks.due(_files(context), context.clock.now_ns(), [code]).get(code)
    return OnFile() if seen is None else OnFile(seen, *otherwise_on_file(unit, lookup, code))


def _files(context: JobContext) -> StageInputs:
    """Return what the windows of epochs are looked at with: it is compared only where one of these was raised."""
    common = made_from(_settings(context.settings))
    return StageInputs(f"{ALIGNMENT.name}_files", SubjectKind.SECTION, (Facet.REGISTRY,), common)


def _known(unit: UnitOfWork, due: Due, classes: ClassLookup, settings: AlignmentSettings) -> Known:
    code, version, since = due.section.code, due.before.version, due.before.same_since
    alignment = None if version is None else unit.tracks.alignment(code, version)
    records = [record for record, _ in due.entries]
    parts = []
    rest: Sequence[Entry] = due.entries
    while rest:
        chosen, rest = newest_within(rest, settings.most_windows, settings.most_wheelsets)
        of_windows = ([record for record, _ in chosen], [life for _, life in chosen])
        parts.append((chosen, measured(unit, due.section, *of_windows, settings.measured_km, classes)))
    return Known(
        alignment=alignment,
        base=alignment if since == version or since is None else unit.tracks.alignment(code, since),
        classes=classes_of(classes, records),
        on_file=RunsOnFile(
            {key: classes.assumed(*key) for key in dict.fromkeys((r.vehicle, r.wheelset) for r in records)},
            {code: unit.registry.mountings_on(code, 0, LATEST_NS) for code in {record.vehicle for record in records}},
            unit.tracks.layout(code),
        ),
        chosen=parts,
    )


def compute(inputs: FoldInputs) -> Outcome[Computed]:
    """Return the epoch that is due, as it is now; the next one comes when that is stored."""
    due, solved_with = inputs.found.due, inputs.known
    if inputs.later:
        return Outcome(again_ns=0, counted="unchanged")
    if due is None or solved_with is None:
        return Outcome(more=inputs.writes)
    settings = inputs.context.settings.alignment
    (chosen, of_chosen), *rest = solved_with.chosen
    alignment = solved_with.alignment
    solved = _solve(inputs, chosen, of_chosen, alignment, checked=survey_checked(due.before.survey))
    parts, alone = [solved], dict[Journey, Correction]()
    if alignment is not None and is_hardly_another(solved_with.base, solved.update, settings):
        grouped = solved.update.estimate.grouped
        alone = place_alone(due.section, grouped, alignment, settings.section, of_chosen.curves)
    if not solved.update.outcome.windows_wait:
        parts += [_solve(inputs, *part, solved.update.alignment, checked=True) for part in rest]
    made = Part(Computed(due, alignment, parts, solved_with.classes, of_chosen.notes, alone))
    return Outcome([made], more=not inputs.last, counted="epochs")


def _solve(
    inputs: FoldInputs, chosen: Sequence[Entry], lives: Measured, alignment: TrackAlignment | None, *, checked: bool
) -> Solved:
    assert inputs.found.due is not None
    assert inputs.known is not None
    made = epoch_passes(inputs.context, chosen, inputs.known.on_file)
    update = update_alignment(
        inputs.found.due.section,
        made.found,
        alignment,
        inputs.context.settings.alignment,
        survey_checked=checked,
        measured=lives.curves,
    )
    of_section = inputs.found.due.section
    update = with_bogies(inputs.context, of_section, chosen, inputs.known.on_file, made, update, alignment)
    return Solved([record for record, _ in chosen], made, update)


def store(
    unit: UnitOfWork, context: JobContext, made: Mapping[str, tuple[FoldInputs, Outcome[Computed]]]
) -> Mapping[str, int]:
    """Store what was computed of sections, and what was seen of their windows."""
    counts: Counter[str] = Counter()
    for inputs, outcome in made.values():
        _store(unit, context, inputs, outcome, counts)
    return counts


def _store(
    unit: UnitOfWork, context: JobContext, inputs: FoldInputs, outcome: Outcome[Computed], counts: Counter[str]
) -> None:
    search, code, on_file = inputs.found, inputs.section, inputs.on_file
    standing = _check_unchanged(unit, context, inputs)
    held = {member.record.key for kept in search.kept for member in kept.own}
    for kept in search.kept:
        unit.epochs.put(kept.epoch, kept.own)
    if search.due is not None:
        held |= {member.record.key for member in search.due.own}
        if inputs.known is None:
            cut(unit, search.due, context)
    for part in outcome.parts:
        assert part.value is not None
        store_epoch(unit, part.value, context, standing)
        passes = sum(len(solved.passes.found) for solved in part.value.parts)
        counts.update({_COUNTED[part.value.update.outcome]: 1, "windows": len(part.value.due.own), "passes": passes})
        counts["epochs"] += outcome.more  # the last one is counted with the section
    unit.due.remove_seen(DueStage.ALIGNMENT, inputs.seen)
    if on_file.seen is not None:
        unit.epochs.list_again(code, [key for key in on_file.changed if key not in held])
        for vehicle, wheelset, digest in on_file.unaffected:
            unit.epochs.note_context(code, vehicle, wheelset, digest)
        unit.marks.note(_files(context), {code: Mark(on_file.seen.seen, "")})


def _check_unchanged(unit: UnitOfWork, context: JobContext, inputs: FoldInputs) -> Mapping[WindowKey, WindowRecord]:
    """Hold the windows of epochs until they are stored: who changes them later finds that an epoch holds them.

    Returns:
        Them as they are.

    Raises:
        ConflictError: Something has changed since it was read.
    """
    search, code = inputs.found, inputs.section
    held = [member.record for kept in search.kept for member in kept.own]
    held += [record for record, _ in search.due.entries] if search.due is not None else []
    now = {record.key: record for record in unit.windows.several([record.key for record in held], held=True)}
    # as far as an epoch holds them
    same = all(record.key in now and _HELD(record) == _HELD(now[record.key]) for record in held)
    if same and (search.kept or search.due) and _versions(unit, code, context) != inputs.versions:
        due, solved_with = search.due, inputs.known
        other = due is not None and solved_with is not None and rests_on_other(unit, due, solved_with.classes, context)
        same = unit.epochs.list(code) == search.stored and not other
    if not same:
        raise ConflictError("windows, epochs or what they rest on have changed", kind="track section", key=code)
    return now


def _settings(settings: JobSettings) -> object:
    return settings.alignment_parameters(), settings.estimation.as_json()


ALIGNMENT = Stage(
    name="alignment",
    job="refresh_alignment",
    kind=SubjectKind.SECTION,
    facets=(Facet.REGISTRY, Facet.ALIGNMENT, Facet.WINDOWS),
    settings=_settings,
    load=load,
    compute=compute,
    counted=Counted(looked="sections", changed="versions", same="unchanged", more=_COUNTS),
    store=store,
    at_once=1,
)
JOB = Job(
    name=ALIGNMENT.job,
    description="Find the alignment of sections and the positions of windows",
    every_s=600.0,
    run=partial(run, ALIGNMENT),
)
