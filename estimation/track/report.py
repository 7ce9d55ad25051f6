"""What an estimate of a section's alignment says of itself: from what it was made, and whether it settled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from estimation.alerts import JsonValue
from estimation.types import Status


@dataclass(frozen=True, slots=True)
class JourneyReport:
    """Windows of one vehicle on one run over the section: where they were, or why they were not used."""

    vehicle: str
    from_ns: int
    to_ns: int  # start of its last window
    passes: int
    offset_m: float
    scale_1: float
    middle_m: float
    residual_rms_m: float
    used: bool
    reason: str = ""


@dataclass(frozen=True, slots=True)
class LoopReport:
    """How an alignment was found, in figures; stored with it.

    ``evidence`` names what was known besides the passes: the last version, a recorded alignment.
    """

    status: Status
    reason: str
    converged: bool  # positions and stiffness ratios; where not, ``reason`` says so, also of an estimate
    rounds: int
    residual_rms_m: float  # of y - d - h(R) over all passes
    moved_m: float  # by which the last round moved a position at most
    passes: int
    wheelsets: int
    mean_passes: float  # per place that has any
    diversity: float  # std of R between the passes of a place over the std of R
    covered: float  # share of the section whose alignment is known
    alignment_std_m: float  # median along the section
    evidence: tuple[str, ...] = ()
    journeys: tuple[JourneyReport, ...] = ()

    def as_json(self) -> Mapping[str, JsonValue]:
        """Return all of it as JSON; a number that is none is null."""
        fields: dict[str, JsonValue] = {}
        for name, value in asdict(self).items():
            fields[name] = _json(value)
        return fields


def _json(value: object) -> JsonValue:
    if isinstance(value, dict):
        return {str(name): _json(item) for name, item in value.items()}
    if isinstance(value, tuple | list):
        return [_json(item) for item in value]
    if isinstance(value, Status):
        return str(value)
    if isinstance(value, bool | int | str) or value is None:
        return value
    assert isinstance(value, float)
    return value if math.isfinite(value) else None


def nothing(reason: str, evidence: tuple[str, ...] = ()) -> LoopReport:
    """Return the report of passes that say nothing, for this reason."""
    return LoopReport(
        Status.UNESTIMATED, reason, converged=False, rounds=0, residual_rms_m=0.0, moved_m=0.0, passes=0, wheelsets=0,
        mean_passes=0.0, diversity=0.0, covered=0.0, alignment_std_m=float("nan"), evidence=evidence,
    )  # fmt: skip
