"""Job: windows that wait become bin tables, or are refused with their reason; one that is damaged is refused too.

A window is estimated at the position that the alignment job has found for it. Where the alignment came from the fleet
it waits until that has looked at it; on a recording it does not.
"""

from __future__ import annotations

import logging
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from estimation.errors import DamagedError, NotFoundError, PassingFaultError
from estimation.jobs.job import Job, JobContext
from estimation.jobs.runner import run_all
from estimation.jobs.stage import Counted, Outcome, Part, Stage
from estimation.jobs.steps.due_windows import JUDGE, OUTDATED
from estimation.jobs.steps.load_window import (
    Facts,
    WindowInputs,
    WindowLoader,
    assemble_if_lost,
    inputs_of_batch,
    tracks_of_batch,
)
from estimation.jobs.steps.vehicle_classes import Assumed, ClassLookup
from estimation.motion.checks import away_from_low_adhesion, refused_for_low_adhesion
from estimation.motion.hunting import in_place_of_quality
from estimation.motion.rolling_sums import rolling_sums
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import cells_of_window
from estimation.values.geometry import FilledCells, WindowTable
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.roll_up import MOST_CHOSEN, RollingSums, WindowRollingSums
from estimation.values.runs import FAILED, TRIED_AGAIN, Quarantined, SubjectKind, code_of_error, first_line
from estimation.values.track import TrackAlignment, TrackLayout
from estimation.values.windows import (
    DueStage,
    Window,
    WindowKey,
    WindowMark,
    WindowRecord,
    WindowState,
    key_of_text,
    text_of_key,
)

REFUSED = "refused_"
"""Begin of the names under which a run counts refused windows by reason code."""


def count_of(reason: Reason) -> str:
    """Return the name under which a window is counted that was refused for a reason."""
    return f"{REFUSED}{reason.code.value}"


def refusals(counts: Mapping[str, int]) -> dict[ReasonCode, int]:
    """Return how many windows a run has refused, by reason code, the most frequent first."""
    known = {count_of(Reason(code, "")): code for code in ReasonCode}
    found = {known[name]: count for name, count in counts.items() if name in known and count}
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0].value)))


def refusals_text(counts: Mapping[str, int]) -> str:
    """Return what windows were refused for, with what to do; empty where none was."""
    parts = []
    for code, count in refusals(counts).items():
        remedy = code.remedy.rstrip(".")
        parts.append(f"{count} {code.value}" + (f" ({remedy})" if remedy else ""))
    return ", ".join(parts)


def likely_chosen(unit: UnitOfWork, records: Sequence[WindowRecord]) -> set[WindowKey]:
    """Return which windows of a batch would be chosen beside those of the newest roll-up of their wheelset."""
    of_wheelset: defaultdict[str, list[WindowRecord]] = defaultdict(list)
    for record in records:
        if not record.quality.hunting.sustained:
            of_wheelset[record.wheelset].append(record)
    stored = unit.roll_ups.newest_chosen(sorted(of_wheelset)) if of_wheelset else {}
    found: set[WindowKey] = set()
    for wheelset, several in of_wheelset.items():
        digests = {*stored.get(wheelset, ()), *(record.content_digest for record in several)}
        smallest = set(sorted(digests)[:MOST_CHOSEN])
        found |= {record.key for record in several if record.content_digest in smallest}
    return found


JOB_NAME = "estimate_windows"
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class TableInputs:
    """A window, and what it is estimated with.

    Attributes:
        window: As its vehicle's class reads it, or why it is not to be used.
        rolls: Whether somebody will ask for what it says of its rolling radius.
    """

    record: WindowRecord
    inputs: WindowInputs
    facts: Facts = field(metadata={"made_from": False})
    window: Window | Reason = field(metadata={"made_from": False})
    track: TrackAlignment | None = field(metadata={"made_from": False})
    layout: TrackLayout | None = field(metadata={"made_from": False})
    rolls: bool


@dataclass(frozen=True, slots=True)
class Estimated:
    """What came of a window."""

    cells: FilledCells  # of its bin table
    rolling: tuple[RollingSums, ...] | None = None  # what it says of its rolling radius, where somebody will ask


def load_windows(unit: UnitOfWork, keys: Sequence[str], context: JobContext) -> Mapping[str, TableInputs]:
    """Return windows that wait or failed, with what they are estimated with; the others are left out."""
    standing = unit.windows.several([key_of_text(key) for key in keys])
    waiting = (one for one in standing if one.state is WindowState.PENDING or code_of(one.reason) in FAILED)
    # the windows of a bogie next to each other: each needs the samples of the other
    records = sorted(waiting, key=lambda record: (record.vehicle, record.start_ns, record.axle))
    if not records:
        return {}
    tracks = tracks_of_batch(unit, records)
    batch = inputs_of_batch(unit, records, ClassLookup(unit, context.settings.estimation))
    loader = WindowLoader(unit, batch.vehicles, batch.records)
    chosen, inputs = likely_chosen(unit, records), {}
    for record in records:
        found = batch.found[record.key]
        inputs[text_of_key(*record.key)] = TableInputs(
            record=record,
            inputs=found,
            facts=batch.facts,
            window=_window(loader, record, found.assumed),
            track=tracks.alignment(record),
            layout=tracks.layout(record),
            rolls=record.key in chosen,
        )
    return inputs


def _window(loader: WindowLoader, record: WindowRecord, assumed: Assumed | Reason) -> Window | Reason:
    if record.implausible is not None:
        return record.implausible
    if isinstance(assumed, Reason):
        return assumed
    try:
        return loader.load(record, assumed.windows.vehicle_class)
    except DamagedError as error:
        return Reason(ReasonCode.FILE_DAMAGED, str(error))  # names the file; the other windows go on


def estimate(inputs: TableInputs) -> Outcome[Estimated | Reason]:
    """Return the bin table of a window, without its samples on rails of low friction, or why it has none.

    Raises:
        PassingFaultError: It could not be found where it was, for now.
    """
    return Outcome([Part(_estimated(inputs))])


def _estimated(inputs: TableInputs) -> Estimated | Reason:
    window, assumed, position = inputs.window, inputs.inputs.assumed, inputs.inputs.position
    if isinstance(window, Reason):
        return window
    if isinstance(assumed, Reason):
        return assumed
    if position is not None and position.reason is not None and position.reason.code in TRIED_AGAIN:
        raise PassingFaultError(position.reason.text, code=position.reason.code)  # it is looked for again, too
    correction, parameters = inputs.inputs.correction(inputs.record), assumed.windows
    kept = away_from_low_adhesion(window, inputs.inputs.low_adhesion, correction)
    if isinstance(kept, Reason):
        return kept
    cells = cells_of_window(
        kept,
        inputs.track,
        parameters,
        correction,
        None if position is None or correction is None else position.reason,
        mounted_reversed=inputs.inputs.mounted_reversed,
        layout=inputs.layout,
    )
    if isinstance(cells, Reason):
        return refused_for_low_adhesion(cells, window, kept)
    rolling = rolling_sums(window, parameters.vehicle_class, parameters.signals) if inputs.rolls else None
    return Estimated(cells, rolling)


def store_tables(
    unit: UnitOfWork,
    context: JobContext,
    made: Mapping[str, tuple[TableInputs | None, Outcome[Estimated | Reason]]],
) -> Mapping[str, int]:
    """Store outcomes; windows that something has changed under since are due still: the next batch takes them."""
    found = [
        (inputs, part.value)
        for inputs, outcome in made.values()
        for part in outcome.parts
        if inputs is not None and part.value is not None
    ]
    if not found:
        return {}
    now = {record.key: record for record in unit.windows.several([one.record.key for one, _ in found], held=True)}
    changed = {one.record.key for one, _ in found if not _same_samples(one.record, now.get(one.record.key))}
    if not found[0][0].facts.are_same(unit):
        batch = inputs_of_batch(unit, list(now.values()), ClassLookup(unit, context.settings.estimation))
        changed |= {one.record.key for one, _ in found if batch.found.get(one.record.key) != one.inputs}
    same = [(inputs, outcome) for inputs, outcome in found if inputs.record.key not in changed]
    _store(unit, same, now)
    unit.due.list_again(DueStage.TABLES, sorted(changed))
    counts = Counter(estimated=0, refused=0, changed_meanwhile=len(changed))
    for inputs, outcome in same:
        counts["refused" if isinstance(outcome, Reason) else "estimated"] += 1
        if isinstance(outcome, Reason):
            counts[count_of(in_place_of_quality(outcome, inputs.record.quality))] += 1
    return counts


def _same_samples(record: WindowRecord, now: WindowRecord | None) -> bool:
    return now is not None and now.content_digest == record.content_digest


def _store(
    unit: UnitOfWork,
    found: Sequence[tuple[TableInputs, Estimated | Reason]],
    standing: Mapping[WindowKey, WindowRecord],
) -> None:
    tables, marks, refused, rolling = [], [], {}, []
    for inputs, outcome in found:
        record, version = inputs.record, inputs.track.version if inputs.track is not None else None
        if isinstance(outcome, Reason):
            refusal = in_place_of_quality(outcome, record.quality)
            marks.append(WindowMark(*record.key, WindowState.REFUSED, refusal))
            refused[record.key] = version
            assemble_if_lost(unit, record, outcome)
        else:
            tables.append(WindowTable(*record.key, record.content_digest, outcome.cells, version))
            if outcome.rolling is not None and isinstance(inputs.inputs.assumed, Assumed):
                made_from = (record.content_digest, inputs.inputs.assumed.digest)
                rolling.append(WindowRollingSums(*record.key, *made_from, outcome.rolling))
            marks.append(WindowMark(*record.key, WindowState.ESTIMATED))
    tabled = unit.tables.put_all(tables, listed=False)
    unit.windows.mark_all(marks, standing, tabled)
    unit.epochs.note_all_refused(refused)
    unit.roll_ups.put_rolling(rolling)


def refuse(unit: UnitOfWork, key: str, error: Exception) -> None:
    """Refuse a window at which the estimation failed, with its reason; it is due still."""
    with suppress(NotFoundError):  # it may be gone by now
        unit.windows.mark(*key_of_text(key), WindowState.REFUSED, Reason(code_of_error(error), first_line(error)))


def let_wait_again(unit: UnitOfWork, failed: Sequence[Quarantined]) -> None:
    """Let windows that failed before wait for the estimation again; where they were is looked for again, too."""
    codes = {key_of_text(item.key): item.code for item in failed}
    there = unit.windows.several(list(codes))
    unit.windows.look_again([one.key for one in there if code_of(one.reason) is codes[one.key]])


TABLES = Stage(
    name=DueStage.TABLES,
    job=JOB_NAME,
    kind=SubjectKind.WINDOW,
    facets=(),
    settings=lambda _: None,
    load=load_windows,
    compute=estimate,
    counted=Counted(looked="windows", changed="results", more=("estimated", "refused", "changed_meanwhile")),
    store=store_tables,
    failed=refuse,
    again=let_wait_again,
    at_once=None,
)


def run(context: JobContext) -> Mapping[str, int]:
    """Estimate every window that waits."""
    counts = made = run_all((JUDGE, OUTDATED, TABLES), context)
    while made["changed_meanwhile"]:
        made = run_all((TABLES,), context)
        counts.update(made)
    if refused := refusals_text(counts):
        _log.info("%d windows estimated, %d refused: %s", counts["estimated"], counts["refused"], refused)
    return {name: count for name, count in counts.items() if name not in BESIDE and (count or name not in RARE)}


BESIDE = {"looks", "wheelsets", "windows", "results"}
"""Counts of stages that are no counts of the job."""
RARE = {"mileages_judged", "passed_over"}
"""Counts that are left out where they are 0."""


JOB = Job(JOB_NAME, "Reduce pending windows to bin tables", every_s=60.0, run=run)
