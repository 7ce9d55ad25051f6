"""Stages of windows before they are estimated: which cannot be believed, and which wait again.

Those are refused whose mileage or place cannot be believed. Those wait again for which something has come: an
alignment, a class, or other parameters. A version that differs from the one of a table by less than that left unknown
is none to estimate again for, nor is a recording of the gauge alone.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
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
    spans = _spans(key for key in due if key[0] not in doubted)
    around = unit.plausibility.readings_around([span for own in spans.values() for span in own])
    new: Mapping[str, Sequence[MileageReading]] = {
        serial: [
            one
            for span in own
            for one in around[span]
            if span[1] <= one.start_ns <= span[2] and (serial, one.start_ns) in due
        ]
        for serial, own in spans.items()
    }
    if sum(map(len, new.values())) < sum(serial in spans for serial, _ in due):  # some are gone
        new = unit.plausibility.new_readings(list(spans))
        spans = _spans((serial, one.start_ns) for serial, own in new.items() for one in own)
        around = unit.plausibility.readings_around([span for own in spans.values() for span in own])
    found = {}
    for serial in serials:
        judged, against = new.get(serial, ()), mounted.get(serial, ())
        beside = [around[span] for span in spans.get(serial, ())]
        if serial not in doubted and _without_doubt(beside, against):
            against = ()
        else:
            judged = unit.plausibility.readings(serial)
        seen = {key: version for key, version in due.items() if key[0] == serial}
        found[serial] = Readings(serial, tuple(judged), against, seen)
    return found


def judge(inputs: Readings) -> Outcome[Verdicts]:
    """Return why windows of a wheelset are not believed, None for those that are, where that is new."""
    implausible: dict[int, Reason] = dict(implausible_places(inputs.judged))
    for mounting, max_speed in inputs.mounted:
        if within := [one for one in inputs.judged if mounting.covers(one.start_ns)]:
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


def _mounted(unit: UnitOfWork, serials: Sequence[str]) -> Mapping[str, tuple[Mounted, ...]]:
    mountings = unit.registry.mountings_of(serials)
    vehicles = unit.registry.vehicles_of({one.vehicle for own in mountings.values() for one in own})
    return {
        serial: tuple((mounting, vehicles[mounting.vehicle].max_speed_m_s) for mounting in own)
        for serial, own in mountings.items()
    }


def _spans(windows: Iterable[WindowKey]) -> Mapping[str, list[ReadingSpan]]:
    """Return first and last start of groups of windows that are apart, by wheelset; each in order of time."""
    spans: defaultdict[str, list[ReadingSpan]] = defaultdict(list)
    for serial, start_ns in windows:
        own = spans[serial]
        if own and start_ns - own[-1][2] <= APART_NS:
            own[-1] = (serial, own[-1][1], start_ns)
        else:
            own.append((serial, start_ns, start_ns))
    return spans


def _without_doubt(beside: Sequence[Sequence[MileageReading]], mounted: Sequence[Mounted]) -> bool:
    """Whether nothing speaks against new readings among those of before, of which none is doubted."""
    return all(
        without_doubt([one for one in readings if mounting.covers(one.start_ns)], mounting, max_speed)
        for readings in beside
        for mounting, max_speed in mounted
    )


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
        in_force = unit.tracks.in_force(code)
        aligned = aligned if in_force is not None and in_force.status is Status.ESTIMATED else []
    changed = sorted({*unit.epochs.outdated([code]), *_made_otherwise(unit, classes, code)})
    return Outdated(changed, aligned, classed)


def _made_otherwise(unit: UnitOfWork, classes: ClassLookup, section: str) -> Iterator[WindowKey]:
    """Yield the windows whose table was made with other parameters than those in force."""
    for key in unit.tables.parameter_keys([section]):
        if key.parameter_key != classes.table_key(key.vehicle, key.wheelset):
            yield from unit.tables.made_with(key)


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
    # what follows is that windows wait; those that do are not found again
    compute=lambda found: Outcome(more=bool(found.changed or found.aligned or found.classed)),
    counted=Counted(looked="looks", changed="results", more=("requeued", "passed_over")),
    store=let_wait,
)
