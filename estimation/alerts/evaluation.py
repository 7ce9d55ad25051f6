"""All rules over one wheelset: findings of its stored facts, and open alerts that dated records have superseded."""

from __future__ import annotations

from dataclasses import replace

from estimation.alerts.life_cycle import DAY_NS, acknowledgement_ends_ns
from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.conicity_limit import ConicityLimitRule
from estimation.alerts.rules.contradicted_registry import IdentityRule, mounting_corrected
from estimation.alerts.rules.rule import AlertRule, WheelsetFacts
from estimation.alerts.rules.sensor_data import NoDataRule, silent_since_ns
from estimation.values.alerts import Alert, CloseReason, Finding
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.trend import BEFORE, UNREGISTERED_CHANGE


def superseded(facts: WheelsetFacts, book: RuleBook) -> list[tuple[Alert, CloseReason, int]]:
    """Return open alerts that a dated record or the configuration has ended, each with the reason and the time."""
    ended = ((alert, _ending(alert, facts, book)) for alert in facts.open_alerts)
    return [(alert, *ending) for alert, ending in ended if ending is not None]


def _ending(alert: Alert, facts: WheelsetFacts, book: RuleBook) -> tuple[CloseReason, int] | None:
    mounting, rules = facts.wheelset.mounting, [rule for rule in book.rules if rule.kind == alert.kind]
    since_ns = _since(alert)
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


def _since(alert: Alert) -> int:
    """Return the time after which something registered ends an alert: of a step, before the data that showed it."""
    before = alert.evidence.get(BEFORE)
    return before if alert.kind == UNREGISTERED_CHANGE and isinstance(before, int) else alert.opened_ns


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
    found = first + [(rule, rule.find(facts, now_ns)) for rule in book.rules if rule.of_wear]
    return [finding for rule, finding in found if finding is not None and rule.enabled]


def _not_assessable_reason(facts: WheelsetFacts, found: list[tuple[AlertRule, Finding | None]]) -> Reason | None:
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
    hidden = (rule.hides_wear for rule, finding in found if finding is not None and finding.breached)
    return next(filter(None, hidden), None)


def next_change_ns(facts: WheelsetFacts, book: RuleBook, now_ns: int) -> int | None:
    """Return when the same facts may first say something else, ns UTC; None where time alone changes nothing.

    Time counts where a wheelset is silent, and where an acknowledgement runs out.
    """
    moments = [ends for alert in facts.open_alerts if (ends := acknowledgement_ends_ns(alert)) is not None]
    silent, since_ns = book.rule(NoDataRule), silent_since_ns(facts)
    if since_ns is not None:
        moments += [since_ns + round(days * DAY_NS) for days in (silent.days, silent.critical_days)]
    return min((at for at in moments if at >= now_ns), default=None)
