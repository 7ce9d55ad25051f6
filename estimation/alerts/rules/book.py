"""The alert rules: all there are, and what the operator has set of them.

Limits belong to the operator's maintenance plan (EN 15313 leaves them there). The shipped conicity limits are the
combinations of speed and equivalent conicity at which EN 14363 asks for stability to be shown; confirm them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, TypeVar

from annotated_types import Interval

from estimation.alerts.rules.conicity_limit import ConicityLimitRule
from estimation.alerts.rules.contradicted_registry import IdentityRule, UnregisteredChangeRule
from estimation.alerts.rules.low_adhesion import LowAdhesionRule
from estimation.alerts.rules.near_limit import LimitForecastRule, MeasureRule
from estimation.alerts.rules.rule import AlertDelays, AlertRule
from estimation.alerts.rules.running_gear import HuntingRule, SuspensionChangeRule, WeakDamperRule
from estimation.alerts.rules.sensor_data import DataQualityRule, NoDataRule, SensorFaultRule
from estimation.alerts.rules.wheels import WheelAsymmetryRule, WheelFlatRule

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


@dataclass(frozen=True, slots=True)
class AlarmFloodRule:
    """How many new alerts of one kind in one fleet become one fleet alert (an alarm flood, IEC 62682)."""

    more_than: Annotated[int, Interval(ge=1, le=1_000_000)] = 5
    within_hours: Annotated[float, Interval(ge=0.01, le=87_600.0)] = 24.0  # between the openings of first and last


@dataclass(frozen=True, slots=True)
class RuleBook:
    """One rule of every type; ``RuleBook()`` holds the shipped defaults.

    Attributes:
        scoped: The books of fleets and classes, by (fleet, class) with None for any other: of every pair of a fleet and
            a class that are named, so that one look-up decides. They have no scopes themselves.
    """

    rules: tuple[AlertRule, ...] = field(default_factory=lambda: tuple(rule() for rule in ALERT_RULES))
    alarm_flood: AlarmFloodRule = field(default_factory=AlarmFloodRule)
    name: str = ""
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
        named_fleet = fleet if any(one == fleet for one, _ in self.scoped) else None
        named_class = vehicle_class if any(one == vehicle_class for _, one in self.scoped) else None
        return self.scoped.get((named_fleet, named_class), self)

    def with_rules(self, *rules: AlertRule) -> RuleBook:
        """Return a book with these rules in place of those of their types, or added to them."""
        given = {rule.kind: rule for rule in rules}
        known = {rule.kind: rule for rule in self.rules}
        return replace(self, rules=tuple((known | given).values()))

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
