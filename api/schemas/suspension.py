"""What the passes show of the suspension of a vehicle, over time."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field

from api.schemas.common import Links, Representation, Uncertain, uncertain
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.values.quantities import with_interval
from estimation.values.trend import SuspensionChange, SuspensionFinding


class SuspensionResult(Representation):
    """Yaw stiffness over longitudinal creep coefficient of the vehicle, from its passes of one section."""

    section: str
    measured_from: Timestamp
    measured_to: Timestamp
    stiffness_ratio_1: Uncertain = Field(description="Relative to the assumed one; it moves with the creep too.")
    assumed_m: float = Field(description="Yaw stiffness over longitudinal creep coefficient of the vehicle's class.")
    code_version: str
    recorded_at: Timestamp


class SuspensionShift(Representation):
    """By how much the ratio has changed against the vehicle's own past and the other vehicles."""

    change_1: Uncertain = Field(description="Relative; -0.3 is softer by 30 %.")
    past_findings: int
    recent_findings: int
    other_vehicles: int = Field(description="Vehicles on the same sections at the same time, which show friction.")
    measured_to: Timestamp


class Suspension(Representation):
    """All findings of a vehicle, oldest first, and the change; null while too little is known."""

    vehicle: str
    findings: list[SuspensionResult]
    change: SuspensionShift | None
    links: Links


def suspension(vehicle: str, findings: Sequence[SuspensionFinding], change: SuspensionChange | None) -> Suspension:
    """Return the representation of the findings of a vehicle.

    Args:
        findings: In order of time.
        change: Against the past; None where too little is known.
    """
    key = segment(vehicle)
    return Suspension(
        vehicle=vehicle,
        findings=[_result(one) for one in findings],
        change=None if change is None else _shift(change),
        links={"self": f"/v1/vehicles/{key}/suspension", "vehicle": f"/v1/vehicles/{key}"},
    )


def _result(found: SuspensionFinding) -> SuspensionResult:
    return SuspensionResult(
        section=found.section,
        measured_from=to_rfc3339(found.from_ns),
        measured_to=to_rfc3339(found.to_ns),
        stiffness_ratio_1=uncertain(with_interval(found.ratio, found.ratio_std)),
        assumed_m=found.assumed,
        code_version=found.code_version,
        recorded_at=to_rfc3339(found.recorded_ns),
    )


def _shift(change: SuspensionChange) -> SuspensionShift:
    return SuspensionShift(
        change_1=uncertain(with_interval(change.change, change.std, count=float(change.recent))),
        past_findings=change.past,
        recent_findings=change.recent,
        other_vehicles=change.others,
        measured_to=to_rfc3339(change.recent_ns),
    )
