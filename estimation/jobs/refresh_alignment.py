"""Job: windows of a section, in epochs of vehicle time, give its alignment, which corrects their positions.

The windows of each section are divided into epochs, a function of the set of windows. Those of an epoch become passes;
these and what was known after the epoch before become the next version. So what is known of a section does not depend
on when its windows came. An epoch is computed again when one of its windows has changed, or what it started from; so a
run costs its new windows and not the history. Windows of an epoch that identifies nothing are looked at again together
with those of the next. A section on which nothing has happened is not read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

from estimation.errors import TreadwatchError
from estimation.jobs.hand_out import hand_out
from estimation.jobs.isolation import Isolation, fails_alone, no_inputs
from estimation.jobs.job import Job, JobContext, Work
from estimation.jobs.steps.epoch_inputs import FileLookup, entries, given, input_digest
from estimation.jobs.steps.epoch_passes import epoch_passes
from estimation.jobs.steps.measured_wheelsets import Measured, measured
from estimation.jobs.steps.section_looks import note_sections, section_news
from estimation.jobs.steps.store_alignment import (
    Computed,
    Due,
    classes_of,
    cut,
    is_hardly_another,
    store,
    survey_checked,
)
from estimation.jobs.steps.vehicle_classes import ClassLookup
from estimation.jobs.steps.window_positions import Solved
from estimation.storage import UnitOfWork
from estimation.track.partition import Entry, Group, first_epoch, newest_within
from estimation.track.passes import NANOSECONDS, Journey
from estimation.track.placing import place_alone
from estimation.track.update import UpdateOutcome, update_alignment
from estimation.values.runs import SubjectKind
from estimation.values.track import OPEN_NS, Correction, TrackAlignment, TrackEpoch, TrackSectionRecord

_COUNTED = {
    UpdateOutcome.UNESTIMATED: "unestimated",
    UpdateOutcome.KEPT: "kept",
    UpdateOutcome.SURVEY_KEPT: "kept",
    UpdateOutcome.NEW_VERSION: "versions",
    UpdateOutcome.SURVEY_EXTENDED: "versions",
    UpdateOutcome.SURVEY_REFUSED: "versions",
}
_COUNTS = (
    "sections",
    "epochs",
    "windows",
    "passes",
    "versions",
    "kept",
    "unestimated",
    "unchanged",
    "changed_meanwhile",
)
GROWN = 4.0
"""Times as many windows as it was computed with: from there on an open epoch is computed although more still come."""

_READ = 4  # times the windows of an epoch that are read to find it


def run(context: JobContext) -> Mapping[str, int]:
    """Compute the epochs of every section that are new or have changed; each is committed on its own."""
    counts: Counter[str] = Counter(dict.fromkeys(_COUNTS, 0))
    isolation = Isolation(context, "refresh_alignment")
    due = _due_sections(context, isolation, counts)
    counts["quarantined"] = isolation.quarantined
    done = 0

    def progress(more: int) -> None:
        nonlocal done
        done += more
        context.checkpoint(done, len(due))

    counts.update(hand_out(context, STAGE, ((code,) for code in due), progress))
    return counts


def _due_sections(context: JobContext, isolation: Isolation, counts: Counter[str]) -> list[str]:
    """Return the sections with an epoch to look at; those on which nothing has happened are not even read."""
    with context.storage.read() as unit:
        sections, news = unit.tracks.sections(), section_news(unit, context, STAGE.name)
    failed = {item.key for item in isolation.held(SubjectKind.SECTION)}
    due, at_rest = [], {}
    for section in sections:
        code = section.code
        if isolation.waits(SubjectKind.SECTION, code):
            continue
        counts["sections"] += 1
        if code not in news and code not in failed:
            counts["unchanged"] += 1
            continue
        try:
            first = _first_due(context, section)
            if first is not None and not first.later:
                due.append(code)
                continue
        except Exception as error:
            if not fails_alone(error):
                raise
            isolation.keep(SubjectKind.SECTION, code, no_inputs(), error)
        else:
            counts["unchanged"] += 1
            isolation.release(SubjectKind.SECTION, code)
            if code in news and first is None:  # an epoch that is left for later is looked at again
                at_rest[code] = news[code]
    note_sections(context, STAGE.name, at_rest)
    return due


def _work(context: JobContext, codes: Sequence[str]) -> Mapping[str, int]:
    """Compute the epochs of sections; what fails at one of them is kept in quarantine."""
    counts: Counter[str] = Counter()
    isolation = Isolation(context, "refresh_alignment")
    with context.storage.read() as unit:
        sections = [section for section in unit.tracks.sections() if section.code in codes]
    for section in sections:
        with isolation.alone(SubjectKind.SECTION, section.code):
            _fold(context, section, counts)
    counts["quarantined"] = isolation.quarantined
    return counts


def _set_aside(context: JobContext, code: str, error: TreadwatchError) -> None:
    Isolation(context, "refresh_alignment").keep(SubjectKind.SECTION, code, no_inputs(), error)


JOB = Job("refresh_alignment", "Find the alignment of sections and the positions of windows", every_s=600.0, run=run)
STAGE = Work(JOB.name, _work, _set_aside)


def _first_due(context: JobContext, section: TrackSectionRecord) -> Due | None:
    """Return which epoch of a section has to be looked at; asked before the section is claimed, for that writes."""
    files_ns = _files_changed(context, section)
    with context.storage.read() as unit:
        return _due(unit, section, context, 0, files_ns)


def _fold(context: JobContext, section: TrackSectionRecord, counts: Counter[str]) -> None:
    """Do the epochs of a section that have changed, in order; each once."""
    files_ns = _files_changed(context, section)
    visited = 0
    while True:
        with context.storage.read() as unit:
            due = _due(unit, section, context, visited, files_ns)
        if due is None or due.later:
            break
        visited = due.number
        if not due.own:
            _cut(context, due)
            return
        if due.same is not None:
            with context.storage.write() as unit:
                unit.epochs.put(due.same, due.own)
        elif not _compute(context, due, counts):
            counts["changed_meanwhile"] += 1
            return
    counts["unchanged"] += visited == 0


def _files_changed(context: JobContext, section: TrackSectionRecord) -> int | None:
    """Return the start of the first window for which something else is on file than when its epoch was computed."""
    changed: list[int] = []
    unaffected: list[tuple[str, str, str]] = []
    with context.storage.read() as unit:
        lookup = _lookup(unit, context)
        for vehicle, wheelset, digest in unit.epochs.contexts(section.code):
            now = lookup.of(vehicle, wheelset).digest
            if now == digest:
                continue
            held = unit.epochs.members(section.code, vehicle, wheelset)
            other = [one.record.start_ns for one in held if lookup.member(one.record).assumed != one.assumed]
            changed += other
            if not other:
                unaffected.append((vehicle, wheelset, now))
    if unaffected:
        with context.storage.write() as unit:
            for vehicle, wheelset, now in unaffected:
                unit.epochs.note_context(section.code, vehicle, wheelset, now)
    return min(changed, default=None)


def _lookup(unit: UnitOfWork, context: JobContext) -> FileLookup:
    return FileLookup(unit, context.settings, ClassLookup(unit, context.settings.estimation))


def _due(
    unit: UnitOfWork, section: TrackSectionRecord, context: JobContext, visited: int, files_ns: int | None
) -> Due | None:
    """Return the next epoch behind ``visited`` that has to be looked at; None where all are as they should be."""
    stored = unit.epochs.list(section.code)
    basis, first = given(unit, section, context.settings)
    states = [first, *(epoch.after for epoch in stored)]
    news = unit.epochs.news(section.code)
    changed_ns = min((at for at in (news.from_ns, files_ns) if at is not None), default=None)
    again = {visited + 1} if visited and stored[visited - 1].waits else set[int]()

    def affected(epoch: TrackEpoch) -> bool:
        return (
            epoch.before != states[epoch.number - 1].key(basis)
            or (changed_ns is not None and changed_ns <= epoch.horizon_ns)
            or epoch.number in news.unplaced | again
        )

    known = [epoch for epoch in stored if epoch.number > visited and affected(epoch)]
    number = known[0].number if known else len(stored) + 1
    settings = context.settings.alignment
    lookup = _lookup(unit, context)
    records = unit.epochs.remaining(section.code, number, _READ * settings.most_windows)
    if not records:
        return Due(section, number, stored, states[number - 1], basis) if known else None
    group = first_epoch(entries(lookup, records), settings.most_windows, settings.most_wheelsets, settings.partition)
    waiting = unit.epochs.windows(section.code, _waiting_before(stored, number))
    own = [lookup.member(record) for record, _ in group.entries]
    due = Due(
        section,
        number,
        stored,
        states[number - 1],
        basis,
        own,
        [*entries(lookup, waiting), *group.entries],
        input_digest([*(lookup.member(record) for record in waiting), *own]),
        group.horizon_ns,
    )
    if known and number == len(stored) and _leaves_for_later(context, known[0], due, group):
        return replace(due, later=True)
    same = known and number not in news.unplaced | again and _rests_on(known[0], due)
    return replace(due, same=replace(known[0], horizon_ns=group.horizon_ns, windows=len(own))) if same else due


def _leaves_for_later(context: JobContext, epoch: TrackEpoch, due: Due, group: Group) -> bool:
    """Return whether the last epoch stays as it is for now: windows still come, and it has hardly grown since.

    It is computed by the first run that finds no new window, so what is stored at rest is the same.
    """
    ages_ns = [context.clock.now_ns() - record.recorded_ns for record, _ in group.entries]
    coming = any(0 <= age_ns < context.quiet_s * NANOSECONDS for age_ns in ages_ns)
    grows = epoch.windows < len(group.entries) < GROWN * epoch.windows
    return coming and grows and group.horizon_ns == OPEN_NS and epoch.before == due.before.key(due.basis)


def _rests_on(epoch: TrackEpoch, due: Due) -> bool:
    return epoch.before == due.before.key(due.basis) and epoch.input_digest == due.digest


def _waiting_before(stored: Sequence[TrackEpoch], number: int) -> list[int]:
    """Return the epochs right before one that have identified nothing."""
    found: list[int] = []
    for epoch in reversed(stored[: number - 1]):
        if not epoch.waits:
            break
        found.append(epoch.number)
    return found


def _compute(context: JobContext, due: Due, counts: Counter[str]) -> bool:
    """Compute an epoch and store what it shows; return whether that could be stored."""
    settings = context.settings.alignment
    chosen, rest = newest_within(due.entries, settings.most_windows, settings.most_wheelsets)
    with context.storage.read() as unit:
        version = due.before.version
        alignment = None if version is None else unit.tracks.alignment(due.section.code, version)
        since = due.before.same_since
        base = alignment if since == version or since is None else unit.tracks.alignment(due.section.code, since)
        classes = classes_of(ClassLookup(unit, context.settings.estimation), [record for record, _ in due.entries])
    solved, known = _solve(context, due, chosen, alignment, checked=survey_checked(due.before.survey))
    parts, alone = [solved], dict[Journey, Correction]()
    if alignment is not None and is_hardly_another(base, solved.update, settings):
        alone = place_alone(due.section, solved.update.estimate.grouped, alignment, settings.section, known.curves)
    if not solved.update.outcome.windows_wait:
        while rest:
            chosen, rest = newest_within(rest, settings.most_windows, settings.most_wheelsets)
            parts.append(_solve(context, due, chosen, solved.update.alignment, checked=True)[0])
    with context.storage.write() as unit:
        stored = store(unit, Computed(due, alignment, parts, classes, known.notes, alone), context)
    if stored:
        counts[_COUNTED[solved.update.outcome]] += 1
        counts["epochs"] += 1
        counts["windows"] += len(due.own)
        counts["passes"] += sum(len(part.passes.found) for part in parts)
    return stored


def _solve(
    context: JobContext, due: Due, chosen: Sequence[Entry], alignment: TrackAlignment | None, *, checked: bool
) -> tuple[Solved, Measured]:
    """Return what some windows make of an alignment, and what has been measured of their wheelsets."""
    settings = context.settings.alignment
    records, lives = [record for record, _ in chosen], [life for _, life in chosen]
    with context.storage.read() as unit:
        classes = ClassLookup(unit, context.settings.estimation)
        known: Measured = measured(unit, due.section, records, lives, settings.measured_km, classes)
    made = epoch_passes(context, chosen)
    update = update_alignment(
        due.section, made.found, alignment, settings, survey_checked=checked, measured=known.curves
    )
    return Solved(records, made, update), known


def _cut(context: JobContext, due: Due) -> None:
    """Forget the epochs that have no window any more."""
    with context.storage.write() as unit:
        cut(unit, due, context)
