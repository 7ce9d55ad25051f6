"""Stages: the alert rules are evaluated of every wheelset, and its row of the worklist is made; and the job of both.

Each wheelset is evaluated by itself, beside what comparisons with the others have found.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from estimation.accuracy.parameters import ACCURACY
from estimation.alerts.identity import IDENTITY_EVENT
from estimation.alerts.life_cycle import close, transition, without_stale_acknowledgement
from estimation.alerts.parameters import FINDINGS
from estimation.alerts.rule_book import RuleBook, findings, in_flood, next_change_ns, opened, refreshed, superseded
from estimation.alerts.rules.rule import WheelsetFacts
from estimation.jobs.compare_identities import IDENTITIES, JUMPS, SUSPENSIONS
from estimation.jobs.job import Job, JobContext
from estimation.jobs.parameters import JOBS
from estimation.jobs.runner import run_all
from estimation.jobs.stage import AnyStage, Counted, Outcome, Part, Stage
from estimation.jobs.steps.wheelset_facts import facts_of
from estimation.jobs.work import Isolation
from estimation.storage import UnitOfWork
from estimation.trend.now import SCALE
from estimation.trend.parameters import CURVES
from estimation.values.alerts import Alert, AlertEventKind, AlertScope, CloseReason, Condition, Finding, Transition
from estimation.values.geometry import GEOMETRY
from estimation.values.runs import Facet, SubjectKind
from estimation.values.trend import TREND
from estimation.values.windows import SUSTAINED
from estimation.worklist.stored import FACETS, FORM, STAGE


def make_all(unit: UnitOfWork, _: JobContext, __: Mapping[str, tuple[None, Outcome[None]]]) -> Mapping[str, int]:
    """Let all rows be made again at the end of the transaction."""
    unit.worklist.refresh_all()
    return {}


WORKLIST: AnyStage = Stage(
    name=STAGE,
    job="evaluate_alerts",
    kind=SubjectKind.WHEELSET,
    facets=FACETS,
    settings=lambda _: FORM,
    load=lambda _, subjects, __: dict.fromkeys(subjects),
    compute=lambda _: Outcome(),
    counted=Counted(looked="looked_at", changed="changed"),
    store=make_all,
    together=True,
    inline=True,
)


def raise_in_fleet(
    unit: UnitOfWork, fleet: str, raised: Sequence[Transition], book: RuleBook, now_ns: int
) -> list[AlertEventKind]:
    """Store the alerts that a run has found, and bring the fleet alerts up to their members."""
    version, book = book.version, book.of(fleet, None)
    stored = unit.alerts.open_in_fleet(fleet)
    of_fleet = {alert.kind: alert for alert in stored if alert.scope is AlertScope.FLEET}
    alone = [
        alert
        for alert in stored
        if alert.wheelset is not None and alert.fleet_alert_id is None and alert.condition is not Condition.PENDING
    ]
    joining = _joining(unit, of_fleet, [*alone, *(change.alert for change in raised)], book)
    fleet_alerts = dict(of_fleet)
    for kind, members in joining.items():
        if kind not in fleet_alerts:
            new = replace(opened(fleet, kind, members, book), rules_version=version)
            fleet_alerts[kind] = unit.alerts.save(new, (), now_ns)
    joined = {(alert.wheelset, kind) for kind, members in joining.items() for alert in members}
    announced = [alert for alert in alone if (alert.wheelset, alert.kind) in joined]
    events: list[AlertEventKind] = []
    for change in [*(Transition(alert, (AlertEventKind.UPDATED,)) for alert in announced), *raised]:
        alert = change.alert
        if (alert.wheelset, alert.kind) in joined:
            alert = replace(alert, fleet_alert_id=fleet_alerts[alert.kind].alert_id)
        unit.alerts.save(alert, change.events, now_ns)
        events += change.events
    for kind, fleet_alert in fleet_alerts.items():
        events += _refresh(unit, fleet_alert, now_ns, new=kind not in of_fleet)
    return events


def _joining(
    unit: UnitOfWork, of_fleet: Mapping[str, Alert], single: Sequence[Alert], book: RuleBook
) -> dict[str, list[Alert]]:
    """Return by kind which ``single`` alerts become members; those of an open fleet alert (by kind) count as well."""
    joining = {}
    for kind in (rule.kind for rule in book.rules):
        fleet_alert = of_fleet.get(kind)
        members = [] if fleet_alert is None else unit.alerts.members(fleet_alert.alert_id)
        free = [alert for alert in single if alert.kind == kind]
        flooding = in_flood([alert.opened_ns for alert in (*free, *members)], book.alarm_flood)
        if any(flooding[: len(free)]):
            joining[kind] = [alert for alert, joins in zip(free, flooding, strict=False) if joins]
    return joining


def _refresh(unit: UnitOfWork, fleet_alert: Alert, now_ns: int, *, new: bool) -> Sequence[AlertEventKind]:
    change = refreshed(fleet_alert, unit.alerts.members(fleet_alert.alert_id), now_ns)
    if change is None:
        return ()
    events = (AlertEventKind.RAISED,) if new else change.events
    unit.alerts.save(change.alert, events, now_ns)
    return events


BEFORE: tuple[AnyStage, ...] = (WORKLIST, JUMPS, IDENTITIES, SUSPENSIONS)
CHANGED, AT_REST = "changed", "at_rest"
BESIDE = {CHANGED, AT_REST, "looked_at"}  # counts of stages that are no counts of the job


@dataclass(frozen=True, slots=True)
class AlertInputs:
    """What the alerts of a wheelset are made from."""

    facts: WheelsetFacts
    book: RuleBook = field(metadata={"made_from": False})  # rules of its fleet and class
    version: str = field(metadata={"made_from": False})  # of the rules of all fleets and classes
    now_ns: int = field(metadata={"made_from": False})  # our time; the stage looks again when it may say something else


@dataclass(frozen=True, slots=True)
class Evaluated:
    """What follows for the alerts of a wheelset: those that a dated record has ended, and what is found."""

    ended: Sequence[tuple[Alert, CloseReason, int]]
    changes: Sequence[Transition]


@dataclass(slots=True)
class _Raises:
    """What is to be raised of each wheelset, and the fleets in which something was evaluated."""

    by_wheelset: dict[str, Sequence[Transition]] = field(default_factory=dict)
    fleets: set[str] = field(default_factory=set)

    def in_fleet(self, fleet: str) -> list[Transition]:
        """Return what is to be raised in a fleet, in the order of the serials."""
        changes = (change for _, changes in sorted(self.by_wheelset.items()) for change in changes)
        return [change for change in changes if change.alert.fleet == fleet]


def load(unit: UnitOfWork, serials: Sequence[str], context: JobContext) -> Mapping[str, AlertInputs]:
    """Return what the alerts of some wheelsets are made from."""
    rules, now_ns = context.settings.rules, context.clock.now_ns()
    return {
        serial: AlertInputs(
            facts=facts,
            book=rules.of(facts.wheelset.fleet, None if facts.vehicle is None else facts.vehicle.vehicle_class),
            version=rules.version,
            now_ns=now_ns,
        )
        for serial, facts in facts_of(unit, serials, context.settings).items()
    }


def compute(inputs: AlertInputs) -> Outcome[Evaluated]:
    """Return what changes on the open alerts of a wheelset, and what is to be raised.

    Where the same inputs again would change more, the next run evaluates them again.
    """
    facts, book, now_ns = inputs.facts, inputs.book, inputs.now_ns
    ended = superseded(facts, book)
    gone = {alert.alert_id for alert, _, _ in ended}
    standing = replace(facts, open_alerts=[alert for alert in facts.open_alerts if alert.alert_id not in gone])
    changes = _transitions(standing, findings(facts, book, now_ns), book, inputs.version, now_ns)
    at_rest = (
        not ended
        and not any(AlertEventKind.RAISED in change.events for change in changes)
        # until the fleet alert has followed, which is another transaction
        and all(change.alert.fleet_alert_id is None for change in changes)
        and _rests(standing, changes, book, inputs.version, now_ns)
    )
    again_ns = next_change_ns(facts, book, now_ns) if at_rest else now_ns
    return Outcome([Part(Evaluated(ended, changes))], again_ns=again_ns)


def _transitions(
    facts: WheelsetFacts, now_found: Sequence[Finding], book: RuleBook, version: str, now_ns: int
) -> list[Transition]:
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
        for finding in now_found
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


def store(
    unit: UnitOfWork,
    _: JobContext,
    evaluated: Mapping[str, tuple[AlertInputs, Outcome[Evaluated]]],
    *,
    raises: _Raises,
) -> Mapping[str, int]:
    """Store what changes on open alerts; what is to be raised waits for the others of its fleet."""
    events: Counter[str] = Counter()
    waiting: dict[str, Sequence[Transition]] = dict.fromkeys(evaluated, ())
    raises.by_wheelset |= waiting
    for serial, (inputs, outcome) in evaluated.items():
        for part in outcome.parts:
            assert part.value is not None
            ended = [(close(alert, reason, at_ns), reason.sentence) for alert, reason, at_ns in part.value.ended]
            raised = [change for change in part.value.changes if AlertEventKind.RAISED in change.events]
            others = [(change, "") for change in part.value.changes if change not in raised]
            for change, note in [*ended, *others]:
                unit.alerts.save(change.alert, change.events, inputs.now_ns, note=note)
                events.update(kind.value for kind in change.events)
            waiting[serial] = raised
    raises.by_wheelset |= waiting
    raises.fleets |= {inputs.facts.wheelset.fleet for inputs, _ in evaluated.values()}
    return events


def run(context: JobContext) -> Mapping[str, int]:
    """Evaluate alerts; the same data again change nothing, and are not even read.

    What is to be raised waits for the others of its fleet, since too many of a kind are raised as one; each fleet is
    then one transaction. A run that ends early raises what it has found; what it has not stored the next run finds
    again.
    """
    raises, isolation, counts = _Raises(), Isolation(context, ALERTS.job), Counter[str]()
    alerts = replace(ALERTS, store=partial(store, raises=raises))
    try:
        counts.update(run_all((*BEFORE, alerts), context, isolation))
    finally:
        counts.update(_raise_in_fleets(context, isolation, raises))
    return {name: count for name, count in counts.items() if name not in BESIDE}


def _raise_in_fleets(context: JobContext, isolation: Isolation, raises: _Raises) -> Mapping[str, int]:
    """Raise what was found in each fleet, and bring fleet alerts up to their members; return the events counted."""
    now_ns, counts, before = context.clock.now_ns(), Counter[str](), isolation.quarantined
    with context.storage.read() as unit:
        alerts = unit.alerts.open_of_fleets()
        run_out = {alert.fleet for alert in alerts if without_stale_acknowledgement(alert, now_ns) != alert}
        fleets = sorted(raises.fleets | run_out)
        if fleets:
            isolation.read(unit)
    for fleet in fleets:
        with isolation.alone(SubjectKind.FLEET, fleet):
            with context.storage.write() as unit:
                events = raise_in_fleet(unit, fleet, raises.in_fleet(fleet), context.settings.rules, now_ns)
            counts.update(kind.value for kind in events)
    counts["quarantined"] = isolation.quarantined - before
    return counts


ALERTS = Stage(
    name="alerts",
    job="evaluate_alerts",
    kind=SubjectKind.WHEELSET,
    facets=(
        *(Facet.REGISTRY, Facet.WINDOWS, Facet.ALERTS, Facet.RESTARTS, GEOMETRY.stage, Facet.BESIDE),
        *(TREND.stage, IDENTITY_EVENT.stage),
    ),
    settings=lambda settings: (settings.trend, settings.rules.version),
    load=load,
    compute=compute,
    counted=Counted(
        looked="wheelsets", changed=CHANGED, same=AT_REST, more=tuple(kind.value for kind in AlertEventKind)
    ),
    numbers=(FINDINGS, CURVES, SCALE, SUSTAINED, ACCURACY, JOBS.design_amplitudes),
    store=partial(store, raises=_Raises()),
    here=True,  # where what is to be raised is brought together
)
JOB = Job(
    name=ALERTS.job,
    description="Evaluate the alert rules and record what they raise, update, clear and close",
    every_s=300.0,
    run=run,
)
