"""Step: over which spans of time the passes of a section are pooled, and with which limits."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from estimation.adhesion.parameters import FileErrors, FrictionParameters
from estimation.alerts.rules.low_adhesion import LowAdhesionRule
from estimation.storage import UnitOfWork
from estimation.values.opinions import WindowAdhesion

HOUR_NS = 3_600_000_000_000


def pooled_ns(rule: LowAdhesionRule) -> int:
    """Return how long passes are pooled, ns."""
    return round(rule.pooled_hours * HOUR_NS)


def friction_parameters(
    rule: LowAdhesionRule, unit: UnitOfWork, passes: Sequence[WindowAdhesion]
) -> FrictionParameters:
    """Return the limits of a rule as the friction of a section is found with them, and what the file leaves open.

    Args:
        passes: That are pooled; a vehicle whose class is not on file counts as one without stds of its own.
    """
    codes = {unit.registry.vehicle(code).vehicle_class for code in {one.vehicle for one in passes}}
    found = [unit.registry.vehicle_class(code) for code in sorted(codes)]
    file = FileErrors.of([one.vehicle_class for one in found if one is not None])
    return FrictionParameters(low=rule.raise_friction, likely=rule.raise_probability, file=file)


def section_length(unit: UnitOfWork, section: str) -> float:
    """Return the length of a section, m; 0 of one that is not on file any more: it has no places."""
    return next((one.length_m for one in unit.tracks.sections() if one.code == section), 0.0)


def pool_ends(starts: Collection[int], length_ns: int) -> Sequence[int]:
    """Return the ends of as few spans as hold all times, oldest first; the last ends with the newest.

    Args:
        starts: Times, ns.
        length_ns: Of a span, both ends included.
    """
    ends: list[int] = []
    for start in sorted(set(starts), reverse=True):
        if not ends or ends[-1] - start > length_ns:
            ends.append(start)
    return ends[::-1]
