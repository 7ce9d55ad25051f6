"""What may be behind a sudden change of a conicity that nobody has registered."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class StepCause(StrEnum):
    """What happened to a wheelset or to its sensor."""

    TURNED = "turned"  # reprofiled
    EXCHANGED = "exchanged"  # for another wheelset
    TURNED_END_FOR_END = "turned_end_for_end"  # left wheel on the other side
    DAMAGED = "damaged"
    SENSOR = "sensor"  # of another scale, or exchanged


@dataclass(frozen=True, slots=True)
class StepExplanation:
    """How well a cause explains a step: share of all causes, and the standard deviations that it leaves open."""

    cause: StepCause
    share: float
    left: float
