"""The lateral dampers of a vehicle, one for each running gear."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field

from api.schemas.common import Links, Representation, Uncertain, uncertain
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.values.dampers import GearDamper


class DamperState(Representation):
    """The lateral damper of a running gear: between frame and body of a bogie, or above a single wheelset."""

    first_axle: int = Field(description="First axle of the running gear, from 1.")
    damping_share_1: Uncertain = Field(
        description="Damping over that of the vehicle class on file; `n_windows` counts those that show it."
    )
    weak: bool | None = Field(description="Whether less than half of the damping is likely left; null where unknown.")
    weak_probability_1: float | None = Field(description="That less than half of it is left; null where unknown.")
    diverged_windows: int = Field(description="Windows that the filter did not follow.")
    refused_windows: int = Field(description="Windows that say nothing of the damper.")
    measured_from: Timestamp = Field(description="Start of the first window that counts.")
    measured_to: Timestamp = Field(description="Start of the last window that counts.")
    odometer_from_km: float = Field(description="Odometer of the vehicle at the first window.")
    odometer_to_km: float = Field(description="Odometer of the vehicle at the last window.")


class Dampers(Representation):
    """All lateral dampers of a vehicle that were looked at, by axle."""

    vehicle: str = Field(examples=["V-0001"])
    dampers: list[DamperState] = Field(description="Empty before a window has been looked at.")
    links: Links


def dampers(vehicle: str, found: Sequence[GearDamper]) -> Dampers:
    """Return the representation of the dampers of a vehicle."""
    key = segment(vehicle)
    return Dampers(
        vehicle=vehicle,
        dampers=[_state(one) for one in found],
        links={"self": f"/v1/vehicles/{key}/dampers", "vehicle": f"/v1/vehicles/{key}"},
    )


def _state(found: GearDamper) -> DamperState:
    return DamperState(
        first_axle=found.first_axle,
        damping_share_1=uncertain(found.share),
        weak=found.weak,
        weak_probability_1=found.weak_probability,
        diverged_windows=found.diverged,
        refused_windows=found.refused,
        measured_from=to_rfc3339(found.from_ns),
        measured_to=to_rfc3339(found.to_ns),
        odometer_from_km=found.from_km,
        odometer_to_km=found.to_km,
    )
