"""Step: wheelsets and vehicles on file are read together, once in a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from estimation.storage import UnitOfWork
from estimation.values.registry import VehicleRecord, WheelsetRecord

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Roster:
    """All wheelsets by serial, and all vehicles by code."""

    wheelsets: Sequence[WheelsetRecord]
    vehicles: Mapping[str, VehicleRecord]

    def vehicle_of(self, wheelset: WheelsetRecord) -> VehicleRecord | None:
        """Return the vehicle that a wheelset runs in."""
        return None if wheelset.mounting is None else self.vehicles[wheelset.mounting.vehicle]

    def at_first_axles(self, of_vehicles: Mapping[str, T]) -> dict[str, T]:
        """Return what is known by vehicle by the serial of the wheelset at its first axle that has one.

        Alerts are of wheelsets; so what is known of a vehicle is said at one of its own.

        Args:
            of_vehicles: By code; vehicles without a wheelset are left out.
        """
        first: dict[str, tuple[int, str]] = {}
        for wheelset in self.wheelsets if of_vehicles else ():
            mounting = wheelset.mounting
            if mounting is not None:
                here = (mounting.axle, wheelset.serial)
                first[mounting.vehicle] = min(here, first.get(mounting.vehicle, here))
        return {first[code][1]: known for code, known in of_vehicles.items() if code in first}


def roster(unit: UnitOfWork) -> Roster:
    """Return what is on file."""
    return Roster(unit.registry.wheelsets(), {vehicle.code: vehicle for vehicle in unit.registry.vehicles()})
