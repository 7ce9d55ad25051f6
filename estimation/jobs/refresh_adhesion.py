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

from estimation.adhesion.friction import section_adhesion
from estimation.adhesion.left_out import touched
from estimation.alerts.life_cycle import close
from estimation.alerts.rules.low_adhesion import LowAdhesionRule, section_finding
from estimation.alerts.section_alerts import section_transition
from estimation.jobs import estimate_windows, refresh_geometry
from estimation.jobs.isolation import Isolation
from estimation.jobs.job import Job, JobContext
from estimation.jobs.steps.pooled_friction import HOUR_NS, friction_parameters, pool_ends, pooled_ns, section_length
from estimation.jobs.steps.section_looks import NO_SECTION, note_sections, section_news
from estimation.jobs.steps.store_dampers import store_dampers
from estimation.jobs.steps.window_creep import CreepOfWindows, creep_of_windows
from estimation.storage import UnitOfWork
from estimation.values.adhesion import SectionAdhesion, WindowAdhesion
from estimation.values.alerts import CloseReason
from estimation.values.runs import SectionLook, SubjectKind
from estimation.values.windows import WindowKey, WindowMark, WindowState

Stretches = Sequence[tuple[float, float]]
STAGE = "refresh_adhesion"
BATCH = 64  # windows committed together
KEPT_NS = 31 * 24 * HOUR_NS  # for which the sums of windows are kept, beyond the longest span that is pooled


def run(context: JobContext) -> Mapping[str, int]:
    """Look at the creep of new windows, and at the friction of their sections; one without news is not looked at."""
    counts: Counter[str] = Counter(dict.fromkeys(("windows", "refused", "sections", "low", "estimated_again"), 0))
    isolation = Isolation(context, STAGE)
    with context.storage.read() as unit:
        news = section_news(unit, context, STAGE)
    failed = {item.key for item in isolation.held(SubjectKind.SECTION)}
    done: dict[str, SectionLook] = {}
    for number, section in enumerate(sorted({*news, *failed} - {NO_SECTION})):
        context.checkpoint(number, len(news))
        if isolation.waits(SubjectKind.SECTION, section):
            continue
        with isolation.alone(SubjectKind.SECTION, section):
            starts = _windows(context, section, counts)
            for to_ns in pool_ends(starts, pooled_ns(context.settings.rules.rule(LowAdhesionRule))):
                counts.update(_section(context, section, to_ns))
            with context.storage.read() as unit:
                seen = not unit.adhesion.unlooked(section)
            if seen and section in news:
                done[section] = news[section]
    if NO_SECTION in news:
        done[NO_SECTION] = news[NO_SECTION]
    note_sections(context, STAGE, done)
    if counts["estimated_again"]:
        estimate_windows.run(context)
        refresh_geometry.JOB.run(context)
    counts["quarantined"] = isolation.quarantined
    return counts


def _windows(context: JobContext, section: str, counts: Counter[str]) -> set[int]:
    """Store the creep of the windows of a section that wait; return when they began."""
    starts: set[int] = set()
    last: WindowKey | None = None
    while True:
        with context.storage.read() as unit:
            keys = unit.adhesion.waiting(section, last, BATCH)
            read = creep_of_windows(unit, keys, context.settings.estimation) if keys else CreepOfWindows((), ())
        if not keys:
            return starts
        last, found = keys[-1], read.creep
        with context.storage.write() as unit:
            now = {one.key: one.content_digest for one in unit.windows.several([one.key for one in found])}
            for one in found:
                if now.get(one.key) == one.content_digest:
                    unit.adhesion.put(one)
            store_dampers(unit, read.dampers, context)
        counts["windows"] += len(found)
        counts["refused"] += sum(one.reason is not None for one in found)
        starts.update(start_ns for _, start_ns in keys)


@dataclass(frozen=True, slots=True)
class _Pooled:
    """The friction of a section, the windows behind it, and what it was before."""

    found: SectionAdhesion
    passes: Sequence[WindowAdhesion]
    fleets: Sequence[str]


def _section(context: JobContext, section: str, to_ns: int) -> Mapping[str, int]:
    """Store the friction of a section, its alerts, and what follows for its windows."""
    rule = context.settings.rules.rule(LowAdhesionRule)
    with context.storage.read() as unit:
        last = unit.adhesion.section(section)
        passes = unit.adhesion.of_section(section, to_ns - pooled_ns(rule), to_ns)
        fleets = sorted({unit.registry.vehicle(code).fleet for code in {one.vehicle for one in passes}})
        length, parameters = section_length(unit, section), friction_parameters(rule, unit, passes)
    found = section_adhesion(section, passes, parameters, length)
    if found is None:
        return {}
    pooled = _Pooled(found, passes, fleets)
    with context.storage.write() as unit:
        before = _certain_stretches(unit, section, passes)
        if not unit.adhesion.put_section(found, context.code_version):
            return {}
        after = _certain_stretches(unit, section, passes)
        again = [one for one in passes if touched(one, before[one.start_ns]) != touched(one, after[one.start_ns])]
        marks = [WindowMark(*one.key, WindowState.PENDING) for one in _estimated(unit, again)]
        unit.windows.mark_all(marks)
        if last is None or found.to_ns >= last.to_ns:
            _alert(unit, context, rule, pooled)
            unit.adhesion.forget_sums(section, found.to_ns - KEPT_NS)
    return {"sections": 1, "low": bool(found.low_stretches), "estimated_again": len(marks)}


def _certain_stretches(unit: UnitOfWork, section: str, passes: Sequence[WindowAdhesion]) -> Mapping[int, Stretches]:
    """Return the stretches of certainly low friction of a section at the times of its passes."""
    found = {start_ns: unit.adhesion.section(section, start_ns) for start_ns in {one.start_ns for one in passes}}
    return {start_ns: () if one is None else one.certain_stretches for start_ns, one in found.items()}


def _estimated(unit: UnitOfWork, passes: Sequence[WindowAdhesion]) -> Sequence[WindowAdhesion]:
    """Return the passes whose windows are not pending, and can be made again."""
    records = {record.key: record for record in unit.windows.several([one.key for one in passes])}
    return [
        one
        for one in passes
        if one.key in records
        and not records[one.key].samples_purged
        and records[one.key].state is not WindowState.PENDING
    ]


def _alert(unit: UnitOfWork, context: JobContext, rule: LowAdhesionRule, pooled: _Pooled) -> None:
    """Raise, update and clear the alerts of a section, one for each fleet that passed it."""
    section, now_ns = pooled.found.track_section, context.clock.now_ns()
    standing = {alert.fleet: alert for alert in unit.alerts.open_of_section(section, rule.kind)}
    finding = section_finding(rule, pooled.found)
    for fleet in sorted({*pooled.fleets, *standing}):
        own = context.settings.rules.of(fleet, None).rule(LowAdhesionRule)
        if not own.enabled:
            if fleet in standing:
                ended = close(standing[fleet], CloseReason.RULE_DISABLED, pooled.found.to_ns)
                unit.alerts.save(ended.alert, ended.events, now_ns, note=CloseReason.RULE_DISABLED.sentence)
            continue
        change = section_transition(
            standing.get(fleet),
            finding,
            now_ns,
            fleet=fleet,
            track_section=section,
            delays=own.delays,
            rules_version=context.settings.rules.version,
        )
        if change is not None:
            unit.alerts.save(change.alert, change.events, now_ns)


JOB = Job(
    name=STAGE,
    description="Find creep forces of windows, friction of sections, and raise low adhesion",
    every_s=60.0,
    run=run,
)
