"""Job: evaluate the alert rules of every wheelset and record what changes."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from estimation.alerts.identity import IdentityEvent, IdentityParameters
from estimation.alerts.life_cycle import close, transition, without_stale_acknowledgement
from estimation.alerts.next_change import next_change_ns
from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.evaluation import findings, superseded
from estimation.alerts.rules.identity import IdentityRule
from estimation.alerts.rules.rule import WheelsetFacts
from estimation.jobs.isolation import Isolation, inputs_of
from estimation.jobs.job import Job, JobContext
from estimation.jobs.steps import identities
from estimation.jobs.steps.fleet_alerts import raise_in_fleet
from estimation.jobs.steps.identities import new_events
from estimation.jobs.steps.roster import Roster, roster
from estimation.jobs.steps.suspension import shown_by_wheelset
from estimation.jobs.steps.wheelset_facts import facts_of
from estimation.storage import UnitOfWork
from estimation.values.alerts import AlertEventKind, Finding, Transition
from estimation.values.runs import Look, SubjectKind
from estimation.values.trend import SuspensionShown

STAGE = "evaluate_alerts"


def run(context: JobContext) -> Mapping[str, int]:
    """Evaluate alerts; the same data again change nothing, and are not even read.

    Each wheelset is one transaction, in which its alerts are updated, cleared and closed. What is to be raised waits
    for the others of its fleet, since too many of a kind are raised as one; each fleet is then one transaction. A run
    that ends early raises what it has found; what it has not stored the next run finds again. Rows of the worklist of
    another form, or empty, are made again on the way.
    """
    isolation = Isolation(context, STAGE)
    with context.storage.read() as unit:
        of_before, on_file = frozenset(unit.worklist.outdated()), roster(unit)
    compared = _compared(context, on_file, isolation)
    counts: Counter[str] = Counter(dict.fromkeys(("wheelsets", *(kind.value for kind in AlertEventKind)), 0))
    found: list[Transition] = []
    always = of_before | {item.key for item in isolation.held(SubjectKind.WHEELSET)}
    asked = _asked(context, on_file, compared, always)
    counts["wheelsets"] += len(asked.inputs) - len(asked.due)
    try:
        for done, serial in enumerate(asked.due):
            context.checkpoint(done, len(asked.due))
            inputs = inputs_of(context, serial)
            if isolation.waits(SubjectKind.WHEELSET, serial, inputs):
                continue
            with isolation.alone(SubjectKind.WHEELSET, serial, inputs):
                with context.storage.write() as unit:
                    evaluated = _evaluate(unit, serial, context, compared.of(serial), asked.version)
                    unit.worklist.renew([serial] if serial in of_before else [])
                    if evaluated.at_rest:
                        seen = asked.digest(serial, unit.looks.touched_of(serial))
                        unit.looks.note(STAGE, serial, Look(seen, evaluated.until_ns))
                counts.update(kind.value for kind in evaluated.events)
                found += evaluated.to_raise
                counts["wheelsets"] += 1
    finally:
        for fleet in _to_raise_in(context, on_file, asked.due):
            with isolation.alone(SubjectKind.FLEET, fleet):
                of_fleet = [change for change in found if change.alert.fleet == fleet]
                with context.storage.write() as unit:
                    events = raise_in_fleet(unit, fleet, of_fleet, context.settings.rules, context.clock.now_ns())
                counts.update(kind.value for kind in events)
    counts["quarantined"] = isolation.quarantined
    return counts


def _to_raise_in(context: JobContext, on_file: Roster, evaluated: Sequence[str]) -> list[str]:
    """Return the fleets in which something may be raised, or one of whose alerts is another by now."""
    fleet_of, now_ns = {wheelset.serial: wheelset.fleet for wheelset in on_file.wheelsets}, context.clock.now_ns()
    with context.storage.read() as unit:
        alerts = unit.alerts.open_of_fleets()
    run_out = {alert.fleet for alert in alerts if without_stale_acknowledgement(alert, now_ns) != alert}
    return sorted({fleet_of[serial] for serial in evaluated} | run_out)


@dataclass(frozen=True, slots=True)
class _Asked:
    """The wheelsets, and those of which something has changed, or time may change something, with their inputs."""

    due: Sequence[str]
    version: str  # of the rules
    common: tuple[str, ...]  # of all wheelsets
    inputs: Mapping[str, str]  # of each wheelset, but for what has happened to it

    def digest(self, serial: str, touched: int | None) -> str:
        """Return the digest of all that an evaluation is made from."""
        return hashlib.sha256(repr((self.common, touched, self.inputs[serial])).encode()).hexdigest()


def _asked(context: JobContext, on_file: Roster, compared: _Compared, always: frozenset[str]) -> _Asked:
    """Return which wheelsets to evaluate: some statements for all, not some for each."""
    rules, now_ns = context.settings.rules, context.clock.now_ns()
    common = (rules.version, repr(context.settings.trend), context.code_version)
    with context.storage.read() as unit:
        looks, touched = unit.looks.of(STAGE), unit.looks.touched()
    inputs = {one.serial: repr((one, on_file.vehicle_of(one), compared.of(one.serial))) for one in on_file.wheelsets}
    asked = _Asked((), rules.version, common, inputs)

    def due(serial: str) -> bool:
        look = looks.get(serial)
        return look is None or serial in always or not look.holds(asked.digest(serial, touched.get(serial)), now_ns)

    return replace(asked, due=[serial for serial in inputs if due(serial)])


@dataclass(frozen=True, slots=True)
class _Found:
    """What was found of a wheelset beside the others of its fleet."""

    identity: IdentityEvent | None
    suspension: SuspensionShown | None
    rejected: Mapping[str, int]  # recordings of its vehicle, by reason code


@dataclass(slots=True)
class _Compared:
    """What was found of the wheelsets beside the others of their fleets."""

    identities: Mapping[str, IdentityEvent] = field(default_factory=dict)
    suspensions: Mapping[str, SuspensionShown] = field(default_factory=dict)
    rejected: Mapping[str, Mapping[str, int]] = field(default_factory=dict)

    def of(self, serial: str) -> _Found:
        """Return what was found of one wheelset."""
        return _Found(self.identities.get(serial), self.suspensions.get(serial), self.rejected.get(serial, {}))


def _compared(context: JobContext, on_file: Roster, isolation: Isolation) -> _Compared:
    """Compare the wheelsets of all fleets; where that fails their other alerts are evaluated without it."""
    rules, compared = context.settings.rules, _Compared()
    with isolation.alone(SubjectKind.FLEET, "comparison of identities"):
        compared.identities = _identities(context, on_file, rules.rule(IdentityRule).parameters)
    with isolation.alone(SubjectKind.FLEET, "comparison of suspensions"), context.storage.read() as unit:
        compared.suspensions = shown_by_wheelset(unit, on_file, rules)
    with isolation.alone(SubjectKind.FLEET, "rejected recordings"), context.storage.read() as unit:
        compared.rejected = on_file.at_first_axles(unit.plausibility.rejected())
    return compared


def _identities(context: JobContext, on_file: Roster, parameters: IdentityParameters) -> Mapping[str, IdentityEvent]:
    with context.storage.read() as unit:
        found = new_events(unit, on_file.wheelsets, parameters, context.code_version)
    if found.calm:
        with context.storage.write() as unit:
            for serial, look in found.calm.items():
                unit.looks.note(identities.STAGE, serial, look)
    return found.events


@dataclass(slots=True)
class _Evaluated:
    """What the evaluation of a wheelset recorded and is to raise.

    ``at_rest`` is whether the same again would change nothing, until ``until_ns`` of our time.
    """

    events: list[AlertEventKind] = field(default_factory=list)
    to_raise: list[Transition] = field(default_factory=list)
    at_rest: bool = True
    until_ns: int | None = None


def _evaluate(unit: UnitOfWork, serial: str, context: JobContext, found: _Found, version: str) -> _Evaluated:
    """Store what changes on the open alerts of a wheelset; return the events of that, and what is to be raised."""
    wheelset, now_ns = unit.registry.wheelset(serial), context.clock.now_ns()
    mounting = wheelset.mounting
    vehicle = None if mounting is None else unit.registry.vehicle(mounting.vehicle)
    book = context.settings.rules.of(wheelset.fleet, None if vehicle is None else vehicle.vehicle_class)
    stored = facts_of(unit, wheelset, vehicle, book, context.settings)
    facts = replace(stored, identity=found.identity, suspension=found.suspension, rejected_recordings=found.rejected)
    done = _Evaluated(until_ns=next_change_ns(facts, book, now_ns))
    ended = superseded(facts, book)
    for alert, reason, at_ns in ended:
        done.events += _save(unit, close(alert, reason, at_ns), now_ns, reason.sentence)
    gone = {alert.alert_id for alert, _, _ in ended}
    standing = replace(facts, open_alerts=[alert for alert in facts.open_alerts if alert.alert_id not in gone])
    changes = _transitions(standing, findings(facts, book, now_ns), book, version, now_ns)
    for change in changes:
        if AlertEventKind.RAISED in change.events:
            done.to_raise.append(change)
        else:
            done.events += _save(unit, change, now_ns, "")
    done.at_rest = not ended and not done.to_raise and _rests(standing, changes, book, version, now_ns)
    if any(change.alert.fleet_alert_id is not None for change in changes):
        done.at_rest = False  # until the fleet alert has followed, which is another transaction
    return done


def _transitions(
    facts: WheelsetFacts, found: Sequence[Finding], book: RuleBook, version: str, now_ns: int
) -> list[Transition]:
    """Return what findings change on the open alerts of a wheelset."""
    still_open = {alert.kind: alert for alert in facts.open_alerts}
    changes = [
        transition(
            still_open.get(finding.kind),
            finding,
            now_ns,
            fleet=facts.wheelset.fleet,
            delays=book.delays_of(finding.kind),
            rules_version=version,
        )
        for finding in found
    ]
    return [change for change in changes if change is not None]


def _rests(facts: WheelsetFacts, changes: Sequence[Transition], book: RuleBook, version: str, now_ns: int) -> bool:
    """Whether an evaluation of what the changes have made would change nothing more."""
    if not changes:
        return True
    now = {change.alert.kind: change.alert for change in changes}
    after = replace(facts, open_alerts=[now.get(alert.kind, alert) for alert in facts.open_alerts])
    if any(alert.closed_ns is not None for alert in after.open_alerts):
        return False
    return not _transitions(after, findings(after, book, now_ns), book, version, now_ns)


def _save(unit: UnitOfWork, change: Transition, now_ns: int, note: str) -> Sequence[AlertEventKind]:
    unit.alerts.save(change.alert, change.events, now_ns, note=note)
    return change.events


JOB = Job(
    name=STAGE,
    description="Evaluate the alert rules and record what they raise, update, clear and close",
    every_s=300.0,
    run=run,
)
