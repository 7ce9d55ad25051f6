"""Stage: windows wait again that something has come for: an alignment, a class, or other parameters.

A version that differs from the one of a table by less than that left unknown is none to estimate again for, nor is a
recording of the gauge alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from estimation.jobs.job import JobContext
from estimation.jobs.stage import Counted, Outcome, Stage
from estimation.jobs.steps.vehicle_classes import ClassLookup
from estimation.motion.window_motion import NO_ALIGNMENT
from estimation.storage import UnitOfWork
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.results import Facet
from estimation.values.runs import SubjectKind
from estimation.values.windows import WindowKey, WindowMark, WindowState


@dataclass(frozen=True, slots=True)
class Outdated:
    """What has come for the windows of a section, or for those that are on none.

    Attributes:
        windows: That were estimated on another version of the alignment, or with other parameters, than they are to be.
        aligned: Whether windows were refused without an alignment, of which there is one.
        classed: Vehicles with windows that were refused without a class, of which there is one.
    """

    windows: Sequence[WindowKey]
    aligned: bool
    classed: Sequence[str]


def load(unit: UnitOfWork, sections: Sequence[str], context: JobContext) -> Mapping[str, Outdated]:
    """Return what has come for the windows of some sections."""
    classes = ClassLookup(unit, context.settings.estimation)
    return {code: _of_section(unit, classes, code) for code in sections}


def _of_section(unit: UnitOfWork, classes: ClassLookup, code: str) -> Outdated:
    known = unit.tracks.in_force(code)
    aligned = known is not None and known.status is Status.ESTIMATED
    waiting = unit.windows.refused_vehicles(ReasonCode.CLASS_UNKNOWN, [code])
    return Outdated(
        windows=sorted({*unit.epochs.outdated([code]), *_made_otherwise(unit, classes, code)}),
        aligned=aligned and bool(unit.windows.refused_sections(NO_ALIGNMENT.code, [code])),
        classed=[vehicle for vehicle in waiting if not isinstance(classes.of_vehicle(vehicle), Reason)],
    )


def _made_otherwise(unit: UnitOfWork, classes: ClassLookup, section: str) -> Iterator[WindowKey]:
    """Yield the windows whose table was made with other parameters than those in force."""
    for key in unit.tables.parameter_keys([section]):
        if key.parameter_key != classes.table_key(key.vehicle, key.wheelset):
            yield from unit.tables.made_with(key)


def compute(outdated: Outdated) -> Outcome[None]:
    """Return no result: what follows is that windows wait. Those that do are not found again."""
    return Outcome(more=bool(outdated.windows or outdated.aligned or outdated.classed))


def let_wait(
    unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[Outdated | None, Outcome[None]]]
) -> Mapping[str, int]:
    """Let windows wait again; count how many do and how many cannot, for their samples were purged."""
    counts: Counter[str] = Counter()
    for section, (outdated, _outcome) in made.items():
        if outdated is None:
            continue
        again = len(unit.windows.mark_all([WindowMark(*key, WindowState.PENDING) for key in outdated.windows]))
        counts["passed_over"] += len(outdated.windows) - again
        come = unit.windows.requeue(section, NO_ALIGNMENT.code) if outdated.aligned else 0
        classed = sum(unit.windows.requeue_vehicle(code, ReasonCode.CLASS_UNKNOWN) for code in outdated.classed)
        counts["requeued"] += again + come + classed
    return counts


OUTDATED = Stage(
    name="outdated",
    job="estimate_windows",
    kind=SubjectKind.SECTION,
    facets=(Facet.REGISTRY, Facet.ALIGNMENT, Facet.PLACES),
    settings=lambda settings: settings.estimation.as_json(),
    load=load,
    compute=compute,
    counted=Counted(looked="looks", changed="results", more=("requeued", "passed_over")),
    store=let_wait,
)
