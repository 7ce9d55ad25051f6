"""Job: creep forces of windows, the dampers above them, friction of sections, and alerts of low adhesion.

Each window is read once, after its wheelset has a geometry. The windows of a section that were looked at are pooled
with those of the hours before; where the stretches of certainly low friction have changed, the windows on them and
their geometries are estimated again, in the same run. What a window says of friction stays what it said: a second run
finds nothing new. The newest hours decide on the alert.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimation.adhesion.creep_forces import FrictionParameters
from estimation.adhesion.friction import section_adhesion, touched
from estimation.adhesion.parameters import FORCES
from estimation.alerts.rule_book import section_changes
from estimation.alerts.rules.running_gear import LowAdhesionRule
from estimation.dampers.damper import DamperParameters, gear_damper
from estimation.dampers.parameters import DAMPING
from estimation.jobs import estimate_windows, refresh_geometry
from estimation.jobs.job import Job, JobContext
from estimation.jobs.parameters import JOBS, WORK
from estimation.jobs.runner import run_all
from estimation.jobs.stage import Counted, Outcome, Part, Stage, made_from
from estimation.jobs.steps.load_window import certain_stretches
from estimation.jobs.steps.window_creep import (
    CreepInputs,
    CreepOfWindow,
    creep_inputs,
    creep_of_window,
    friction_parameters,
    pool_ends,
    pooled_ns,
)
from estimation.storage import UnitOfWork
from estimation.values.alerts import CloseReason
from estimation.values.geometry import GEOMETRY
from estimation.values.opinions import (
    CREEP,
    FRICTION,
    GEAR_DAMPERS,
    GearDamper,
    SectionAdhesion,
    WindowAdhesion,
    WindowDamper,
    part_of_gear,
)
from estimation.values.runs import Facet, SubjectKind
from estimation.values.sums import SUMS
from estimation.values.windows import WindowKey, WindowMark, WindowState, key_of_text, text_of_key

JOB_NAME = "refresh_adhesion"
DAMPERS = DamperParameters()
FRICTION_NUMBERS = (FORCES, SUMS, FrictionParameters())
BESIDE = {"wheelsets", "looks", "results"}  # counts of stages that are no counts of the job


def list_waiting(unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[bool, Outcome[None]]]) -> Mapping[str, int]:
    """List the windows that waited for the first geometry of their wheelset."""
    for serial in made:
        unit.adhesion.list_waiting(serial)
    return {}


def load_creep(unit: UnitOfWork, keys: Sequence[str], context: JobContext) -> Mapping[str, CreepInputs]:
    """Return the windows that are estimated and whose creep, of these samples, has not been looked at."""
    windows = [key_of_text(key) for key in keys]
    records, looked_at = unit.windows.several(windows), unit.adhesion.looked_at(windows)
    having = unit.geometries.having({record.wheelset for record in records})
    chosen = [
        record
        for record in records
        if record.state is WindowState.ESTIMATED and record.wheelset in having and record.track_section is not None
        if not record.samples_purged and looked_at.get(record.key) != record.content_digest
    ]
    creep = creep_inputs(unit, chosen, context.settings.estimation) if chosen else {}
    return {text_of_key(*key): inputs for key, inputs in creep.items()}


def store_creep(
    unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[CreepInputs, Outcome[CreepOfWindow]]]
) -> Mapping[str, int]:
    """Store what windows with the same samples still say."""
    looked_at = [part.value for _, outcome in made.values() for part in outcome.parts if part.value is not None]
    if not looked_at:
        return {}
    creeps = [window.creep for window in looked_at]
    now = {record.key: record.content_digest for record in unit.windows.several([creep.key for creep in creeps])}
    unit.adhesion.put_all([creep for creep in creeps if now.get(creep.key) == creep.content_digest])
    dampers = [window.damper for window in looked_at if window.damper is not None]
    unit.dampers.put_all(list({(*damper.gear, damper.start_ns): damper for damper in dampers}.values()))
    return {"windows": len(looked_at), "refused": sum(window.creep.reason is not None for window in looked_at)}


@dataclass(frozen=True, slots=True)
class VehicleDampers:
    """What the newest windows of each running gear of a vehicle say, newest first."""

    gears: tuple[tuple[WindowDamper, ...], ...]
    parameters: DamperParameters


def load_dampers(unit: UnitOfWork, vehicles: Sequence[str], _: JobContext) -> Mapping[str, VehicleDampers]:
    """Return what the dampers of some vehicles are found from."""
    gears: dict[str, list[tuple[WindowDamper, ...]]] = {}
    for vehicle, first_axle in unit.dampers.gears(vehicles):
        newest = tuple(unit.dampers.newest(vehicle, first_axle, JOBS.most_gear_windows))
        if newest:
            gears.setdefault(vehicle, []).append(newest)
    return {vehicle: VehicleDampers(tuple(windows), DAMPERS) for vehicle, windows in gears.items()}


def judge_dampers(inputs: VehicleDampers) -> Outcome[GearDamper]:
    """Return the dampers of the running gears of a vehicle."""
    dampers = [gear_damper(windows, inputs.parameters) for windows in inputs.gears]
    return Outcome([Part(damper, part=part_of_gear(damper.first_axle)) for damper in dampers])


def forget_windows(
    unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[VehicleDampers, Outcome[GearDamper]]]
) -> Mapping[str, int]:
    """Forget what windows say that do not count any more."""
    for inputs, _outcome in made.values():
        for windows in inputs.gears:
            if len(windows) == JOBS.most_gear_windows:
                unit.dampers.forget(*windows[-1].gear, windows[-1].start_ns)
    return {}


@dataclass(frozen=True, slots=True)
class Span:
    """Passes of a section that are pooled."""

    passes: tuple[WindowAdhesion, ...]
    parameters: FrictionParameters
    fleets: tuple[str, ...]  # that passed it


@dataclass(frozen=True, slots=True)
class FrictionInputs:
    """What the friction of a section is found from."""

    section: str
    length_m: float
    spans: tuple[Span, ...]  # oldest first
    made_with: str  # digest of the limits
    seen: Mapping[WindowKey, int]  # windows that are pooled, with the versions in which they were due
    older_ns: int | None  # passes before that are to be pooled by the next run; None for none


def load_friction(unit: UnitOfWork, sections: Sequence[str], context: JobContext) -> Mapping[str, FrictionInputs]:
    """Return the passes of some sections that are to be pooled: around new ones, or all where limits are others."""
    rule, made_with = context.settings.rules.rule(LowAdhesionRule), unit.adhesion.made_with(sections)
    lengths = {section.code: section.length_m for section in unit.tracks.sections()}
    return {
        section: _of_section(unit, section, lengths.get(section, 0.0), rule, made_with.get(section))
        for section in sections
        if section
    }


def _of_section(
    unit: UnitOfWork, section: str, length_m: float, rule: LowAdhesionRule, before: tuple[int, str] | None
) -> FrictionInputs:
    due = unit.due.of_section(FRICTION, section)
    starts, limits = {start_ns for _, start_ns in due}, ""
    newest_ns = max([*starts, *([] if before is None else [before[0]])], default=None)
    if newest_ns is not None:
        parameters = _span(unit, section, newest_ns, rule).parameters
        limits = made_from(*FRICTION_NUMBERS, rule.pooled_hours, length_m, parameters)
    if before is not None and before[1] != limits:
        starts.update(unit.adhesion.starts_with_sums(section, 0, before[0]))
    ends = pool_ends(starts, pooled_ns(rule))
    chosen = ends[-JOBS.most_pooled_spans :]
    first_ns = chosen[0] - pooled_ns(rule) if chosen else 0
    return FrictionInputs(
        section=section,
        length_m=length_m,
        spans=tuple(_span(unit, section, to_ns, rule) for to_ns in chosen),
        made_with=limits,
        seen={key: version for key, version in due.items() if key[1] >= first_ns},
        older_ns=first_ns if len(ends) > len(chosen) else None,
    )


def _span(unit: UnitOfWork, section: str, to_ns: int, rule: LowAdhesionRule) -> Span:
    passes = tuple(unit.adhesion.of_section(section, to_ns - pooled_ns(rule), to_ns))
    vehicles = unit.registry.vehicles_of({window_pass.vehicle for window_pass in passes})
    fleets = sorted({vehicle.fleet for vehicle in vehicles.values()})
    return Span(passes, friction_parameters(rule, unit, passes), tuple(fleets))


def find_friction(inputs: FrictionInputs) -> Outcome[SectionAdhesion]:
    """Return the friction of a section over each of some spans."""
    section, length = inputs.section, inputs.length_m
    parts = [Part(section_adhesion(section, span.passes, span.parameters, length)) for span in inputs.spans]
    return Outcome(parts, again_ns=None if inputs.older_ns is None else 0)


def store_friction(
    unit: UnitOfWork, context: JobContext, made: Mapping[str, tuple[FrictionInputs, Outcome[SectionAdhesion]]]
) -> Mapping[str, int]:
    """Store the friction of sections, their alerts, and what follows for their windows."""
    counts: Counter[str] = Counter()
    for inputs, outcome in made.values():
        for span, part in zip(inputs.spans, outcome.parts, strict=True):
            if part.value is not None:
                counts.update(_store_span(unit, context, span, part.value, inputs.made_with))
        unit.due.remove_seen(FRICTION, inputs.seen)
        if inputs.older_ns is not None:
            unit.adhesion.list_pooled(inputs.section, inputs.older_ns)
    return counts


def _store_span(
    unit: UnitOfWork, context: JobContext, span: Span, friction: SectionAdhesion, made_with: str
) -> Mapping[str, int]:
    section, rule = friction.track_section, context.settings.rules.rule(LowAdhesionRule)
    last, starts = unit.adhesion.section(section), [window_pass.start_ns for window_pass in span.passes]
    before = certain_stretches(unit, section, starts)
    if not unit.adhesion.put_section(friction, context.code_version, made_with):
        return {}
    after = certain_stretches(unit, section, starts)
    again = [p for p in span.passes if touched(p, before[p.start_ns]) != touched(p, after[p.start_ns])]
    records = unit.windows.several([p.key for p in again]) if again else ()
    standing = {r.key for r in records if not r.samples_purged and r.state is not WindowState.PENDING}
    marks = [WindowMark(*p.key, WindowState.PENDING) for p in again if p.key in standing]
    unit.windows.mark_all(marks)
    if last is None or friction.to_ns >= last.to_ns:
        _alert(unit, context, rule, friction, span.fleets)
        unit.adhesion.forget_sums(section, friction.to_ns - WORK.sums_kept_ns)
    return {"sections": 1, "low": bool(friction.low_stretches), "estimated_again": len(marks)}


def _alert(
    unit: UnitOfWork, context: JobContext, rule: LowAdhesionRule, friction: SectionAdhesion, fleets: Sequence[str]
) -> None:
    """Raise, update and clear the alerts of a section, one for each fleet that passed it."""
    now_ns = context.clock.now_ns()
    standing = {alert.fleet: alert for alert in unit.alerts.open_of_section(friction.track_section, rule.kind)}
    for change in section_changes(context.settings.rules, friction, fleets, standing, now_ns):
        ended = change.alert.close_reason is CloseReason.RULE_DISABLED
        note = CloseReason.RULE_DISABLED.sentence if ended else ""
        unit.alerts.save(change.alert, change.events, now_ns, note=note)


FIRST = Stage(
    name="first_geometry",
    job=JOB_NAME,
    kind=SubjectKind.WHEELSET,
    facets=(GEOMETRY.stage,),
    settings=lambda _: None,
    load=lambda unit, serials, _: dict.fromkeys(unit.geometries.having(serials), True),
    compute=lambda _: Outcome(),
    counted=Counted(looked="wheelsets", changed="results"),
    store=list_waiting,
    at_once=500,
)
OF_WINDOWS = Stage(
    name=CREEP,
    job=JOB_NAME,
    kind=SubjectKind.WINDOW,
    facets=(),
    settings=lambda _: None,
    load=load_creep,
    compute=lambda inputs: Outcome([Part(creep_of_window(inputs))]),
    counted=Counted(looked="looks", changed="results", more=("windows", "refused")),
    store=store_creep,
    at_once=WORK.creep_windows,
    frozen=(GEOMETRY.stage,),
)
OF_VEHICLES = Stage(
    name=GEAR_DAMPERS.stage,
    job=JOB_NAME,
    kind=SubjectKind.VEHICLE,
    facets=(CREEP,),
    settings=lambda _: None,
    load=load_dampers,
    compute=judge_dampers,
    counted=Counted(looked="looks", changed="results"),
    numbers=(DAMPERS, DAMPING, SUMS),
    results=GEAR_DAMPERS,
    store=forget_windows,
)
OF_SECTIONS = Stage(
    name=FRICTION,
    job=JOB_NAME,
    kind=SubjectKind.SECTION,
    facets=(CREEP, Facet.REGISTRY),
    settings=lambda settings: (settings.rules.version, settings.rules.rule(LowAdhesionRule)),
    load=load_friction,
    compute=find_friction,
    counted=Counted(looked="looks", changed="results", more=("sections", "low", "estimated_again")),
    numbers=FRICTION_NUMBERS,
    store=store_friction,
    at_once=4,
)


def run(context: JobContext) -> Mapping[str, int]:
    """Look at the creep of new windows, and at the friction of their sections."""
    counts = run_all((FIRST, OF_WINDOWS, OF_VEHICLES, OF_SECTIONS), context)
    if counts["estimated_again"]:
        estimate_windows.run(context)
        refresh_geometry.JOB.run(context)
    return {name: count for name, count in counts.items() if name not in BESIDE}


JOB = Job(
    name=JOB_NAME,
    description="Find creep forces of windows, friction of sections, and raise low adhesion",
    every_s=60.0,
    run=run,
)
