"""The lateral dampers of a vehicle, one for each running gear."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field

from api.schemas.common import Links, Representation
from api.schemas.derived import Derived
from api.schemas.registry import segment
from estimation.values.opinions import GearDamper


class DamperState(Derived, of=GearDamper, without=("vehicle", "windows")):
    """The lateral damper of a running gear: between frame and body of a bogie, or above a single wheelset."""


class Dampers(Representation):
    """All lateral dampers of a vehicle that were looked at, by axle."""

    vehicle: str = Field(examples=["V-0001"])
    dampers: list[DamperState] = Field(description="Empty before a window has been looked at.")
    links: Links


def dampers(vehicle: str, found: Sequence[GearDamper]) -> Dampers:
    """Return the representation of the dampers of a vehicle."""
    own = f"/v1/vehicles/{segment(vehicle)}"
    links = {"self": f"{own}/dampers", "vehicle": own}
    return Dampers(vehicle=vehicle, dampers=[DamperState.made(one) for one in found], links=links)
