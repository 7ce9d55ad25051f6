"""Job: evaluate the alert rules of every wheelset and record what changes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

from estimation.alerts.identity import IdentityEvent
from estimation.alerts.life_cycle import close, transition
from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.evaluation import findings, superseded
from estimation.alerts.rules.identity import IdentityRule
from estimation.alerts.rules.rule import WheelsetFacts
from estimation.alerts.rules.sensor_fault import SensorFaultRule
from estimation.jobs.job import Job, JobContext
from estimation.jobs.steps.identities import new_events
from estimation.jobs.steps.raise_alerts import raise_in_fleet
from estimation.storage import UnitOfWork
from estimation.values.alerts import Alert, AlertEventKind, Transition
from estimation.values.registry import WheelsetRecord
from estimation.values.windows import WindowRecord

FIRST_LOOK_NS = 3_600_000_000_000


def run(context: JobContext) -> Mapping[str, int]:
    """Evaluate alerts; the same data again change nothing.

    Each wheelset is one transaction, in which its alerts are updated, cleared and closed. What is to be raised waits
    for the others of its fleet, since too many of a kind are raised as one; each fleet is then one transaction. A run
    that ends early raises what it has found; what it has not stored the next run finds again.
    """
    with context.storage.read() as unit:
        wheelsets = unit.registry.wheelsets()
        serials = [wheelset.serial for wheelset in wheelsets]
        identities = new_events(unit, wheelsets, context.settings.rules.rule(IdentityRule).parameters)
        fleets = [fleet.code for fleet in unit.registry.fleets()]
    counts: Counter[str] = Counter(dict.fromkeys(("wheelsets", *(kind.value for kind in AlertEventKind)), 0))
    found: list[Transition] = []
    try:
        for done, serial in enumerate(serials):
            context.checkpoint(done, len(serials))
            with context.storage.write() as unit:
                events, to_raise = _evaluate(unit, serial, context, identities.get(serial))
            counts.update(kind.value for kind in events)
            found += to_raise
            counts["wheelsets"] += 1
    finally:
        for fleet in fleets:
            of_fleet = [change for change in found if change.alert.fleet == fleet]
            with context.storage.write() as unit:
                events = raise_in_fleet(unit, fleet, of_fleet, context.settings.rules, context.clock.now_ns())
            counts.update(kind.value for kind in events)
    return dict(counts)


def _evaluate(
    unit: UnitOfWork, serial: str, context: JobContext, identity: IdentityEvent | None
) -> tuple[list[AlertEventKind], list[Transition]]:
    """Store what changes on the open alerts of a wheelset; return the events of that, and what is to be raised."""
    book, now_ns = context.settings.rules, context.clock.now_ns()
    facts = replace(_facts(unit, unit.registry.wheelset(serial), book), identity=identity)
    events: list[AlertEventKind] = []
    to_raise: list[Transition] = []
    ended = superseded(facts, book)
    for alert, reason, at_ns in ended:
        events += _save(unit, close(alert, reason, at_ns), now_ns, reason.sentence)
    gone = {alert.alert_id for alert, _, _ in ended}
    still_open = {alert.kind: alert for alert in facts.open_alerts if alert.alert_id not in gone}
    for finding in findings(facts, book, now_ns):
        change = transition(
            still_open.get(finding.kind),
            finding,
            now_ns,
            fleet=facts.wheelset.fleet,
            delays=book.delays_of(finding.kind),
        )
        if change is None:
            continue
        if AlertEventKind.RAISED in change.events:
            to_raise.append(change)
        else:
            events += _save(unit, change, now_ns, "")
    return events, to_raise


def _save(unit: UnitOfWork, change: Transition, now_ns: int, note: str) -> Sequence[AlertEventKind]:
    unit.alerts.save(change.alert, change.events, now_ns, note=note)
    return change.events


def _facts(unit: UnitOfWork, wheelset: WheelsetRecord, book: RuleBook) -> WheelsetFacts:
    mounting = wheelset.mounting
    alerts: Sequence[Alert] = unit.alerts.all_open(wheelset.serial)
    if mounting is None:
        return WheelsetFacts(wheelset, None, None, None, (), alerts)
    return WheelsetFacts(
        wheelset=wheelset,
        vehicle=unit.registry.vehicle(mounting.vehicle),
        geometry=unit.geometries.current(wheelset.serial),
        trend=unit.trends.latest(wheelset.serial),
        windows=_latest_windows(unit, wheelset.serial, mounting.from_ns, book.rule(SensorFaultRule).latest_windows),
        open_alerts=alerts,
    )


def _latest_windows(unit: UnitOfWork, serial: str, since_ns: int, wanted: int) -> Sequence[WindowRecord]:
    """Return at least the latest ``wanted`` windows since a time, looking back further until there are as many."""
    newest = unit.windows.latest(serial)
    if newest is None or newest.start_ns < since_ns:
        return ()
    look_back = FIRST_LOOK_NS
    while True:
        from_ns = max(since_ns, newest.start_ns - look_back)
        found = unit.windows.list(serial, from_ns)
        if len(found) >= wanted or from_ns == since_ns:
            return found[-wanted:]
        look_back *= 8


JOB = Job(
    name="evaluate_alerts",
    description="Evaluate the alert rules and record what they raise, update, clear and close",
    every_s=60.0,
    run=run,
)
