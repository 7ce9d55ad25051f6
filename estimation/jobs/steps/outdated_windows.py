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
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.results import Facet
from estimation.values.runs import SubjectKind
from estimation.values.windows import WindowKey, WindowMark, WindowState


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


def load(unit: UnitOfWork, sections: Sequence[str], context: JobContext) -> Mapping[str, Outdated]:
    """Return what has come for the windows of some sections."""
    classes = ClassLookup(unit, context.settings.estimation)
    return {code: _of_section(unit, classes, code) for code in sections}


def _of_section(unit: UnitOfWork, classes: ClassLookup, code: str) -> Outdated:
    known = unit.tracks.in_force(code)
    has_alignment = known is not None and known.status is Status.ESTIMATED
    aligned, classed = [], []
    for record in unit.windows.refused_on(code, (NO_ALIGNMENT.code, ReasonCode.CLASS_UNKNOWN)):
        if code_of(record.reason) is ReasonCode.CLASS_UNKNOWN:
            classed += [] if isinstance(classes.of_vehicle(record.vehicle), Reason) else [record.key]
        elif has_alignment:
            aligned.append(record.key)
    changed = sorted({*unit.epochs.outdated([code]), *_made_otherwise(unit, classes, code)})
    return Outdated(changed, aligned, classed)


def _made_otherwise(unit: UnitOfWork, classes: ClassLookup, section: str) -> Iterator[WindowKey]:
    """Yield the windows whose table was made with other parameters than those in force."""
    for key in unit.tables.parameter_keys([section]):
        if key.parameter_key != classes.table_key(key.vehicle, key.wheelset):
            yield from unit.tables.made_with(key)


def compute(outdated: Outdated) -> Outcome[None]:
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
    load=load,
    compute=compute,
    counted=Counted(looked="looks", changed="results", more=("requeued", "passed_over")),
    store=let_wait,
)
