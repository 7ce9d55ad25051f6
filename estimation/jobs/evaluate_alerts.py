"""Job: evaluate the alert rules of every wheelset and record what changes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from estimation.alerts.fleet_alerts import in_flood, opened, refreshed
from estimation.alerts.identity import IdentityEvent
from estimation.alerts.life_cycle import close, transition
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
from estimation.jobs.steps.first_axles import at_first_axles
from estimation.jobs.steps.identities import identity_change, new_events
from estimation.jobs.steps.suspension import shown_by_wheelset
from estimation.storage import UnitOfWork
from estimation.values.alerts import Alert, AlertEventKind, Condition, Transition
from estimation.values.geometry import GeometryRecord
from estimation.values.identity import since_change
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


def run(context: JobContext) -> Mapping[str, int]:
    """Evaluate alerts; the same data again change nothing.

    Each wheelset is one transaction, in which its alerts are updated, cleared and closed. What is to be raised waits
    for the others of its fleet, since too many of a kind are raised as one; each fleet is then one transaction. A run
    that ends early raises what it has found; what it has not stored the next run finds again. Rows of the worklist that
    an earlier release made, or left empty, are made again on the way.
    """
    isolation = Isolation(context, "evaluate_alerts")
    with context.storage.read() as unit:
        serials = [wheelset.serial for wheelset in unit.registry.wheelsets()]
        fleets = [fleet.code for fleet in unit.registry.fleets()]
        of_before = frozenset(unit.worklist.outdated())
    compared, version = _compared(context, isolation), context.settings.rules.version
    counts: Counter[str] = Counter(dict.fromkeys(("wheelsets", *(kind.value for kind in AlertEventKind)), 0))
    found: list[Transition] = []
    try:
        for done, serial in enumerate(serials):
            context.checkpoint(done, len(serials))
            inputs = inputs_of(context, serial)
            if isolation.waits(SubjectKind.WHEELSET, serial, inputs):
                continue
            with isolation.alone(SubjectKind.WHEELSET, serial, inputs):
                with context.storage.write() as unit:
                    events, to_raise = _evaluate(unit, serial, context, compared.of(serial), version)
                    unit.worklist.renew([serial] if serial in of_before else [])
                counts.update(kind.value for kind in events)
                found += to_raise
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
    with isolation.alone(SubjectKind.FLEET, "comparison of identities"), context.storage.read() as unit:
        compared.identities = new_events(unit, unit.registry.wheelsets(), rules.rule(IdentityRule).parameters)
    with isolation.alone(SubjectKind.FLEET, "comparison of suspensions"), context.storage.read() as unit:
        compared.suspensions = shown_by_wheelset(unit, rules)
    with isolation.alone(SubjectKind.FLEET, "rejected recordings"), context.storage.read() as unit:
        compared.rejected = at_first_axles(unit, unit.plausibility.rejected())
    return compared


def _evaluate(
    unit: UnitOfWork, serial: str, context: JobContext, found: _Found, version: str
) -> tuple[list[AlertEventKind], list[Transition]]:
    """Store what changes on the open alerts of a wheelset; return the events of that, and what is to be raised."""
    wheelset, now_ns = unit.registry.wheelset(serial), context.clock.now_ns()
    mounting = wheelset.mounting
    vehicle = None if mounting is None else unit.registry.vehicle(mounting.vehicle)
    book = context.settings.rules.of(wheelset.fleet, None if vehicle is None else vehicle.vehicle_class)
    stored = _facts(unit, wheelset, vehicle, book, context.settings)
    facts = replace(stored, identity=found.identity, suspension=found.suspension, rejected_recordings=found.rejected)
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
            rules_version=version,
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
    name="evaluate_alerts",
    description="Evaluate the alert rules and record what they raise, update, clear and close",
    every_s=60.0,
    run=run,
)
