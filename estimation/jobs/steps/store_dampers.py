"""Step: what windows say of dampers stored, and what the running gears say then."""

from __future__ import annotations

from collections.abc import Sequence

from estimation.dampers.pooled import DamperParameters, gear_damper
from estimation.jobs.job import JobContext
from estimation.storage import UnitOfWork
from estimation.values.dampers import WindowDamper

MOST_WINDOWS = 600  # of a running gear that count and are kept: 10 hours of running


def store_dampers(unit: UnitOfWork, found: Sequence[WindowDamper], context: JobContext) -> None:
    """Store what windows say, and the dampers of their running gears, in one transaction."""
    for one in found:
        unit.dampers.put(one)
    for vehicle, first_axle in sorted({one.gear for one in found}):
        newest = unit.dampers.newest(vehicle, first_axle, MOST_WINDOWS)
        if not newest:
            continue
        if len(newest) == MOST_WINDOWS:
            unit.dampers.forget(vehicle, first_axle, newest[-1].start_ns)
        damper = gear_damper(newest, DamperParameters())
        unit.dampers.put_gear(damper, newest[0].wheelset, context.code_version)
