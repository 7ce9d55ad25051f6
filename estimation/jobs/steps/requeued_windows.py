"""Step: windows wait again that something has come for: an alignment, a class, or other parameters.

Only sections are looked at on which something has happened. Where nothing is found nothing is written, but that they
were looked at.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from estimation.jobs.job import JobContext
from estimation.jobs.steps.section_looks import note_sections, section_news
from estimation.jobs.steps.vehicle_classes import ClassLookup
from estimation.motion.window_motion import NO_ALIGNMENT
from estimation.storage import UnitOfWork
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import WindowKey, WindowState


def requeued(context: JobContext, stage: str) -> Mapping[str, int]:
    """Let windows wait again, and return how many do and how many cannot, for their samples were purged.

    A version that differs from the one of a table by less than that left unknown is none to estimate again for, nor is
    a recording of the gauge alone.
    """
    with context.storage.read() as unit:
        news = section_news(unit, context, stage)
        nothing = not news or not _found(unit, context, news)
    if nothing:
        note_sections(context, stage, news)
        return {"requeued": 0}
    with context.storage.write() as unit:
        found = _found(unit, context, news)
        again = sum(unit.windows.mark(*key, WindowState.PENDING) for key in found.outdated)
        come = sum(unit.windows.requeue(code, NO_ALIGNMENT.code) for code in found.aligned)
        classed = sum(unit.windows.requeue_vehicle(code, ReasonCode.CLASS_UNKNOWN) for code in found.classed)
    passed_over = len(found.outdated) - again
    return {"requeued": again + come + classed} | ({"passed_over": passed_over} if passed_over else {})


@dataclass(frozen=True, slots=True)
class _Found:
    """What has come, and for what.

    Attributes:
        outdated: Windows that were estimated on another version of the alignment, or with other parameters, than they
            are to be.
        aligned: Sections with windows that were refused without an alignment, of which there is one.
        classed: Vehicles with windows that were refused without a class, of which there is one.
    """

    outdated: Collection[WindowKey]
    aligned: Collection[str]
    classed: Collection[str]

    def __bool__(self) -> bool:
        return bool(self.outdated or self.aligned or self.classed)


def _found(unit: UnitOfWork, context: JobContext, sections: Collection[str]) -> _Found:
    classes = ClassLookup(unit, context.settings.estimation)
    standing = unit.tracks.standings().items()
    estimated = {code for code, one in standing if one.in_force and one.in_force.status is Status.ESTIMATED}
    refused = unit.windows.refused_sections(NO_ALIGNMENT.code, sorted(estimated & {*sections}))
    waiting = unit.windows.refused_vehicles(ReasonCode.CLASS_UNKNOWN, sections)
    return _Found(
        sorted({*unit.epochs.outdated(sections), *_made_otherwise(unit, classes, sections)}),
        refused,
        [vehicle for vehicle in waiting if not isinstance(classes.of_vehicle(vehicle), Reason)],
    )


def _made_otherwise(unit: UnitOfWork, classes: ClassLookup, sections: Collection[str]) -> Iterator[WindowKey]:
    """Yield the windows whose table was made with other parameters than those in force."""
    for key in unit.tables.parameter_keys(sections):
        if key.parameter_key != classes.table_key(key.vehicle, key.wheelset):
            yield from unit.tables.made_with(key)
