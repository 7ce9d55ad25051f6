"""Stage: windows whose mileage or place cannot be believed are refused before anything is estimated from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimation.jobs.job import JobContext
from estimation.jobs.stage import Counted, Outcome, Part, Stage
from estimation.motion.mileage import implausible_mileages, implausible_places, without_doubt
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason
from estimation.values.registry import Mounting
from estimation.values.runs import SubjectKind
from estimation.values.windows import DueStage, MileageReading, ReadingSpan, WindowKey

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
    due, new = unit.due.of_wheelsets(DueStage.MILEAGES, serials), unit.plausibility.new_readings(serials)
    doubted, mounted = unit.plausibility.doubted(serials), _mounted(unit, serials)
    spans = {serial: _spans(serial, own) for serial, own in new.items() if serial not in doubted}
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
    """Return why windows of a wheelset are not believed; None for those that are."""
    implausible: dict[int, Reason] = dict(implausible_places(inputs.judged))
    for mounting, max_speed in inputs.mounted:
        if within := _within(inputs.judged, mounting):
            implausible.update(implausible_mileages(within, mounting, max_speed))
    verdicts = {(inputs.wheelset, one.start_ns): implausible.get(one.start_ns) for one in inputs.judged}
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


def _without_doubt(beside: Sequence[Sequence[MileageReading]], mounted: Sequence[Mounted]) -> bool:
    """Whether nothing speaks against new readings among those of before, of which none is doubted."""
    return all(
        without_doubt(_within(readings, mounting), mounting, max_speed)
        for readings in beside
        for mounting, max_speed in mounted
    )


def _spans(wheelset: str, readings: Sequence[MileageReading]) -> list[ReadingSpan]:
    """Return first and last start of readings in order of time in groups that are apart."""
    spans: list[ReadingSpan] = []
    for one in readings:
        if spans and one.start_ns - spans[-1][2] <= APART_NS:
            spans[-1] = (wheelset, spans[-1][1], one.start_ns)
        else:
            spans.append((wheelset, one.start_ns, one.start_ns))
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
