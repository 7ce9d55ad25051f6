"""Rule: a track section has rails of little friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval

from estimation.alerts.rules.rule import AlertRule, Evidence, Probability, WheelsetFacts
from estimation.values.alerts import Finding
from estimation.values.fields import Served
from estimation.values.opinions import SectionAdhesion
from estimation.values.quantities import Estimate

Friction = Annotated[float, Interval(ge=0.02, le=0.6)]
Hours = Annotated[float, Interval(ge=0.1, le=720.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """A stretch of a track section."""

    from_m: Annotated[float, Served("Where it begins, along the section.")]
    to_m: Annotated[float, Served("Where it ends, along the section.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class LowAdhesionEvidence(Evidence):
    """Evidence of `low_adhesion`: rails of little friction along a track section."""

    track_section: Annotated[str, Served("Code of the section.")]
    stretches: Annotated[tuple[Stretch, ...], Served("Where friction is below the limit.")]
    friction: Annotated[Estimate | None, Served("Coefficient of friction at the surest place of them.", "friction_1")]
    passes: Annotated[int | None, Served("Passes of wheelsets behind it.")]
    windows: Annotated[int, Served("Windows that are pooled along the section.")]
    from_ns: Annotated[int, Served("Start of the first of them.", "measured_from")]
    to_ns: Annotated[int, Served("Start of the last of them.", "measured_to")]
    limit: Annotated[float, Served("Friction below which the alert is raised.", "limit_1")]


@dataclass(frozen=True, slots=True)
class LowAdhesionRule(AlertRule):
    """Friction is below a limit somewhere along a section; the alert is about the section, one for each fleet."""

    kind = "low_adhesion"
    limit_unit = "1"
    evidence = LowAdhesionEvidence

    raise_friction: Friction = 0.15
    raise_probability: Probability = 0.45
    pooled_hours: Hours = 6.0

    def find(self, facts: WheelsetFacts, now_ns: int) -> Finding | None:  # noqa: ARG002 - friction is no fact of a wheelset
        """Return None: ``section_finding`` is what the rule finds, of a section."""
        return None


def section_finding(rule: LowAdhesionRule, found: SectionAdhesion) -> Finding:
    """Return what the rule finds in the newest friction of a section; its ``wheelset`` is empty."""
    stretches = found.low_stretches
    low = [
        cell
        for cell in found.cells
        if cell.friction.value is not None and any(a <= cell.from_m and cell.to_m <= b for a, b in stretches)
    ]
    worst = max(low, key=lambda cell: cell.low_probability, default=None)
    evidence = LowAdhesionEvidence(
        track_section=found.track_section,
        stretches=tuple(Stretch(from_m=begin, to_m=end) for begin, end in found.low_stretches),
        friction=None if worst is None else worst.friction,
        passes=None if worst is None else worst.passes,
        windows=found.windows,
        from_ns=found.from_ns,
        to_ns=found.to_ns,
        limit=rule.raise_friction,
    )
    return Finding(
        wheelset="",
        kind=LowAdhesionRule.kind,
        breached=bool(found.low_stretches),
        cleared=not found.low_stretches,
        probability=None if worst is None else round(worst.low_probability, 3),
        evidence=evidence.stored(),
        action="inspect_rail_surface",
        raise_limit=rule.raise_friction,
        clear_limit=rule.raise_friction,
        measured_ns=found.to_ns,
        stands=bool(found.low_stretches),
        since_ns=found.to_ns,
    )
