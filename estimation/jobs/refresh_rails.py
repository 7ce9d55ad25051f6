"""Stages: part what belongs to the rails of each section from what belongs to the wheels of each wheelset.

The first makes conicities of a wheelset by section, again in the mileage intervals that have changed; the second looks
at all of them together.
"""

from __future__ import annotations

import hashlib
import logging
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimation.jobs.job import Job, JobContext
from estimation.jobs.runner import run_all
from estimation.jobs.stage import Counted, Outcome, Part, Stage
from estimation.jobs.steps.rail_anchors import AnchorInputs, anchor_inputs, anchors
from estimation.jobs.steps.rail_cells import CELL_VERSION, WheelsetCells, wheelset_cells
from estimation.rails.apart import exceeds, rails_apart, reported
from estimation.rails.cell import RailsParameters, with_refused
from estimation.storage import UnitOfWork
from estimation.values.arrays import FloatArray
from estimation.values.geometry import GEOMETRY
from estimation.values.opinions import (
    CELLS,
    SECTION_RAILS,
    WHEELSET_RAILS,
    RailPart,
    RailsApart,
    RailsFinding,
    StoredCell,
    WheelsFinding,
)
from estimation.values.runs import EVERYTHING, Facet, Result, SubjectKind
from estimation.values.trend import TREND

_log = logging.getLogger(__name__)


def make_cells(inputs: WheelsetCells) -> Outcome[StoredCell]:
    """Return the cells of a wheelset that are others by now."""
    return Outcome([Part(one.made()) for one in inputs.to_make])


def store_cells(
    unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[WheelsetCells, Outcome[StoredCell]]]
) -> Mapping[str, int]:
    """Store cells in place of what was of their keys; return how many are others, or gone."""
    changed = [part.value for _, outcome in made.values() for part in outcome.parts if part.value is not None]
    changed += [one for inputs, _ in made.values() for one in inputs.moved]
    gone = [key for inputs, _ in made.values() for key in inputs.gone]
    unit.rails.put_cells([*changed, *(one for inputs, _ in made.values() for one in inputs.kept)])
    unit.rails.drop_cells(gone)
    return {"cells": len(changed) + len(gone)}


@dataclass(frozen=True, slots=True)
class RailsInputs:
    """All cells, and what holds their level; the digest stands for both."""

    digest: str
    damaged: tuple[str, ...]  # wheelsets with cells that cannot be read
    cells: tuple[StoredCell, ...] = field(metadata={"made_from": False})
    on_file: AnchorInputs = field(metadata={"made_from": False})
    amplitude: FloatArray = field(metadata={"made_from": False})  # (k,) m
    parameters: RailsParameters = field(metadata={"made_from": False})


@dataclass(frozen=True, slots=True)
class RailsFindings:
    """What was found of all sections, and of all wheelsets in their newest interval.

    Attributes:
        refused: Why sections that are named as known, by code, and wheelsets that are measured hold no level.
    """

    sections: Mapping[str, RailsFinding]
    wheelsets: Mapping[str, WheelsFinding]
    refused: Mapping[str, str]
    refused_wheels: Mapping[str, str]


def load_rails(unit: UnitOfWork, _: Sequence[str], context: JobContext) -> Mapping[str, RailsInputs]:
    """Return what parting wheels and rails is made from."""
    parameters, cells = context.settings.rails.model, unit.rails.cells()
    on_file = anchor_inputs(unit, cells, context)
    stand_for = [(one.wheel, one.rail, one.digest, one.reason and str(one.reason.code)) for one in cells]
    text = f"{stand_for!r} {on_file.text} {parameters!r}"
    usable = next((one.usable for one in cells if one.usable is not None), None)
    curve = context.settings.estimation.geometry.curve
    inputs = RailsInputs(
        digest=hashlib.sha256(text.encode()).hexdigest(),
        damaged=tuple(sorted({one.wheel.wheelset for one in cells if one.damaged})),
        cells=tuple(cells),
        on_file=on_file,
        amplitude=np.array(curve.amplitudes) if usable is None else usable.amplitude,
        parameters=parameters,
    )
    return {EVERYTHING: inputs}


def part_rails(inputs: RailsInputs) -> Outcome[RailsFindings]:
    """Return what belongs to rails, and what belongs to wheels."""
    usable = [one.usable for one in inputs.cells if one.usable is not None]
    held = anchors(inputs.on_file, inputs.amplitude)
    apart = rails_apart(usable, inputs.amplitude, held, inputs.parameters)
    apart = with_refused(apart, inputs.cells)
    newest = {one.wheel.wheelset: one for one in apart.wheels}  # in the order of their keys
    amplitude, refused_wheels = tuple(apart.amplitude.tolist()), apart.refused_wheels
    findings = RailsFindings(
        sections=_sections(apart, held.wheel.profile, inputs.parameters),
        wheelsets={serial: WheelsFinding(amplitude, one, refused_wheels.get(serial)) for serial, one in newest.items()},
        refused=dict.fromkeys(held.missing, "not on file") | {code: str(why) for code, why in apart.refused.items()},
        refused_wheels={serial: str(why) for serial, why in refused_wheels.items()},
    )
    return Outcome([Part(findings)])


def _sections(apart: RailsApart, profile: str, parameters: RailsParameters) -> Mapping[str, RailsFinding]:
    """Return what is found of every section, its periods oldest first."""
    periods: defaultdict[str, list[RailPart]] = defaultdict(list)
    for one in apart.rails:
        periods[one.rail.section].append(one)
    findings = {}
    for section, parts in sorted(periods.items()):
        newest = reported(parts[-1].excess, apart.amplitude, parameters.limit_amplitude)
        excess, amplitude = (None, None) if newest is None else newest
        findings[section] = RailsFinding(
            amplitude=tuple(apart.amplitude.tolist()),
            reference_wheel_profile=profile,
            periods=tuple(parts),
            trend=apart.trends.get(section),
            limit=parameters.limit,
            exceeded=None if excess is None else exceeds(excess, parameters.limit),
            reported_amplitude=amplitude,
            refused=apart.refused.get(section),
            no_trend=apart.no_trends.get(section),
        )
    return findings


def store_rails(
    unit: UnitOfWork, context: JobContext, made: Mapping[str, tuple[RailsInputs, Outcome[RailsFindings]]]
) -> Mapping[str, int]:
    """Store what was found in the place of all that was found before; cells that cannot be read are made again."""
    inputs, outcome = made[EVERYTHING]
    (part,) = outcome.parts
    assert part.value is not None
    for kind, findings in ((SECTION_RAILS, part.value.sections), (WHEELSET_RAILS, part.value.wheelsets)):
        common = (inputs.digest, context.code_version, context.clock.now_ns())
        unit.results.replace_all(kind, [Result(subject, *common, one) for subject, one in findings.items()])
    if inputs.damaged:
        unit.marks.forget(CELLS, inputs.damaged)
    for code, why in sorted(part.value.refused.items()):
        _log.warning("section %s is named as known, but holds no level: %s", code, why)
    for serial, why in sorted(part.value.refused_wheels.items()):
        _log.warning("wheelset %s is measured, but holds no level: %s", serial, why)
    return {"sections": len(part.value.sections), "known_refused": len(part.value.refused)}


OF_WHEELSETS = Stage(
    name=CELLS,
    job="refresh_rails",
    kind=SubjectKind.WHEELSET,
    facets=(Facet.REGISTRY, Facet.RESTARTS, GEOMETRY.stage, TREND.head_facet),
    settings=lambda settings: (CELL_VERSION, settings.estimation, settings.rails.model.period_days),
    load=wheelset_cells,
    compute=make_cells,
    counted=Counted(looked="wheelsets", changed="cells"),
    store=store_cells,
    at_once=4,
)
OF_ALL = Stage(
    name="rails",
    job=OF_WHEELSETS.job,
    kind=SubjectKind.WHEELSET,
    facets=(Facet.REGISTRY, Facet.RESTARTS, Facet.ALIGNMENT, TREND.head_facet, CELLS),
    settings=lambda settings: (settings.rails, settings.estimation),
    load=load_rails,
    compute=part_rails,
    counted=Counted(looked="looks", changed="sections", more=("known_refused",)),
    store=store_rails,
    together=True,
)


def _run(context: JobContext) -> Mapping[str, int]:
    counts = run_all((OF_WHEELSETS, OF_ALL), context)
    del counts[OF_ALL.counted.looked]
    return counts


JOB = Job(
    name=OF_WHEELSETS.job,
    description="Part what belongs to the rails of sections from what belongs to the wheels of wheelsets",
    every_s=3_600.0,
    run=_run,
)
