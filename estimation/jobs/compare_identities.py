"""Stages: does the geometry of a wheelset jump; and has the registry one of them turned, or two exchanged?

Whether it jumps is seen in the intervals that have changed, with some before them. Those that jump are compared with
each other, by all of their geometries.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from estimation.alerts.identity import (
    EVEN,
    IDENTITY_EVENT,
    JUMP,
    IdentityEvent,
    IdentityJump,
    IdentityParameters,
    Observation,
    identity_events,
    jumps,
)
from estimation.alerts.parameters import FINDINGS
from estimation.alerts.rules.rule import latest_run, raised_at
from estimation.alerts.rules.running_gear import SuspensionChangeRule, suspension_change_finding
from estimation.alerts.rules.sensor_data import IdentityRule
from estimation.jobs.job import JobContext
from estimation.jobs.parameters import JOBS
from estimation.jobs.stage import Counted, Outcome, Part, Stage, made_from
from estimation.jobs.steps.assumptions import identity_changes
from estimation.storage import UnitOfWork
from estimation.trend.suspension import RATIO, SuspensionParameters, suspension_histories
from estimation.values.alerts import Finding
from estimation.values.geometry import GEOMETRY, GeometryRecord
from estimation.values.runs import EVERYTHING, Facet, SubjectKind
from estimation.values.trend import (
    SUSPENSION,
    IdentityChange,
    SuspensionChange,
    SuspensionFinding,
    SuspensionShown,
    since_change,
)

CALM, SINCE = "calm", "since"
NUMBERS = (FINDINGS, EVEN)


@dataclass(frozen=True, slots=True)
class JumpInputs:
    """The geometries of a wheelset in which a jump is looked for."""

    # from the first that has changed since it was calm; all of them where they jump
    observations: tuple[Observation, ...]
    calm: int | None  # number of the newest geometry when it did not jump last; None before that
    newest: int | None  # number of the newest geometry
    since: str  # digest of what the comparison begins with: profile, identity, parameters
    parameters: IdentityParameters


def load_jumps(unit: UnitOfWork, serials: Sequence[str], context: JobContext) -> Mapping[str, JumpInputs]:
    """Return in what jumps of some wheelsets are looked for; of those not in service in nothing."""
    parameters = context.settings.rules.rule(IdentityRule).parameters
    wheelsets, changes = unit.registry.wheelsets_of(serials), identity_changes(unit, serials)
    before = {result.subject: result.parameters for result in unit.results.in_force(JUMP, serials)}
    in_service = {record.serial: len(record.reprofilings) for record in wheelsets if record.mounting is not None}
    numbers = unit.geometries.interval_numbers(in_service)
    looks = {}
    for wheelset in wheelsets:
        serial, stored = wheelset.serial, before.get(wheelset.serial, {})
        since = made_from(len(wheelset.reprofilings), changes.get(serial), parameters, NUMBERS, context.code_version)
        calm = stored[CALM] if stored.get(SINCE) == since else None
        assert calm is None or isinstance(calm, int)
        if stored or numbers.get(serial):
            looks[serial] = _Look(in_service.get(serial, 0), numbers.get(serial, {}), calm, since)
    # a wheelset that was not calm before is looked at whole
    whole = {serial: look.baseline for serial, look in looks.items() if look.numbers and look.calm is None}
    unit.geometries.read_intervals({serial: (baseline, None, None) for serial, baseline in whole.items()})
    return {
        serial: JumpInputs(
            tuple(_changed_since(unit, serial, look, changes.get(serial), parameters)),
            look.calm,
            max(look.numbers.values(), default=None),
            look.since,
            parameters,
        )
        for serial, look in looks.items()
    }


@dataclass(frozen=True, slots=True)
class _Look:
    """The present profile of a wheelset: numbers of the newest geometries by interval, and when it was calm last."""

    baseline: int
    numbers: Mapping[int, int]
    calm: int | None
    since: str


def _changed_since(
    unit: UnitOfWork, serial: str, look: _Look, change: IdentityChange | None, parameters: IdentityParameters
) -> list[Observation]:
    """Return the observations from the first that has changed on, with those before it that it is compared with."""
    calm = look.calm
    if calm is None:
        return _observations(unit.geometries.intervals(serial, look.baseline), change) if look.numbers else []
    changed = min((interval for interval, number in look.numbers.items() if number > calm), default=None)
    if changed is None:
        return []
    earlier = sorted(interval for interval in look.numbers if interval < changed)
    for back in JOBS.intervals_read:
        first = earlier[-back] if len(earlier) > back else None
        read = unit.geometries.intervals(serial, look.baseline, first=first)
        before = [record for record in read if record.interval in earlier]
        usable = [record for record in before if record.geometry.windows >= parameters.least_windows]
        if first is None or len(usable) >= JOBS.intervals_before_change:
            observations = _observations(read, change)
            if first is None or not jumps(observations, parameters):
                return observations
            break
    return _observations(unit.geometries.intervals(serial, look.baseline), change)


def _observations(records: Sequence[GeometryRecord], change: IdentityChange | None) -> list[Observation]:
    observations = [_observation(record) for record in since_change(records, change) if record.geometry.windows]
    return sorted(observations, key=lambda item: item.from_ns)


def _observation(record: GeometryRecord) -> Observation:
    return Observation(record.wheelset, record.from_ns, record.to_ns, record.mileage_km, record.geometry)


def look_for_jump(inputs: JumpInputs) -> Outcome[IdentityJump]:
    """Return whether a wheelset must be compared with the others; one that is calm is looked at from here on next."""
    jump = None
    if jumps(inputs.observations, inputs.parameters):
        jump = IdentityJump(made_from(inputs.observations, inputs.since))
    calm = inputs.newest if jump is None else inputs.calm
    return Outcome([Part(jump, parameters={CALM: calm, SINCE: inputs.since})])


@dataclass(frozen=True, slots=True)
class IdentityInputs:
    """The geometries of all wheelsets that jump, by serial, and those of which something was found before."""

    histories: Mapping[str, Sequence[Observation]]
    found_before: frozenset[str]
    parameters: IdentityParameters


def load_identities(unit: UnitOfWork, _: Sequence[str], context: JobContext) -> Mapping[str, IdentityInputs]:
    """Return what wheelsets that jump are compared by."""
    serials = [result.subject for result in unit.results.in_force(JUMP) if result.value is not None]
    changes = identity_changes(unit, serials) if serials else {}
    histories = {
        wheelset.serial: _observations(
            unit.geometries.intervals(wheelset.serial, len(wheelset.reprofilings)), changes.get(wheelset.serial)
        )
        for wheelset in (unit.registry.wheelsets_of(serials) if serials else ())
    }
    before = frozenset(result.subject for result in unit.results.in_force(IDENTITY_EVENT) if result.value is not None)
    return {EVERYTHING: IdentityInputs(histories, before, context.settings.rules.rule(IdentityRule).parameters)}


def compare(inputs: IdentityInputs) -> Outcome[IdentityEvent]:
    """Return the identity change that each wheelset shows, and of whom none is shown any more."""
    events = identity_events(inputs.histories, inputs.parameters)
    shown: dict[str, IdentityEvent | None] = {**dict.fromkeys(inputs.found_before), **events}
    return Outcome([Part(event, subject=serial) for serial, event in sorted(shown.items())])


JUMPS = Stage(
    name=JUMP.stage,
    job="evaluate_alerts",
    kind=SubjectKind.WHEELSET,
    facets=(Facet.REGISTRY, Facet.RESTARTS, GEOMETRY.stage),
    settings=lambda settings: settings.rules.rule(IdentityRule).parameters,
    load=load_jumps,
    compute=look_for_jump,
    counted=Counted(looked="looked_at", changed="changed"),
    numbers=NUMBERS,
    results=JUMP,
    here=True,
)
IDENTITIES = Stage(
    name=IDENTITY_EVENT.stage,
    job="evaluate_alerts",
    kind=SubjectKind.WHEELSET,
    facets=(JUMP.stage,),
    settings=lambda settings: settings.rules.rule(IdentityRule).parameters,
    load=load_identities,
    compute=compare,
    counted=Counted(looked="looked_at", changed="changed"),
    numbers=NUMBERS,
    results=IDENTITY_EVENT,
    together=True,
    # a jump names the geometries that it is in; those of the calm say nothing
    frozen=(Facet.REGISTRY, Facet.RESTARTS, GEOMETRY.stage),
    here=True,
)


@dataclass(frozen=True, slots=True)
class SuspensionInputs:
    """The newest findings of all vehicles, and by vehicle the rule of its fleet and class."""

    findings: tuple[SuspensionFinding, ...]
    rules: Mapping[str, SuspensionChangeRule]
    parameters: SuspensionParameters  # what counts as now and what friction may do, the same for all


def load(unit: UnitOfWork, _: Sequence[str], context: JobContext) -> Mapping[str, SuspensionInputs]:
    """Return what is known of all vehicles."""
    book = context.settings.rules
    parameters = book.rule(SuspensionChangeRule).parameters
    rules = {
        vehicle.code: book.of(vehicle.fleet, vehicle.vehicle_class).rule(SuspensionChangeRule)
        for vehicle in unit.registry.vehicles()
    }
    findings = tuple(unit.suspensions.newest(parameters.recent + parameters.most_past))
    return {EVERYTHING: SuspensionInputs(findings, rules, parameters)}


def compute(inputs: SuspensionInputs) -> Outcome[SuspensionShown]:
    """Return what is shown of every vehicle on file."""
    histories = suspension_histories(inputs.findings, inputs.parameters)
    shown = {code: _shown(rule, code, histories.get(code, iter(()))) for code, rule in inputs.rules.items()}
    # findings of others on its sections count as far as they change what is shown
    return Outcome([Part(change, subject=code, made_from=made_from(change)) for code, change in shown.items()])


def _shown(rule: SuspensionChangeRule, vehicle: str, history: Iterator[SuspensionChange]) -> SuspensionShown:
    read: list[SuspensionChange] = []

    def newest_first() -> Iterator[Finding]:
        for change in history:
            read.append(change)
            yield suspension_change_finding(rule, vehicle, change)

    if not latest_run(newest_first(), rule.delays):
        return SuspensionShown(read[0] if read else None, stands=False)
    read += history
    findings = (suspension_change_finding(rule, vehicle, change) for change in reversed(read))
    return SuspensionShown(read[0], stands=True, since_ns=raised_at(findings, rule.delays))


SUSPENSIONS = Stage(
    name=SUSPENSION.stage,
    job="evaluate_alerts",
    kind=SUSPENSION.subject,
    facets=(Facet.REGISTRY, Facet.STIFFNESS),
    settings=lambda settings: settings.rules.version,
    load=load,
    compute=compute,
    counted=Counted(looked="looked_at", changed="changed"),
    numbers=(RATIO,),
    results=SUSPENSION,
    together=True,
    here=True,
)
