"""What alert rules would have raised about track sections over stored sums of friction. Reads; nothing is written.

The windows of a section are pooled in as few spans of ``pooled_hours`` as hold all of them, as ``refresh_adhesion``
does with windows that come in together; each span is evaluated with the sums as they are stored now. Sums are kept for
some weeks (``refresh_adhesion.KEPT_NS``): of windows before nothing is raised.
"""

from __future__ import annotations

from collections.abc import Sequence

from estimation.adhesion.friction import section_adhesion
from estimation.alerts.life_cycle import close, section_transition
from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.low_adhesion import LowAdhesionRule, section_finding
from estimation.jobs.steps.pooled_friction import friction_parameters, pool_ends, pooled_ns, section_length
from estimation.storage import UnitOfWork
from estimation.values.alerts import Alert, CloseReason, Condition
from estimation.values.opinions import SectionAdhesion


def section_replayed(unit: UnitOfWork, section: str, book: RuleBook, span: tuple[int, int]) -> list[Alert]:
    """Return the alerts of low adhesion that rules would have raised about a section within a span of time, by opening.

    Args:
        span: From and to, ns UTC of the vehicles' clocks.
    """
    rule = book.rule(LowAdhesionRule)
    pooled, length = pooled_ns(rule), section_length(unit, section)
    standing: dict[str, Alert] = {}
    closed: list[Alert] = []
    for to_ns in pool_ends(unit.adhesion.starts_with_sums(section, *span), pooled):
        passes = unit.adhesion.of_section(section, to_ns - pooled, to_ns)
        found = section_adhesion(section, passes, friction_parameters(rule, unit, passes), length)
        if found is not None:
            fleets = {unit.registry.vehicle(code).fleet for code in {one.vehicle for one in passes}}
            _evaluate(found, book, sorted({*fleets, *standing}), standing, closed)
    published = [one for one in (*closed, *standing.values()) if one.condition is not Condition.PENDING]
    return sorted(published, key=lambda one: (one.opened_ns, one.fleet))


def _evaluate(
    found: SectionAdhesion, book: RuleBook, fleets: Sequence[str], standing: dict[str, Alert], closed: list[Alert]
) -> None:
    """Bring the alerts of the fleets up to the end of a pooled span; those that end go to ``closed``."""
    section, at_ns = found.track_section, found.to_ns
    finding = section_finding(book.rule(LowAdhesionRule), found)
    for fleet in fleets:
        own = book.of(fleet, None).rule(LowAdhesionRule)
        if not own.enabled:
            if fleet in standing:
                closed.append(close(standing.pop(fleet), CloseReason.RULE_DISABLED, at_ns).alert)
            continue
        change = section_transition(
            standing.get(fleet),
            finding,
            at_ns,
            fleet=fleet,
            track_section=section,
            delays=own.delays,
            rules_version=book.version,
        )
        if change is None:
            continue
        if change.alert.closed_ns is None:
            standing[fleet] = change.alert
        else:
            standing.pop(fleet, None)
            if change.events:  # one that was never raised leaves nothing
                closed.append(change.alert)
