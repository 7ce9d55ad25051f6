"""What the passes show of the suspension of a vehicle, over time."""

from __future__ import annotations

from collections.abc import Sequence

from api.schemas.common import Links, Representation
from api.schemas.derived import Derived
from api.schemas.registry import segment
from estimation.values.trend import SuspensionChange, SuspensionFinding


class SuspensionResult(
    Derived, of=SuspensionFinding, without=("vehicle", "ratio", "ratio_std"), also=("stiffness_ratio",)
):
    """Yaw stiffness over longitudinal creep coefficient of the vehicle, from its passes of one section."""


class SuspensionShift(
    Derived,
    of=SuspensionChange,
    without=("vehicle", "change", "std", "step_probability", "since_ns"),
    also=("estimate",),
):
    """By how much the ratio has changed against the vehicle's own past and the other vehicles."""


class Suspension(Representation):
    """All findings of a vehicle, oldest first, and the change; null while too little is known."""

    vehicle: str
    findings: list[SuspensionResult]
    change: SuspensionShift | None
    links: Links


def suspension(vehicle: str, findings: Sequence[SuspensionFinding], change: SuspensionChange | None) -> Suspension:
    """Return the representation of the findings of a vehicle."""
    own = f"/v1/vehicles/{segment(vehicle)}"
    return Suspension(
        vehicle=vehicle,
        findings=[SuspensionResult.made(one) for one in findings],
        change=None if change is None else SuspensionShift.made(change),
        links={"self": f"{own}/suspension", "vehicle": own},
    )
