"""Job: evaluate the alert rules of every wheelset and record what changes."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from estimation.alerts.fleet_alerts import in_flood, opened, refreshed
from estimation.alerts.identity import IdentityEvent, IdentityParameters
from estimation.alerts.life_cycle import close, transition
from estimation.alerts.next_change import next_change_ns
from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.data_quality import DataQualityRule
from estimation.alerts.rules.evaluation import findings, superseded
from estimation.alerts.rules.hunting import HuntingRule
from estimation.alerts.rules.identity import IdentityRule
from estimation.alerts.rules.rule import WheelsetFacts
from estimation.alerts.rules.sensor_fault import SensorFaultRule
from estimation.alerts.rules.standing import LOOK_BACK, reach_km, within_reach
from estimation.jobs.isolation import Isolation, inputs_of
from estimation.jobs.job import Job, JobContext
from estimation.jobs.settings import JobSettings
from estimation.jobs.steps import identities
from estimation.jobs.steps.first_axles import at_first_axles
from estimation.jobs.steps.identities import identity_change, new_events
from estimation.jobs.steps.suspension import shown_by_wheelset
from estimation.storage import UnitOfWork
from estimation.values.alerts import Alert, AlertEventKind, Condition, Transition
from estimation.values.geometry import GeometryRecord
from estimation.values.identity import since_change
from estimation.values.look import Look
from estimation.values.quarantine import SubjectKind
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.suspension import SuspensionShown
from estimation.values.windows import WindowRecord


@dataclass(frozen=True, slots=True)
class _Standing:
    """The open alerts of a fleet before anything is raised."""

    of_fleet: dict[str, Alert]
    alone: Sequence[Alert]  # raised, and no members


def raise_in_fleet(
    unit: UnitOfWork, fleet: str, found: Sequence[Transition], book: RuleBook, now_ns: int
) -> list[AlertEventKind]:
    """Store the alerts that a run has found, and bring the fleet alerts up to their members.

    Parameters
    ----------
    unit
        A transaction that writes; all of this belongs in one.
    fleet
        Code of the fleet.
    found
        What raises an alert of one of its wheelsets; not stored yet.
    book
        Rules, of which those of the fleet are taken.
    now_ns
        Our time, as which the events are recorded.

    Returns
    -------
    list of AlertEventKind
        The events recorded, those of members included.
    """
    version, book = book.version, book.of(fleet, None)
    standing = _standing(unit, fleet)
    joining = _joining(unit, standing, [change.alert for change in found], book)
    fleet_alerts = dict(standing.of_fleet)
    for kind, members in joining.items():
        if kind not in fleet_alerts:
            new = replace(opened(fleet, kind, members, book), rules_version=version)
            fleet_alerts[kind] = unit.alerts.save(new, (), now_ns)
    joined = {(alert.wheelset, kind) for kind, members in joining.items() for alert in members}
    announced = [alert for alert in standing.alone if (alert.wheelset, alert.kind) in joined]
    events: list[AlertEventKind] = []
    for change in [*(Transition(alert, (AlertEventKind.UPDATED,)) for alert in announced), *found]:
        alert = change.alert
        if (alert.wheelset, alert.kind) in joined:
            alert = replace(alert, fleet_alert_id=fleet_alerts[alert.kind].alert_id)
        unit.alerts.save(alert, change.events, now_ns)
        events += change.events
    for kind, fleet_alert in fleet_alerts.items():
        events += _refresh(unit, fleet_alert, now_ns, new=kind not in standing.of_fleet)
    return events


def _standing(unit: UnitOfWork, fleet: str) -> _Standing:
    stored = unit.alerts.open_in_fleet(fleet)
    alone = [
        alert
        for alert in stored
        if alert.wheelset is not None and alert.fleet_alert_id is None and alert.condition is not Condition.PENDING
    ]
    return _Standing({alert.kind: alert for alert in stored if alert.wheelset is None}, alone)


def _joining(unit: UnitOfWork, standing: _Standing, found: Sequence[Alert], book: RuleBook) -> dict[str, list[Alert]]:
    """Return by kind what becomes a member; the members that an open fleet alert has already count as well."""
    joining = {}
    for kind in (rule.kind for rule in book.rules):
        fleet_alert = standing.of_fleet.get(kind)
        members = [] if fleet_alert is None else unit.alerts.members(fleet_alert.alert_id)
        free = [alert for alert in (*standing.alone, *found) if alert.kind == kind]
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


FIRST_LOOK_NS = 3_600_000_000_000
STAGE = "evaluate_alerts"


def run(context: JobContext) -> Mapping[str, int]:
    """Evaluate alerts; the same data again change nothing, and are not even read.

    Each wheelset is one transaction, in which its alerts are updated, cleared and closed. What is to be raised waits
    for the others of its fleet, since too many of a kind are raised as one; each fleet is then one transaction. A run
    that ends early raises what it has found; what it has not stored the next run finds again. Rows of the worklist that
    an earlier release made, or left empty, are made again on the way.
    """
    isolation = Isolation(context, STAGE)
    with context.storage.read() as unit:
        fleets = [fleet.code for fleet in unit.registry.fleets()]
        of_before = frozenset(unit.worklist.outdated())
    compared = _compared(context, isolation)
    counts: Counter[str] = Counter(dict.fromkeys(("wheelsets", *(kind.value for kind in AlertEventKind)), 0))
    found: list[Transition] = []
    asked = _asked(context, compared, of_before | {item.key for item in isolation.held(SubjectKind.WHEELSET)})
    counts["wheelsets"] += len(asked.serials) - len(asked.due)
    try:
        for done, (serial, digest) in enumerate(asked.due.items()):
            context.checkpoint(done, len(asked.due))
            inputs = inputs_of(context, serial)
            if isolation.waits(SubjectKind.WHEELSET, serial, inputs):
                continue
            with isolation.alone(SubjectKind.WHEELSET, serial, inputs):
                with context.storage.write() as unit:
                    evaluated = _evaluate(unit, serial, context, compared.of(serial), asked.version)
                    unit.worklist.renew([serial] if serial in of_before else [])
                    if evaluated.settled:
                        unit.looks.note(STAGE, serial, Look(digest, evaluated.until_ns))
                counts.update(kind.value for kind in evaluated.events)
                found += evaluated.to_raise
                counts["wheelsets"] += 1
    finally:
        for fleet in fleets:
            of_fleet = [change for change in found if change.alert.fleet == fleet]
            with isolation.alone(SubjectKind.FLEET, fleet):
                with context.storage.write() as unit:
                    events = raise_in_fleet(unit, fleet, of_fleet, context.settings.rules, context.clock.now_ns())
                counts.update(kind.value for kind in events)
    counts["quarantined"] = isolation.quarantined
    return counts


@dataclass(frozen=True, slots=True)
class _Asked:
    """The wheelsets, and those of which something has changed, or time may change something, with their inputs."""

    serials: Sequence[str]
    due: Mapping[str, str]
    version: str  # of the rules


def _asked(context: JobContext, compared: _Compared, always: frozenset[str]) -> _Asked:
    """Return which wheelsets to evaluate: some statements for all, not some for each."""
    rules, now_ns = context.settings.rules, context.clock.now_ns()
    common = (rules.version, repr(context.settings.trend), context.code_version)
    with context.storage.read() as unit:
        wheelsets, looks, touched = unit.registry.wheelsets(), unit.looks.of(STAGE), unit.looks.touched()
        vehicles = {vehicle.code: vehicle for vehicle in unit.registry.vehicles()}
    due = {}
    for wheelset in wheelsets:
        serial, mounting = wheelset.serial, wheelset.mounting
        vehicle = None if mounting is None else vehicles[mounting.vehicle]
        inputs = repr((common, touched.get(serial), wheelset, vehicle, compared.of(serial)))
        digest = hashlib.sha256(inputs.encode()).hexdigest()
        look = looks.get(serial)
        if look is None or serial in always or not look.holds(digest, now_ns):
            due[serial] = digest
    return _Asked([wheelset.serial for wheelset in wheelsets], due, rules.version)


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


def _compared(context: JobContext, isolation: Isolation) -> _Compared:
    """Compare the wheelsets of all fleets; where that fails their other alerts are evaluated without it."""
    rules, compared = context.settings.rules, _Compared()
    with isolation.alone(SubjectKind.FLEET, "comparison of identities"):
        compared.identities = _identities(context, rules.rule(IdentityRule).parameters)
    with isolation.alone(SubjectKind.FLEET, "comparison of suspensions"), context.storage.read() as unit:
        compared.suspensions = shown_by_wheelset(unit, rules)
    with isolation.alone(SubjectKind.FLEET, "rejected recordings"), context.storage.read() as unit:
        compared.rejected = at_first_axles(unit, unit.plausibility.rejected())
    return compared


def _identities(context: JobContext, parameters: IdentityParameters) -> Mapping[str, IdentityEvent]:
    with context.storage.read() as unit:
        found = new_events(unit, unit.registry.wheelsets(), parameters, context.code_version)
    if found.calm:
        with context.storage.write() as unit:
            for serial, look in found.calm.items():
                unit.looks.note(identities.STAGE, serial, look)
    return found.events


@dataclass(slots=True)
class _Evaluated:
    """What the evaluation of a wheelset recorded and is to raise.

    ``settled`` is whether the same again would change nothing, until ``until_ns`` of our time.
    """

    events: list[AlertEventKind] = field(default_factory=list)
    to_raise: list[Transition] = field(default_factory=list)
    settled: bool = True
    until_ns: int | None = None


def _evaluate(unit: UnitOfWork, serial: str, context: JobContext, found: _Found, version: str) -> _Evaluated:
    """Store what changes on the open alerts of a wheelset; return the events of that, and what is to be raised."""
    wheelset, now_ns = unit.registry.wheelset(serial), context.clock.now_ns()
    mounting = wheelset.mounting
    vehicle = None if mounting is None else unit.registry.vehicle(mounting.vehicle)
    book = context.settings.rules.of(wheelset.fleet, None if vehicle is None else vehicle.vehicle_class)
    stored = _facts(unit, wheelset, vehicle, book, context.settings)
    facts = replace(stored, identity=found.identity, suspension=found.suspension, rejected_recordings=found.rejected)
    done = _Evaluated(until_ns=next_change_ns(facts, book, now_ns))
    ended = superseded(facts, book)
    for alert, reason, at_ns in ended:
        done.events += _save(unit, close(alert, reason, at_ns), now_ns, reason.sentence)
    gone = {alert.alert_id for alert, _, _ in ended}
    still_open = {alert.kind: alert for alert in facts.open_alerts if alert.alert_id not in gone}
    done.settled = not ended
    for finding in findings(facts, book, now_ns):
        change = transition(
            still_open.get(finding.kind),
            finding,
            now_ns,
            fleet=facts.wheelset.fleet,
            delays=book.delays_of(finding.kind),
            rules_version=version,
        )
        if change is None:
            continue
        done.settled = False
        if AlertEventKind.RAISED in change.events:
            done.to_raise.append(change)
        else:
            done.events += _save(unit, change, now_ns, "")
    return done


def _save(unit: UnitOfWork, change: Transition, now_ns: int, note: str) -> Sequence[AlertEventKind]:
    unit.alerts.save(change.alert, change.events, now_ns, note=note)
    return change.events


def _facts(
    unit: UnitOfWork,
    wheelset: WheelsetRecord,
    vehicle: VehicleRecord | None,
    book: RuleBook,
    settings: JobSettings,
) -> WheelsetFacts:
    mounting = wheelset.mounting
    alerts: Sequence[Alert] = unit.alerts.all_open(wheelset.serial)
    if mounting is None:
        return WheelsetFacts(wheelset=wheelset, vehicle=None, geometry=None, trend=None, windows=(), open_alerts=alerts)
    return WheelsetFacts(
        wheelset=wheelset,
        vehicle=vehicle,
        geometry=unit.geometries.current(wheelset.serial),
        trend=unit.trends.latest(wheelset.serial),
        windows=_latest_windows(unit, wheelset.serial, mounting.from_ns, *windows_wanted(book)),
        intervals=_intervals(unit, wheelset, mounting.from_ns),
        open_alerts=alerts,
        trend_parameters=settings.trend,
        sensors_changed_ns=max(unit.sensor_changes.at_axle(mounting.vehicle, mounting.axle), default=None),
    )


def _intervals(unit: UnitOfWork, wheelset: WheelsetRecord, since_ns: int) -> Sequence[GeometryRecord]:
    stored = unit.geometries.intervals(wheelset.serial, len(wheelset.reprofilings))
    known = since_change(stored, identity_change(unit, wheelset.serial))
    held = [record for record in known if record.geometry.windows and record.to_ns > since_ns]
    return sorted(held, key=lambda record: record.to_ns)


def windows_wanted(book: RuleBook) -> tuple[int, float]:
    """Return how many windows and how many kilometres the rules look back.

    Parameters
    ----------
    book
        Of a fleet and class.
    """
    rules = (book.rule(SensorFaultRule), book.rule(HuntingRule), book.rule(DataQualityRule))
    return LOOK_BACK * max(rule.latest_windows for rule in rules), max(reach_km(rule.delays) for rule in rules)


def _latest_windows(unit: UnitOfWork, serial: str, since_ns: int, wanted: int, far_km: float) -> Sequence[WindowRecord]:
    """Return the latest ``wanted`` windows since a time and all of the last kilometres; looks back as far as needed."""
    newest = unit.windows.latest(serial)
    if newest is None or newest.start_ns < since_ns:
        return ()
    look_back = FIRST_LOOK_NS
    while True:
        from_ns = max(since_ns, newest.start_ns - look_back)
        found = unit.windows.list(serial, from_ns)
        mileages = [None if window.implausible else window.mileage_km for window in found]
        known = [at for at in mileages if at is not None]
        as_far = far_km <= 0.0 or (bool(known) and known[0] < known[-1] - far_km)
        if (len(found) >= wanted and as_far) or from_ns == since_ns:
            return found[-within_reach(mileages, wanted, far_km) :] if found else ()
        look_back *= 8


JOB = Job(
    name=STAGE,
    description="Evaluate the alert rules and record what they raise, update, clear and close",
    every_s=60.0,
    run=run,
)
