"""Rules over distances: the mileage of a wheelset and the odometer of a vehicle run forwards, and not too fast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from estimation.jobs.steps.running_mileage import most_km
from ingest.registry_entry.contradiction import Contradiction, RecordName, Rule

TOLERANCE_KM = 1000.0
"""By which books, odometers and the sums of trips may differ."""

_SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True)
class DistancePoint:
    """A distance that a record or a window gives for a time.

    Attributes:
        record: Which one.
        at_ns: ns UTC on the vehicle's clock.
        km: Mileage of the wheelset since new, or what the odometer of the vehicle showed.
        field: In which the record gives it.
    """

    record: RecordName
    at_ns: int
    km: float
    field: str


@dataclass(frozen=True, slots=True)
class DistanceRules:
    """The rules of one quantity: its name in sentences, and those that refuse."""

    name: str
    backwards: Rule
    jump: Rule


MILEAGE = DistanceRules("the mileage", Rule.MILEAGE_BACKWARDS, Rule.MILEAGE_JUMP)
ODOMETER = DistanceRules("the odometer", Rule.ODOMETER_BACKWARDS, Rule.ODOMETER_JUMP)


def distance_contradictions(
    entered: DistancePoint, known: Sequence[DistancePoint], rules: DistanceRules
) -> list[Contradiction]:
    """Return where a distance contradicts those that are known: one contradiction a rule, with all others named.

    Args:
        known: Of the same wheelset or vehicle, any order; the same record among them is left out.
    """
    backwards, jumps = [], []
    for other in known:
        if other.record == entered.record:
            continue
        forward_km = entered.km - other.km if entered.at_ns >= other.at_ns else other.km - entered.km
        if forward_km < -TOLERANCE_KM or (entered.at_ns == other.at_ns and forward_km > TOLERANCE_KM):
            backwards.append(other)
        elif forward_km > most_km(abs(entered.at_ns - other.at_ns) / _SECOND) + TOLERANCE_KM:
            jumps.append(other)
    found = []
    if backwards:
        found.append(_contradiction(entered, backwards, rules.backwards, f"{rules.name} would run backwards"))
    if jumps:
        found.append(
            _contradiction(entered, jumps, rules.jump, f"{rules.name} would run faster than any vehicle (metres?)")
        )
    return found


def _contradiction(entered: DistancePoint, others: list[DistancePoint], rule: Rule, what: str) -> Contradiction:
    named = "; ".join(f"{other.km:,.0f} km by the {other.record}" for other in others[:3])
    more = f"; and {len(others) - 3} more" if len(others) > 3 else ""  # noqa: PLR2004 - as many as are named
    reason = f"{entered.km:,.0f} km: {what}, there is {named}{more}"
    return Contradiction(rule, entered.record, entered.field, reason, tuple(other.record for other in others))
