"""Stages of windows before they are estimated: which cannot be believed, and which wait again.

Those are refused whose mileage or place cannot be believed. Those wait again for which something has come: an
alignment, a class, or other parameters. A version that differs from the one of a table by less than that left unknown
is none to estimate again for, nor is a recording of the gauge alone.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from estimation.jobs.job import JobContext
from estimation.jobs.stage import Counted, Outcome, Part, Stage
from estimation.jobs.steps.vehicle_classes import ClassLookup
from estimation.motion.mileage import implausible_mileages, implausible_places, without_doubt
from estimation.motion.window_motion import NO_ALIGNMENT
from estimation.storage import UnitOfWork
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.registry import Mounting
from estimation.values.runs import Facet, SubjectKind
from estimation.values.windows import DueStage, MileageReading, ReadingSpan, WindowKey, WindowMark, WindowState

APART_NS = 86_400_000_000_000  # starts of new windows, of which those between are not read
Mounted = tuple[Mounting, float]
"""A mounting and the greatest speed of its vehicle, m/s."""


@dataclass(frozen=True, slots=True)
class Readings:
    """What the windows of a wheelset are judged by.

    Attributes:
        judged: New readings where nothing speaks against them; else all.
        mounted: Empty where nothing speaks against the readings.
        seen: Windows that are due, with the versions in which they were.
    """

    wheelset: str
    judged: tuple[MileageReading, ...]
    mounted: tuple[Mounted, ...]
    seen: Mapping[WindowKey, int]


Verdicts = Mapping[WindowKey, Reason | None]


def load_readings(unit: UnitOfWork, serials: Sequence[str], _: JobContext) -> Mapping[str, Readings]:
    """Return the new readings of some wheelsets, or all where one is doubted or something speaks against a new one."""
    (due, doubted), mounted = unit.plausibility.due(serials), _mounted(unit, serials)
    spans = {serial: _spans(serial, own) for serial, own in _starts(due).items() if serial not in doubted}
    around = unit.plausibility.readings_around([span for own in spans.values() for span in own])
    new: Mapping[str, Sequence[MileageReading]] = {
        serial: [one for span in own for one in around[span] if _is_new(one, span, due)]
        for serial, own in spans.items()
    }
    if sum(map(len, new.values())) < sum(serial in spans for serial, _ in due):  # some are gone
        new = unit.plausibility.new_readings(list(spans))
        spans = {serial: _spans(serial, [one.start_ns for one in own]) for serial, own in new.items()}
        around = unit.plausibility.readings_around([span for own in spans.values() for span in own])
    found = {}
    for serial in serials:
        seen = {key: version for key, version in due.items() if key[0] == serial}
        beside = [around[span] for span in spans.get(serial, ())]
        if serial not in doubted and _without_doubt(beside, mounted.get(serial, ())):
            found[serial] = Readings(serial, tuple(new.get(serial, ())), (), seen)
        else:
            every = tuple(unit.plausibility.readings(serial))
            found[serial] = Readings(serial, every, mounted.get(serial, ()), seen)
    return found


def judge(inputs: Readings) -> Outcome[Verdicts]:
    """Return why windows of a wheelset are not believed, None for those that are, where that is new."""
    implausible: dict[int, Reason] = dict(implausible_places(inputs.judged))
    for mounting, max_speed in inputs.mounted:
        if within := _within(inputs.judged, mounting):
            implausible.update(implausible_mileages(within, mounting, max_speed))
    verdicts = {
        (inputs.wheelset, one.start_ns): implausible.get(one.start_ns)
        for one in inputs.judged
        if implausible.get(one.start_ns) != one.refused
    }
    return Outcome([Part(verdicts)])


def store_verdicts(
    unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[Readings | None, Outcome[Verdicts]]]
) -> Mapping[str, int]:
    """Store which windows are believed; return how many have another verdict."""
    verdicts: dict[WindowKey, Reason | None] = {}
    seen: dict[WindowKey, int] = {}
    for inputs, outcome in made.values():
        seen.update({} if inputs is None else inputs.seen)
        for part in outcome.parts:
            verdicts.update(part.value or {})
    changed = unit.plausibility.judge(verdicts)
    unit.due.settle_all(DueStage.MILEAGES, seen)
    return {"mileages_judged": changed}


def _is_new(reading: MileageReading, span: ReadingSpan, due: Collection[WindowKey]) -> bool:
    """Return whether a reading in or beside a span is one of those that the span was made of."""
    wheelset, from_ns, to_ns = span
    return from_ns <= reading.start_ns <= to_ns and (wheelset, reading.start_ns) in due


def _mounted(unit: UnitOfWork, serials: Sequence[str]) -> Mapping[str, tuple[Mounted, ...]]:
    mountings = unit.registry.mountings_of(serials)
    vehicles = unit.registry.vehicles_of({one.vehicle for own in mountings.values() for one in own})
    return {
        serial: tuple((mounting, vehicles[mounting.vehicle].max_speed_m_s) for mounting in own)
        for serial, own in mountings.items()
    }


def _starts(due: Iterable[WindowKey]) -> Mapping[str, Sequence[int]]:
    starts: defaultdict[str, list[int]] = defaultdict(list)
    for serial, start_ns in due:
        starts[serial].append(start_ns)
    return starts


def _without_doubt(beside: Sequence[Sequence[MileageReading]], mounted: Sequence[Mounted]) -> bool:
    """Whether nothing speaks against new readings among those of before, of which none is doubted."""
    return all(
        without_doubt(_within(readings, mounting), mounting, max_speed)
        for readings in beside
        for mounting, max_speed in mounted
    )


def _spans(wheelset: str, starts: Sequence[int]) -> list[ReadingSpan]:
    """Return first and last of starts in order of time in groups that are apart."""
    spans: list[ReadingSpan] = []
    for start_ns in starts:
        if spans and start_ns - spans[-1][2] <= APART_NS:
            spans[-1] = (wheelset, spans[-1][1], start_ns)
        else:
            spans.append((wheelset, start_ns, start_ns))
    return spans


def _within(readings: Sequence[MileageReading], mounting: Mounting) -> list[MileageReading]:
    to_ns = mounting.to_ns
    return [one for one in readings if mounting.from_ns <= one.start_ns and (to_ns is None or one.start_ns < to_ns)]


JUDGE = Stage(
    name=DueStage.MILEAGES,
    job="estimate_windows",
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
    """Windows on a section, or on none, for which something has come.

    Attributes:
        changed: Estimated on another version of the alignment, or with other parameters, than they are to be.
        aligned: Refused without an alignment, of which there is one.
        classed: Refused without a class of their vehicle, of which there is one.
    """

    changed: Sequence[WindowKey]
    aligned: Sequence[WindowKey]
    classed: Sequence[WindowKey]


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
        known = unit.tracks.in_force(code)
        aligned = aligned if known is not None and known.status is Status.ESTIMATED else []
    changed = sorted({*unit.epochs.outdated([code]), *_made_otherwise(unit, classes, code)})
    return Outdated(changed, aligned, classed)


def _made_otherwise(unit: UnitOfWork, classes: ClassLookup, section: str) -> Iterator[WindowKey]:
    """Yield the windows whose table was made with other parameters than those in force."""
    for key in unit.tables.parameter_keys([section]):
        if key.parameter_key != classes.table_key(key.vehicle, key.wheelset):
            yield from unit.tables.made_with(key)


def outcome_of(outdated: Outdated) -> Outcome[None]:
    """Return no result: what follows is that windows wait. Those that do are not found again."""
    return Outcome(more=bool(outdated.changed or outdated.aligned or outdated.classed))


def let_wait(
    unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[Outdated | None, Outcome[None]]]
) -> Mapping[str, int]:
    """Let windows wait again; count how many do and how many cannot, for their samples were purged."""
    counts: Counter[str] = Counter()
    for outdated, _outcome in made.values():
        if outdated is None:
            continue
        waiting = [WindowMark(*key, WindowState.PENDING) for key in (*outdated.changed, *outdated.aligned)]
        again = {mark.key for mark in unit.windows.mark_all(waiting)}
        counts["passed_over"] += len(set(outdated.changed) - again)
        counts["requeued"] += len(again) + len(unit.windows.look_again(outdated.classed))
    return counts


OUTDATED = Stage(
    name="outdated",
    job="estimate_windows",
    kind=SubjectKind.SECTION,
    facets=(Facet.REGISTRY, Facet.ALIGNMENT, Facet.PLACES),
    settings=lambda settings: settings.estimation.as_json(),
    load=load_outdated,
    compute=outcome_of,
    counted=Counted(looked="looks", changed="results", more=("requeued", "passed_over")),
    store=let_wait,
)
