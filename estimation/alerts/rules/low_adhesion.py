"""Rule: a track section has rails of little friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Interval

from estimation.alerts.rules.rule import AlertRule, Probability, WheelsetFacts, estimate_evidence
from estimation.values.adhesion import CellFriction, SectionAdhesion
from estimation.values.alerts import Finding, Severity
from estimation.values.json_value import JsonValue

Friction = Annotated[float, Interval(ge=0.02, le=0.6)]
Hours = Annotated[float, Interval(ge=0.1, le=720.0)]


@dataclass(frozen=True, slots=True)
class LowAdhesionRule(AlertRule):
    """Friction is below a limit somewhere along a section; the alert is about the section, one for each fleet."""

    kind: ClassVar[str] = "low_adhesion"
    limit_unit: ClassVar[str] = "1"

    raise_friction: Friction = 0.15
    raise_probability: Probability = 0.45
    pooled_hours: Hours = 6.0

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - friction is no fact of a wheelset
        """Return None: ``section_finding`` is what the rule finds, of a section."""
        return None


def section_finding(rule: LowAdhesionRule, found: SectionAdhesion) -> Finding:
    """Return what the rule finds of a section; its ``wheelset`` is empty.

    Args:
        found: The newest friction of the section.
    """
    low = [cell for cell in found.cells if _within(cell, found)]
    worst = max(low, key=lambda cell: cell.low_probability, default=None)
    stretches: list[JsonValue] = [{"from_m": begin, "to_m": end} for begin, end in found.low_stretches]
    evidence: dict[str, JsonValue] = {
        "track_section": found.track_section,
        "stretches": stretches,
        "friction": None if worst is None else estimate_evidence(worst.friction),
        "passes": None if worst is None else worst.passes,
        "windows": found.windows,
        "from_ns": found.from_ns,
        "to_ns": found.to_ns,
        "limit": rule.raise_friction,
    }
    return Finding(
        wheelset="",
        kind=LowAdhesionRule.kind,
        breached=bool(found.low_stretches),
        cleared=not found.low_stretches,
        severity=Severity.WARNING,
        probability=None if worst is None else round(worst.low_probability, 3),
        evidence=evidence,
        action="inspect_rail_surface",
        raise_limit=rule.raise_friction,
        clear_limit=rule.raise_friction,
        measured_ns=found.to_ns,
        stands=bool(found.low_stretches),
        since_ns=found.to_ns,
    )


def _within(cell: CellFriction, found: SectionAdhesion) -> bool:
    return any(begin <= cell.from_m and cell.to_m <= end for begin, end in found.low_stretches) and (
        cell.friction.value is not None
    )
