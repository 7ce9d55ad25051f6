"""The alert rules: all there are, and what the operator has set of them.

Limits belong to the operator's maintenance plan (EN 15313 leaves them there). The shipped conicity limits are the
combinations of speed and equivalent conicity at which EN 14363 asks for stability to be shown; confirm them.

A fleet alert stands for many new alerts of one kind in one fleet and contains nothing that its members do not contain.
It is as severe as the worst open member, unknown where all of them are, closed when the last of them closes. Its
evidence counts them and names a few: there may be thousands, and every event carries it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, TypeVar

from annotated_types import Interval

from estimation.alerts.decision import DELAYS
from estimation.alerts.life_cycle import (
    SEVERITY_RANK,
    acknowledgement_ends_ns,
    close,
    section_transition,
    updated,
    without_stale_acknowledgement,
)
from estimation.alerts.rules.conicity_limit import ConicityLimitRule, MeasureRule
from estimation.alerts.rules.rule import AlertDelays, AlertRule, WheelsetFacts
from estimation.alerts.rules.running_gear import (
    HuntingRule,
    LowAdhesionRule,
    SuspensionChangeRule,
    WeakDamperRule,
    section_finding,
)
from estimation.alerts.rules.sensor_data import (
    DataQualityRule,
    IdentityRule,
    NoDataRule,
    SensorFaultRule,
    mounting_corrected,
    silent_since_ns,
)
from estimation.alerts.rules.trend import LimitForecastRule, UnregisteredChangeRule
from estimation.alerts.rules.wheels import WheelAsymmetryRule, WheelFlatRule
from estimation.errors import InputError
from estimation.values.alerts import Alert, AlertEventKind, CloseReason, Condition, Evidence, Finding, Transition
from estimation.values.fields import JsonValue, Served
from estimation.values.opinions import SectionAdhesion
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.trend import BEFORE, UNREGISTERED_CHANGE
from estimation.values.units import DAY_NS, HOUR_NS

SHIPPED = "shipped"  # name of the rules where no file changes them
DIGEST_LETTERS = 12
Rule = TypeVar("Rule", bound=AlertRule)

ALERT_RULES: tuple[type[AlertRule], ...] = (
    ConicityLimitRule,
    MeasureRule,
    LimitForecastRule,
    WheelAsymmetryRule,
    NoDataRule,
    SensorFaultRule,
    IdentityRule,
    HuntingRule,
    SuspensionChangeRule,
    DataQualityRule,
    LowAdhesionRule,
    WeakDamperRule,
    UnregisteredChangeRule,
    WheelFlatRule,
)
SHIPPED_RULES: tuple[AlertRule, ...] = tuple(rule() for rule in ALERT_RULES)


@dataclass(frozen=True, slots=True)
class AlarmFloodRule:
    """How many new alerts of one kind in one fleet become one fleet alert (an alarm flood, IEC 62682)."""

    more_than: Annotated[int, Interval(ge=1, le=1_000_000)] = 5
    within_hours: Annotated[float, Interval(ge=0.01, le=87_600.0)] = 24.0  # between the openings of first and last


@dataclass(frozen=True, slots=True)
class RuleBook:
    """One rule of every type; ``RuleBook()`` holds the shipped defaults."""

    rules: tuple[AlertRule, ...] = SHIPPED_RULES
    alarm_flood: AlarmFloodRule = field(default_factory=AlarmFloodRule)
    name: str = ""
    # the books of fleets and classes, by (fleet, class) with None for any other: of every pair of a fleet and a class
    # that are named, so that one look-up decides. They have no scopes themselves
    scoped: Mapping[tuple[str | None, str | None], RuleBook] = field(default_factory=dict)

    @property
    def version(self) -> str:
        """Return what an alert keeps of the rules that raised it: their name, and a digest of all that they set."""
        scoped = sorted(((scope, book.rules, book.alarm_flood) for scope, book in self.scoped.items()), key=repr)
        digest = hashlib.sha256(repr((self.rules, self.alarm_flood, scoped)).encode()).hexdigest()[:DIGEST_LETTERS]
        shipped = self.name or ("unnamed" if self != RuleBook() else SHIPPED)
        return f"{shipped} {digest}"

    def of(self, fleet: str, vehicle_class: str | None) -> RuleBook:
        """Return the rules of the vehicles of a class in a fleet."""
        named_fleet = fleet if any(named == fleet for named, _ in self.scoped) else None
        named_class = vehicle_class if any(named == vehicle_class for _, named in self.scoped) else None
        return self.scoped.get((named_fleet, named_class), self)

    def with_rules(self, *rules: AlertRule) -> RuleBook:
        """Return a book with these rules in place of those of their types, or added to them."""
        by_kind = {rule.kind: rule for rule in (*self.rules, *rules)}
        return replace(self, rules=tuple(by_kind.values()))

    def rule(self, rule_type: type[Rule]) -> Rule:
        """Return the rule of a type."""
        for rule in self.rules:
            if isinstance(rule, rule_type):
                return rule
        raise LookupError(f"no rule {rule_type.kind} in this book")

    def delays_of(self, kind: str) -> AlertDelays:
        """Return the delays of a rule."""
        for rule in self.rules:
            if rule.kind == kind:
                return rule.delays
        raise LookupError(f"no rule {kind} in this book")

    def enabled(self, kind: str) -> bool:
        """Return whether alerts of a kind are raised."""
        return any(rule.enabled for rule in self.rules if rule.kind == kind)


def superseded(facts: WheelsetFacts, book: RuleBook) -> list[tuple[Alert, CloseReason, int]]:
    """Return open alerts that a dated record or the configuration has ended, each with the reason and the time."""
    ended = ((alert, _ending(alert, facts, book)) for alert in facts.open_alerts)
    return [(alert, *ending) for alert, ending in ended if ending is not None]


def _ending(alert: Alert, facts: WheelsetFacts, book: RuleBook) -> tuple[CloseReason, int] | None:
    mounting, rules = facts.wheelset.mounting, [rule for rule in book.rules if rule.kind == alert.kind]
    before = alert.evidence.get(BEFORE)
    since_ns = before if alert.kind == UNREGISTERED_CHANGE and isinstance(before, int) else alert.opened_ns
    reprofiled = [r.at_ns for r in facts.wheelset.reprofilings if r.at_ns > since_ns]
    if reprofiled and any(rule.of_wear for rule in rules):
        return CloseReason.REPROFILED, reprofiled[0]
    if mounting is None:
        return CloseReason.OUT_OF_SERVICE, alert.last_seen_ns
    if mounting.from_ns > since_ns:
        return CloseReason.WHEELSET_EXCHANGED, mounting.from_ns
    changed_ns = facts.sensors_changed_ns
    if changed_ns is not None and changed_ns > alert.opened_ns and any(rule.of_sensors for rule in rules):
        return CloseReason.SENSOR_CHANGED, changed_ns
    if mounting_corrected(alert, mounting):
        return CloseReason.MOUNTING_CORRECTED, alert.last_seen_ns
    return None if book.enabled(alert.kind) else (CloseReason.RULE_DISABLED, alert.last_seen_ns)


def findings(facts: WheelsetFacts, book: RuleBook, now_ns: int) -> list[Finding]:
    """Return what every rule that is switched on finds; nothing of a wheelset that is not in service.

    Where the sensor is silent or faulty, where the wheelset was reprofiled or mounted after the newest data, or where
    those do not follow the class of the vehicle, the wear rules find ``unknown``: old numbers are never read as the
    present state. Where its identity is in doubt no wear alert is opened either.
    """
    if facts.wheelset.mounting is None:
        return []
    facts = replace(facts, limit_rule=book.rule(ConicityLimitRule))
    first = [(rule, rule.find(facts, now_ns)) for rule in book.rules if not rule.of_wear]
    facts = replace(facts, not_assessable_reason=_not_assessable_reason(facts, first))
    if any(rule.kind == IdentityRule.kind and finding is not None and finding.breached for rule, finding in first):
        facts = replace(facts, intervals=())  # of another wheelset in part, until the mounting is corrected on file
    results = first + [(rule, rule.find(facts, now_ns)) for rule in book.rules if rule.of_wear]
    return [finding for rule, finding in results if finding is not None and rule.enabled]


def _not_assessable_reason(facts: WheelsetFacts, results: list[tuple[AlertRule, Finding | None]]) -> Reason | None:
    baseline = len(facts.wheelset.reprofilings)
    mounting, geometry = facts.wheelset.mounting, facts.geometry
    if geometry is None or geometry.baseline < baseline:
        if baseline:
            return Reason(ReasonCode.NO_GEOMETRY_SINCE_REPROFILING, "no geometry since the last reprofiling")
        return Reason(ReasonCode.NO_GEOMETRY, "no geometry yet")
    if mounting is not None and geometry.to_ns <= mounting.from_ns:
        return Reason(ReasonCode.NO_DATA_SINCE_MOUNTING, "no data since it was mounted")
    if geometry.geometry.status is Status.MODEL_MISMATCH:  # nor is a trend from before the present state
        return geometry.geometry.reason
    hidden = (rule.hides_wear for rule, finding in results if finding is not None and finding.breached)
    return next(filter(None, hidden), None)


def next_change_ns(facts: WheelsetFacts, book: RuleBook, now_ns: int) -> int | None:
    """Return when the same facts may first say something else, ns UTC; None where time alone changes nothing."""
    # time counts where a wheelset is silent, and where an acknowledgement runs out
    moments = [ends for alert in facts.open_alerts if (ends := acknowledgement_ends_ns(alert)) is not None]
    silent, since_ns = book.rule(NoDataRule), silent_since_ns(facts)
    if since_ns is not None:
        moments += [since_ns + round(days * DAY_NS) for days in (silent.days, silent.critical_days)]
    return min((at for at in moments if at >= now_ns), default=None)


MOST_NAMED = 5  # wheelsets in the evidence


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetAlertEvidence(Evidence):
    """Evidence of a fleet alert of any kind: how many alerts it stands for. They themselves are under `members`."""

    more_than: Annotated[int, Served("How many alerts a flood has more than.")]
    within_hours: Annotated[float, Served("Span of opening times that counts as a flood.")]
    member_count: Annotated[int, Served("How many alerts it stands for, open and closed.")] = 0
    open_member_count: Annotated[int, Served("How many of them are open.")] = 0
    wheelsets: Annotated[
        tuple[str, ...],
        Served(f"At most {MOST_NAMED} wheelsets of its members, open ones first, then the most severe."),
    ] = ()


def in_flood(opened_ns: Sequence[int], rule: AlarmFloodRule) -> list[bool]:
    """Return of each alert whether some span of ``within_hours`` (both ends included) holds it and too many others."""
    order = sorted(range(len(opened_ns)), key=lambda i: opened_ns[i])
    within_ns = round(rule.within_hours * HOUR_NS)
    flooding = [False] * len(opened_ns)
    first = 0
    for last, i in enumerate(order):
        while opened_ns[i] - opened_ns[order[first]] > within_ns:
            first += 1
        if last - first + 1 > rule.more_than:
            for member in order[first : last + 1]:
                flooding[member] = True
    return flooding


def opened(fleet: str, kind: str, members: Sequence[Alert], book: RuleBook) -> Alert:
    """Return the fleet alert that members-to-be call for, to be stored before them so that they can name it.

    It counts them only once they are stored, see :func:`refreshed`; to be raised after that.
    """
    if not members:
        raise InputError("a fleet alert needs members", field="members")
    worst = _worst(members)
    return Alert(
        alert_id=0,
        fleet=fleet,
        wheelset=None,
        kind=kind,
        severity=worst.severity,
        condition=_condition(members),
        opened_ns=min(member.opened_ns for member in members),
        last_seen_ns=max(member.last_seen_ns for member in members),
        occurrence_count=len(members),
        probability=None,
        evidence={
            **FleetAlertEvidence(
                more_than=book.alarm_flood.more_than, within_hours=book.alarm_flood.within_hours
            ).stored(),
            DELAYS: {"acknowledgement_days": book.delays_of(kind).acknowledgement_days},
        },
        action=worst.action,
        raise_limit=None,
        clear_limit=None,
    )


def refreshed(alert: Alert, members: Sequence[Alert], now_ns: int) -> Transition | None:
    """Return what its members, as they are now, make of an open fleet alert; None where nothing has changed."""
    after = replace(
        without_stale_acknowledgement(alert, now_ns),
        last_seen_ns=max(alert.last_seen_ns, *(member.last_seen_ns for member in members)),
        occurrence_count=len(members),
        evidence={**alert.evidence, **_counted(members)},
    )
    still_open = [member for member in members if member.closed_ns is None]
    if not still_open:
        return _closed(after, members)
    worst = _worst(still_open)
    if SEVERITY_RANK[worst.severity] > SEVERITY_RANK[alert.severity]:
        after = replace(after, acknowledged_by=None, acknowledged_ns=None)
    after = replace(after, severity=worst.severity, action=worst.action, condition=_condition(still_open))
    return updated(alert, after)


def _closed(alert: Alert, members: Sequence[Alert]) -> Transition:
    closed_ns = max(member.closed_ns or member.last_seen_ns for member in members)
    after = replace(alert, closed_ns=closed_ns, close_reason=CloseReason.MEMBERS_CLOSED)
    if any(member.condition is not Condition.CLEARED for member in members):
        return Transition(after, (AlertEventKind.CLOSED,))
    after = replace(
        after, condition=Condition.CLEARED, cleared_ns=closed_ns, acknowledged_by=None, acknowledged_ns=None
    )
    return Transition(after, (AlertEventKind.CLEARED, AlertEventKind.CLOSED))


def _worst(members: Sequence[Alert]) -> Alert:
    return max(members, key=lambda member: SEVERITY_RANK[member.severity])  # the first of equals


def _condition(members: Sequence[Alert]) -> Condition:
    unknown = all(member.condition is Condition.UNKNOWN for member in members)
    return Condition.UNKNOWN if unknown else Condition.ACTIVE


def _counted(members: Sequence[Alert]) -> dict[str, JsonValue]:
    """Return how many there are, and some of them: the same whatever the order in which they were stored."""
    ordered = sorted(
        members,
        key=lambda a: (a.closed_ns is not None, -SEVERITY_RANK[a.severity], a.opened_ns, a.wheelset or ""),
    )
    return {
        "member_count": len(members),
        "open_member_count": sum(member.closed_ns is None for member in members),
        "wheelsets": [member.wheelset for member in ordered[:MOST_NAMED]],
    }


def section_changes(
    book: RuleBook, friction: SectionAdhesion, fleets: Collection[str], standing: Mapping[str, Alert], now_ns: int
) -> Iterator[Transition]:
    """Yield what the friction of a section does to its alerts: those of the fleets that passed it, and of others.

    Args:
        standing: Open alerts of low adhesion on the section, by fleet.
    """
    finding = section_finding(book.rule(LowAdhesionRule), friction)
    for fleet in sorted({*fleets, *standing}):
        alert, rule = standing.get(fleet), book.of(fleet, None).rule(LowAdhesionRule)
        if rule.enabled:
            change = section_transition(
                alert,
                finding,
                now_ns,
                fleet=fleet,
                track_section=friction.track_section,
                delays=rule.delays,
                rules_version=book.version,
            )
        else:
            change = None if alert is None else close(alert, CloseReason.RULE_DISABLED, friction.to_ns)
        if change is not None:
            yield change
