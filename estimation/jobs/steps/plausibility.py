"""Step: windows whose mileage or place cannot be believed are refused before anything is estimated from them."""

from __future__ import annotations

from collections.abc import Sequence

from estimation.jobs.job import JobContext
from estimation.motion.mileage import implausible_mileages, implausible_places, without_doubt
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason
from estimation.values.registry import Mounting
from estimation.values.windows import MileageReading

APART_NS = 86_400_000_000_000  # starts of new windows, of which those between are not read


def judge_mileages(context: JobContext) -> int:
    """Judge the mileages of wheelsets with new windows; return how many windows have another verdict."""
    with context.storage.read() as unit:
        wheelsets = unit.plausibility.unjudged()
    changed = 0
    for wheelset in wheelsets:
        with context.storage.write() as unit:
            changed += _judge(unit, wheelset)
    return changed


def _judge(unit: UnitOfWork, wheelset: str) -> int:
    new, mountings = unit.plausibility.new_readings(wheelset), unit.registry.mountings(wheelset)
    if not unit.plausibility.mileages_doubted(wheelset) and _new_without_doubt(unit, wheelset, new, mountings):
        return unit.plausibility.judge(wheelset, implausible_places(new), new_only=True)
    readings = unit.plausibility.readings(wheelset)
    implausible: dict[int, Reason] = dict(implausible_places(readings))
    for mounting in mountings:
        if within := _within(readings, mounting):
            implausible.update(implausible_mileages(within, mounting, _speed(unit, mounting)))
    return unit.plausibility.judge(wheelset, implausible)


def _new_without_doubt(
    unit: UnitOfWork, wheelset: str, new: Sequence[MileageReading], mountings: Sequence[Mounting]
) -> bool:
    """Whether nothing speaks against new readings among those of before, of which none is doubted."""
    for span in _spans(new):
        around = unit.plausibility.readings_around(wheelset, span[0].start_ns, span[-1].start_ns)
        for mounting in mountings:
            if not without_doubt(_within(around, mounting), mounting, _speed(unit, mounting)):
                return False
    return True


def _spans(readings: Sequence[MileageReading]) -> list[list[MileageReading]]:
    """Return readings in order of time in groups that are apart."""
    spans: list[list[MileageReading]] = []
    for one in readings:
        if spans and one.start_ns - spans[-1][-1].start_ns <= APART_NS:
            spans[-1].append(one)
        else:
            spans.append([one])
    return spans


def _within(readings: Sequence[MileageReading], mounting: Mounting) -> list[MileageReading]:
    to_ns = mounting.to_ns
    return [one for one in readings if mounting.from_ns <= one.start_ns and (to_ns is None or one.start_ns < to_ns)]


def _speed(unit: UnitOfWork, mounting: Mounting) -> float:
    return unit.registry.vehicle(mounting.vehicle).max_speed_m_s
