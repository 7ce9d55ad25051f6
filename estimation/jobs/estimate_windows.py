"""Job: pending windows become bin tables, or are refused with their reason; one that is damaged is refused too.

A window is estimated at the position that the alignment job has found for it. Where the alignment came from the fleet
it waits until that has looked at it; on a recording it does not.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from estimation.adhesion.left_out import away_from_low_adhesion, refused_for_low_adhesion
from estimation.errors import DamagedError, PassingFaultError, TreadwatchError
from estimation.jobs.hand_out import Unit, hand_out, unit_size
from estimation.jobs.isolation import Isolation, fails_alone
from estimation.jobs.job import Job, JobContext, Work
from estimation.jobs.runner import run as run_stage
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.failed_windows import (
    FailedWindow,
    attempted,
    key_of,
    let_due_wait_again,
    refuse_failed,
    release_others,
)
from estimation.jobs.steps.likely_chosen import likely_chosen
from estimation.jobs.steps.load_window import WindowLoader
from estimation.jobs.steps.lost_windows import assemble_if_lost
from estimation.jobs.steps.outdated_windows import OUTDATED
from estimation.jobs.steps.plausibility import judge_mileages
from estimation.jobs.steps.refusals import count_of, refusals_text
from estimation.jobs.steps.vehicle_classes import Assumed, ClassLookup
from estimation.jobs.steps.window_inputs import BatchInputs, WindowInputs, inputs_of_batch
from estimation.jobs.steps.window_tracks import tracks_of_batch
from estimation.motion.hunting import in_place_of_quality
from estimation.motion.parameters import WindowParameters
from estimation.motion.rolling_sums import rolling_sums
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import cells_of_window
from estimation.values.geometry import FilledCells, WindowTable
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.roll_up import RollingSums, WindowRollingSums
from estimation.values.runs import TRIED_AGAIN
from estimation.values.track import AlignmentRecord, AlignmentSource, Correction, TrackAlignment, TrackLayout
from estimation.values.windows import (
    Window,
    WindowKey,
    WindowMark,
    WindowPosition,
    WindowRecord,
    WindowState,
    key_of_text,
)

_log = logging.getLogger(__name__)


def run(context: JobContext) -> Mapping[str, int]:
    """Estimate every pending window; each batch is claimed and committed together."""
    counts: Counter[str] = Counter(estimated=0, refused=0, changed_meanwhile=0)
    if judged := judge_mileages(context):
        counts["mileages_judged"] = judged
    isolation = Isolation(context, "estimate_windows")
    let_due_wait_again(context, isolation)
    outdated = run_stage(OUTDATED, context)
    counts["requeued"] = outdated["requeued"]
    if outdated["passed_over"]:
        counts["passed_over"] = outdated["passed_over"]
    with context.storage.read() as unit:
        total, standing = unit.windows.pending_count(), unit.tracks.standings()
    in_force = {code: one.in_force for code, one in standing.items() if one.in_force is not None}
    waiting = [code for code, record in in_force.items() if _waits_for_place(record)]
    counts["quarantined"] = isolation.quarantined + outdated["quarantined"]
    _hand_out(context, waiting, total, counts)
    if refused := refusals_text(counts):
        _log.info("%d windows estimated, %d refused: %s", counts["estimated"], counts["refused"], refused)
    return counts


def _hand_out(context: JobContext, waiting: Sequence[str], total: int, counts: Counter[str]) -> None:
    """Let the windows that are ready be estimated, again and again until none is left that somebody here can do."""
    done = 0

    def progress(more: int) -> None:
        nonlocal done
        done += more
        context.checkpoint(done, max(total, done))

    size = unit_size(context, total, context.settings.estimation.batch)
    while True:
        found = hand_out(context, STAGE, _units(context, waiting, size), progress)
        counts.update(found)
        if not any(found[name] for name in _DONE):
            return


def _units(context: JobContext, waiting: Sequence[str], size: int) -> Iterator[Unit]:
    """Yield the keys of windows that are ready, so many together: those of a vehicle, in order of running."""
    last: WindowKey | None = None
    while True:
        with context.storage.read() as unit:
            found = unit.windows.ready(_PAGE * size, waiting, last)
        if not found:
            return
        last = found[-1].key
        near = sorted(found, key=_running_order)
        for first in range(0, len(near), size):
            yield tuple(key_of(record) for record in near[first : first + size])


def _running_order(record: WindowRecord) -> tuple[str, int, int]:
    """Return what puts the windows of a bogie next to each other: each needs the samples of the other."""
    return record.vehicle, record.start_ns, record.axle


def _work(context: JobContext, keys: Sequence[str]) -> Mapping[str, int]:
    """Estimate windows and store what comes of them in one transaction."""
    counts: Counter[str] = Counter()
    isolation = Isolation(context, "estimate_windows")
    batch = _compute(context, context.settings.estimation, [key_of_text(key) for key in keys])
    failed = [one for one in batch if isinstance(one, FailedWindow)]
    failed += _store_all(context, [one for one in batch if not isinstance(one, FailedWindow)], counts)
    refuse_failed(context, isolation, failed)
    release_others(isolation, [one[0].record for one in batch if not isinstance(one, FailedWindow)], failed)
    counts["quarantined"] = isolation.quarantined
    return counts


def _set_aside(context: JobContext, key: str, error: TreadwatchError) -> None:
    with context.storage.read() as unit:
        found = unit.windows.pending([key_of_text(key)])
    refuse_failed(context, Isolation(context, "estimate_windows"), [FailedWindow(record, error) for record in found])


def _waits_for_place(record: AlignmentRecord) -> bool:
    """Whether windows of a section wait until the alignment job has found their positions.

    Where nothing is known any more, as after a survey that was wrong, they are refused, with the reason.
    """
    return record.source == AlignmentSource.FLEET and record.status is Status.ESTIMATED


JOB = Job("estimate_windows", "Reduce pending windows to bin tables", every_s=60.0, run=run)
STAGE = Work(JOB.name, _work, _set_aside)
_DONE = ("estimated", "refused", "quarantined")
_PAGE = 16  # units whose keys are read together


@dataclass(frozen=True, slots=True)
class _Work:
    """A window, and what it is estimated with."""

    record: WindowRecord
    inputs: WindowInputs
    track: TrackAlignment | None
    layout: TrackLayout | None = None

    @property
    def mounted_reversed(self) -> bool:
        """Whether the wheelset is mounted the other way round."""
        return self.inputs.mounting is not None and self.inputs.mounting.reversed


@dataclass(frozen=True, slots=True)
class _Estimated:
    """What came of a window."""

    cells: FilledCells  # of its bin table
    rolling: tuple[RollingSums, ...] | None = None  # what it says of its rolling radius, where somebody will ask


_Outcome = tuple[_Work, _Estimated | Reason]


def _store_all(context: JobContext, found: Sequence[_Outcome], counts: Counter[str]) -> list[FailedWindow]:
    """Store outcomes in one transaction; where that fails, each in its own, and return those that failed alone."""
    try:
        counts.update(_stored(context, found))
    except Exception as error:
        if not fails_alone(error):
            raise
        if len(found) == 1:
            return [FailedWindow(found[0][0].record, error)]
        return [failed for one in found for failed in _store_all(context, [one], counts)]
    return []


def _stored(context: JobContext, found: Sequence[_Outcome]) -> list[str]:
    """Store outcomes; windows that something has changed under since are still pending: the next batch takes them."""
    with context.storage.write() as unit:
        now = {record.key: record for record in unit.windows.several([one.record.key for one, _ in found], held=True)}
        inputs = inputs_of_batch(unit, list(now.values()), ClassLookup(unit, context.settings.estimation))
        same = [(work, outcome) for work, outcome in found if not _changed(work, now.get(work.record.key), inputs)]
        _store(unit, same)
    changed = ["changed_meanwhile"] * (len(found) - len(same))
    stored = [in_place_of_quality(why, work.record.quality) for work, why in same if isinstance(why, Reason)]
    refused = [count_of(reason) for reason in stored]
    return changed + refused + ["refused" if isinstance(outcome, Reason) else "estimated" for _, outcome in same]


def _changed(work: _Work, now: WindowRecord | None, inputs: BatchInputs) -> bool:
    """Whether something that a window was estimated with is another by now."""
    return now is None or now.content_digest != work.record.content_digest or inputs.of(work.record.key) != work.inputs


def _store(unit: UnitOfWork, found: Sequence[_Outcome]) -> None:
    tables, marks, refused, rolling = [], [], {}, []
    for work, outcome in found:
        record, version = work.record, work.track.version if work.track is not None else None
        if isinstance(outcome, Reason):
            refusal = in_place_of_quality(outcome, record.quality)
            marks.append(WindowMark(*record.key, WindowState.REFUSED, refusal))
            refused[record.key] = version
            assemble_if_lost(unit, record, outcome)
        else:
            tables.append(WindowTable(*record.key, record.content_digest, outcome.cells, version))
            if outcome.rolling is not None and isinstance(work.inputs.assumed, Assumed):
                made_from = (record.content_digest, work.inputs.assumed.digest)
                rolling.append(WindowRollingSums(*record.key, *made_from, outcome.rolling))
            marks.append(WindowMark(*record.key, WindowState.ESTIMATED))
    unit.tables.put_all(tables)
    unit.windows.mark_all(marks)
    unit.epochs.note_all_refused(refused)
    unit.roll_ups.put_rolling(rolling)


def _compute(
    context: JobContext, settings: EstimationSettings, keys: Sequence[WindowKey]
) -> list[_Outcome | FailedWindow]:
    """Return what the windows come to that are still ready."""
    with context.storage.read() as unit:
        records = sorted(unit.windows.pending(keys), key=_running_order)
        tracks = tracks_of_batch(unit, records)
        batch = inputs_of_batch(unit, records, ClassLookup(unit, settings))
        loader, chosen = WindowLoader(unit, batch.vehicles, batch.records), likely_chosen(unit, records)

        def computed(record: WindowRecord) -> _Outcome | None:
            inputs, now = batch.of(record.key), tracks.in_force(record)
            if now is not None and _waits_for_place(now) and not _placed(record, inputs.position):
                return None  # its position has been taken back since it was handed out
            work = _Work(record, inputs, tracks.alignment(record), tracks.layout(record))
            return work, _outcome(loader, work, rolls=record.key in chosen)

        found = [attempted(computed, record) for record in records]
    return [one for one in found if one is not None]


def _placed(record: WindowRecord, position: WindowPosition | None) -> bool:
    """Whether the position of a window was found from its samples."""
    return position is not None and position.content_digest == record.content_digest


def _outcome(loader: WindowLoader, work: _Work, *, rolls: bool) -> _Estimated | Reason:
    record, assumed, position = work.record, work.inputs.assumed, work.inputs.position
    if record.implausible is not None:
        return record.implausible
    if isinstance(assumed, Reason):
        return assumed
    parameters = assumed.windows
    try:
        window = loader.load(record, parameters.vehicle_class)
    except DamagedError as error:
        return Reason(ReasonCode.FILE_DAMAGED, str(error))  # names the file; the other windows go on
    if isinstance(window, Reason):
        return window
    if position is not None and position.reason is not None and position.reason.code in TRIED_AGAIN:
        raise PassingFaultError(position.reason.text, code=position.reason.code)  # it is looked for again, too
    correction, misplaced = None, None
    if position is not None and _placed(record, position):
        correction, misplaced = Correction(position.offset_m, position.scale, position.middle_m), position.reason
    cells = _cells(window, work, parameters, correction, misplaced)
    if isinstance(cells, Reason):
        return cells
    rolling = rolling_sums(window, parameters.vehicle_class, parameters.signals) if rolls else None
    return _Estimated(cells, rolling)


def _cells(
    window: Window, work: _Work, parameters: WindowParameters, correction: Correction | None, misplaced: Reason | None
) -> FilledCells | Reason:
    """Return the cells of a window's bin table without its samples on rails of low friction."""
    kept = away_from_low_adhesion(window, work.inputs.low_adhesion, correction)
    if isinstance(kept, Reason):
        return kept
    found = cells_of_window(
        kept,
        work.track,
        parameters,
        correction,
        misplaced,
        mounted_reversed=work.mounted_reversed,
        layout=work.layout,
    )
    return refused_for_low_adhesion(found, window, kept) if isinstance(found, Reason) else found
