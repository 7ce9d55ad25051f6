"""Step: windows whose mileage or place cannot be believed are refused before anything is estimated from them."""

from __future__ import annotations

from estimation.jobs.job import JobContext
from estimation.motion.mileage import implausible_mileages, implausible_places
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason


def judge_mileages(context: JobContext) -> int:
    """Judge the mileages of wheelsets with new windows; return how many windows have another verdict.

    Parameters
    ----------
    context
        Storage; each wheelset is one transaction.
    """
    with context.storage.read() as unit:
        wheelsets = unit.plausibility.unjudged()
    changed = 0
    for wheelset in wheelsets:
        with context.storage.write() as unit:
            changed += _judge(unit, wheelset)
    return changed


def _judge(unit: UnitOfWork, wheelset: str) -> int:
    readings = unit.plausibility.readings(wheelset)
    implausible: dict[int, Reason] = dict(implausible_places(readings))
    for mounting in unit.registry.mountings(wheelset):
        within = [
            reading
            for reading in readings
            if mounting.from_ns <= reading.start_ns and (mounting.to_ns is None or reading.start_ns < mounting.to_ns)
        ]
        if within:
            speed = unit.registry.vehicle(mounting.vehicle).max_speed_m_s
            implausible.update(implausible_mileages(within, mounting, speed))
    return unit.plausibility.judge(wheelset, implausible)
