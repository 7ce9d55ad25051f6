"""Job: windows that wait become bin tables, or are refused with their reason; one that is damaged is refused too.

A window is estimated at the position that the alignment job has found for it. Where the alignment came from the fleet
it waits until that has looked at it; on a recording it does not. Before that, windows are refused whose mileage or
place cannot be believed, and those wait again for which something has come: an alignment, a class, or other parameters.
A version that differs from the one of a table by less than that left unknown is none to estimate again for, nor is a
recording of the gauge alone.
"""

from __future__ import annotations

import logging
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain

from estimation.errors import NotFoundError, PassingFaultError
from estimation.jobs.job import Job, JobContext
from estimation.jobs.parameters import WORK
from estimation.jobs.runner import run_all
from estimation.jobs.stage import Counted, Outcome, Part, Stage
from estimation.jobs.steps.assumptions import Assumed, ClassLookup
from estimation.jobs.steps.load_window import TableInputs, assemble_if_lost, inputs_of_batch, load_windows
from estimation.motion.checks import away_from_low_adhesion, refused_for_low_adhesion
from estimation.motion.hunting import in_place_of_quality
from estimation.motion.mileage import implausible_mileages, implausible_places, without_doubt
from estimation.motion.rolling_sums import rolling_sums
from estimation.motion.window_motion import NO_ALIGNMENT
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import cells_of_window
from estimation.values.geometry import FilledCells, WindowTable
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.registry import Mounting
from estimation.values.roll_up import RollingSums, WindowRollingSums
from estimation.values.runs import TRIED_AGAIN, Facet, Quarantined, SubjectKind, code_of_error, first_line
from estimation.values.windows import (
    DueStage,
    MileageReading,
    ReadingSpan,
    WindowKey,
    WindowMark,
    WindowRecord,
    WindowState,
    key_of_text,
)

JOB_NAME = "estimate_windows"
REFUSED = "refused_"
"""Begin of the names under which a run counts refused windows by reason code."""
Mounted = tuple[Mounting, float]
"""A mounting and the greatest speed of its vehicle, m/s."""
BESIDE = {"looks", "wheelsets", "windows", "results"}  # counts of stages that are no counts of the job
RARE = {"mileages_judged", "passed_over"}  # counts that are left out where they are 0
_log = logging.getLogger(__name__)


def refusals(counts: Mapping[str, int]) -> dict[ReasonCode, int]:
    """Return how many windows a run has refused, by reason code, the most frequent first."""
    refused = {code: counts.get(f"{REFUSED}{code.value}", 0) for code in ReasonCode}
    return dict(sorted((item for item in refused.items() if item[1]), key=lambda item: (-item[1], item[0].value)))


def refusals_text(counts: Mapping[str, int]) -> str:
    """Return what windows were refused for, with what to do; empty where none was."""
    parts = []
    for code, count in refusals(counts).items():
        remedy = code.remedy.rstrip(".")
        parts.append(f"{count} {code.value}" + (f" ({remedy})" if remedy else ""))
    return ", ".join(parts)


@dataclass(frozen=True, slots=True)
class Readings:
    """What the windows of a wheelset are judged by."""

    wheelset: str
    judged: tuple[MileageReading, ...]  # new readings where nothing speaks against them; else all
    mounted: tuple[Mounted, ...]  # empty where nothing speaks against the readings
    seen: Mapping[WindowKey, int]  # windows that are due, with the versions in which they were


Verdicts = Mapping[WindowKey, Reason | None]


def load_readings(unit: UnitOfWork, serials: Sequence[str], _: JobContext) -> Mapping[str, Readings]:
    """Return the new readings of some wheelsets, or all where one is doubted or something speaks against a new one."""
    (due, doubted), mounted = unit.plausibility.due(serials), _mounted(unit, serials)
    spans = _spans(key for key in due if key[0] not in doubted)
    around = unit.plausibility.readings_around(list(chain.from_iterable(spans.values())))
    new: Mapping[str, Sequence[MileageReading]] = {
        serial: [
            reading
            for span in of_wheelset
            for reading in around[span]
            if span[1] <= reading.start_ns <= span[2] and (serial, reading.start_ns) in due
        ]
        for serial, of_wheelset in spans.items()
    }
    if sum(map(len, new.values())) < sum(serial in spans for serial, _ in due):  # some are gone
        new = unit.plausibility.new_readings(list(spans))
        spans = _spans((serial, reading.start_ns) for serial, readings in new.items() for reading in readings)
        around = unit.plausibility.readings_around(list(chain.from_iterable(spans.values())))
    by_wheelset = {}
    for serial in serials:
        judged, against = new.get(serial, ()), mounted.get(serial, ())
        beside = [around[span] for span in spans.get(serial, ())]
        believed = serial not in doubted and all(
            without_doubt([reading for reading in readings if mounting.covers(reading.start_ns)], mounting, max_speed)
            for readings in beside
            for mounting, max_speed in against
        )
        judged, against = (judged, ()) if believed else (unit.plausibility.readings(serial), against)
        seen = {key: version for key, version in due.items() if key[0] == serial}
        by_wheelset[serial] = Readings(serial, tuple(judged), against, seen)
    return by_wheelset


def judge(inputs: Readings) -> Outcome[Verdicts]:
    """Return why windows of a wheelset are not believed, None for those that are, where that is new."""
    implausible: dict[int, Reason] = dict(implausible_places(inputs.judged))
    for mounting, max_speed in inputs.mounted:
        if within := [reading for reading in inputs.judged if mounting.covers(reading.start_ns)]:
            implausible.update(implausible_mileages(within, mounting, max_speed))
    verdicts = {
        (inputs.wheelset, reading.start_ns): implausible.get(reading.start_ns)
        for reading in inputs.judged
        if implausible.get(reading.start_ns) != reading.refused
    }
    return Outcome([Part(verdicts)])


def store_verdicts(
    unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[Readings, Outcome[Verdicts]]]
) -> Mapping[str, int]:
    """Store which windows are believed; return how many have another verdict."""
    parts = [part for _, outcome in made.values() for part in outcome.parts]
    changed = unit.plausibility.judge({key: why for part in parts for key, why in (part.value or {}).items()})
    seen = {key: version for inputs, _ in made.values() for key, version in inputs.seen.items()}
    unit.due.remove_seen(DueStage.MILEAGES, seen)
    return {"mileages_judged": changed}


def _mounted(unit: UnitOfWork, serials: Sequence[str]) -> Mapping[str, tuple[Mounted, ...]]:
    mountings = unit.registry.mountings_of(serials)
    vehicles = unit.registry.vehicles_of({mounting.vehicle for mounting in chain.from_iterable(mountings.values())})
    return {
        serial: tuple((mounting, vehicles[mounting.vehicle].max_speed_m_s) for mounting in of_wheelset)
        for serial, of_wheelset in mountings.items()
    }


def _spans(windows: Iterable[WindowKey]) -> Mapping[str, list[ReadingSpan]]:
    """Return first and last start of groups of windows that are apart, by wheelset; each in order of time."""
    spans: defaultdict[str, list[ReadingSpan]] = defaultdict(list)
    for serial, start_ns in windows:
        groups = spans[serial]
        if groups and start_ns - groups[-1][2] <= WORK.windows_apart_ns:
            groups[-1] = (serial, groups[-1][1], start_ns)
        else:
            groups.append((serial, start_ns, start_ns))
    return spans


JUDGE = Stage(
    name=DueStage.MILEAGES,
    job=JOB_NAME,
    kind=SubjectKind.WHEELSET,
    facets=(),
    settings=lambda _: None,
    load=load_readings,
    compute=judge,
    counted=Counted(looked="wheelsets", changed="results"),
    store=store_verdicts,
    at_once=50,
)


@dataclass(frozen=True, slots=True)
class Outdated:
    """Windows on a section, or on none, for which something has come."""

    # estimated on another version of the alignment, or with other parameters, than they are to be
    changed: Sequence[WindowKey]
    aligned: Sequence[WindowKey]  # refused without an alignment, of which there is one
    classed: Sequence[WindowKey]  # refused without a class of their vehicle, of which there is one


def load_outdated(unit: UnitOfWork, sections: Sequence[str], context: JobContext) -> Mapping[str, Outdated]:
    """Return what has come for the windows of some sections."""
    classes = ClassLookup(unit, context.settings.estimation)
    return {code: _of_section(unit, classes, code) for code in sections}


def _of_section(unit: UnitOfWork, classes: ClassLookup, code: str) -> Outdated:
    if not unit.windows.any_decided(code):
        return Outdated((), (), ())
    refused = unit.windows.refused_on(code, (NO_ALIGNMENT.code, ReasonCode.CLASS_UNKNOWN))
    aligned, classed = [], []
    for record in refused:
        if code_of(record.reason) is not ReasonCode.CLASS_UNKNOWN:
            aligned.append(record.key)
        elif not isinstance(classes.of_vehicle(record.vehicle), Reason):
            classed.append(record.key)
    if aligned:
        in_force = unit.tracks.in_force(code)
        aligned = aligned if in_force is not None and in_force.status is Status.ESTIMATED else []
    changed = set(unit.epochs.outdated([code]))
    for key in unit.tables.parameter_keys([code]):
        if key.parameter_key != classes.table_key(key.vehicle, key.wheelset):
            changed.update(unit.tables.made_with(key))
    return Outdated(sorted(changed), aligned, classed)


def let_wait(unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[Outdated, Outcome[None]]]) -> Mapping[str, int]:
    """Let windows wait again; count how many do and how many cannot, for their samples were purged."""
    counts: Counter[str] = Counter()
    for outdated, _outcome in made.values():
        waiting = [WindowMark(*key, WindowState.PENDING) for key in (*outdated.changed, *outdated.aligned)]
        again = {mark.key for mark in unit.windows.mark_all(waiting)}
        counts["passed_over"] += len(set(outdated.changed) - again)
        counts["requeued"] += len(again) + len(unit.windows.look_again(outdated.classed))
    return counts


OUTDATED = Stage(
    name="outdated",
    job=JOB_NAME,
    kind=SubjectKind.SECTION,
    facets=(Facet.REGISTRY, Facet.ALIGNMENT, Facet.PLACES),
    settings=lambda settings: settings.estimation.as_json(),
    load=load_outdated,
    # what follows is that windows wait; those that do are not found again
    compute=lambda outdated: Outcome(more=bool(outdated.changed or outdated.aligned or outdated.classed)),
    counted=Counted(looked="looks", changed="results", more=("requeued", "passed_over")),
    store=let_wait,
    here=True,
)


@dataclass(frozen=True, slots=True)
class Estimated:
    """What came of a window."""

    cells: FilledCells  # of its bin table
    rolling: tuple[RollingSums, ...] | None = None  # what it says of its rolling radius, where somebody will ask


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
    correction, parameters = inputs.inputs.correction(inputs.record), assumed.window_parameters
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
    made: Mapping[str, tuple[TableInputs, Outcome[Estimated | Reason]]],
) -> Mapping[str, int]:
    """Store outcomes; windows that something has changed under since are due still: the next batch takes them."""
    outcomes = [
        (inputs, part.value) for inputs, outcome in made.values() for part in outcome.parts if part.value is not None
    ]
    if not outcomes:
        return {}
    records = [inputs.record for inputs, _ in outcomes]
    now = {record.key: record for record in unit.windows.several([record.key for record in records], held=True)}
    digests = {key: record.content_digest for key, record in now.items()}
    changed = {record.key for record in records if digests.get(record.key) != record.content_digest}
    if not outcomes[0][0].facts.are_same(unit):
        batch = inputs_of_batch(unit, list(now.values()), ClassLookup(unit, context.settings.estimation))
        changed |= {inputs.record.key for inputs, _ in outcomes if batch.found.get(inputs.record.key) != inputs.inputs}
    same = [(inputs, outcome) for inputs, outcome in outcomes if inputs.record.key not in changed]
    _store(unit, same, now)
    unit.due.list_again(DueStage.TABLES, sorted(changed))
    counts = Counter(estimated=0, refused=0, changed_meanwhile=len(changed))
    for inputs, outcome in same:
        counts["refused" if isinstance(outcome, Reason) else "estimated"] += 1
        if isinstance(outcome, Reason):
            counts[f"{REFUSED}{in_place_of_quality(outcome, inputs.record.quality).code.value}"] += 1
    return counts


def _store(
    unit: UnitOfWork,
    outcomes: Sequence[tuple[TableInputs, Estimated | Reason]],
    standing: Mapping[WindowKey, WindowRecord],
) -> None:
    tables, marks, refused, rolling = [], [], {}, []
    for inputs, outcome in outcomes:
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
    unit.windows.look_again([record.key for record in there if code_of(record.reason) is codes[record.key]])


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


JOB = Job(JOB_NAME, "Reduce pending windows to bin tables", every_s=60.0, run=run)
