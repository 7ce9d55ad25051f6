"""Vehicles and the wheelsets that are mounted on them, as one transaction sees them; each vehicle is read once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from estimation.storage import UnitOfWork
from estimation.values.registry import Mounting, VehicleRecord

LATEST_NS = 2**63 - 1


@dataclass(frozen=True, slots=True)
class VehicleLookup:
    """Looks up vehicles and mountings.

    Attributes:
        unit: Vehicles and mountings are read.
    """

    unit: UnitOfWork
    _vehicles: dict[str, VehicleRecord] = field(default_factory=dict)
    _mountings: dict[str, Sequence[Mounting]] = field(default_factory=dict)

    def vehicle(self, code: str) -> VehicleRecord:
        """Return a vehicle.

        Raises:
            NotFoundError: There is none of that code.
        """
        if code not in self._vehicles:
            self._vehicles[code] = self.unit.registry.vehicle(code)
        return self._vehicles[code]

    def mounting_at(self, vehicle: str, axle: int, at_ns: int) -> Mounting | None:
        """Return which wheelset ran at an axle at a time; None where there was none.

        Args:
            vehicle, axle: Code, and the axle from 1.
            at_ns: ns UTC on the vehicle's clock.
        """
        if vehicle not in self._mountings:
            self._mountings[vehicle] = self.unit.registry.mountings_on(vehicle, 0, LATEST_NS)
        for one in self._mountings[vehicle]:
            if one.axle == axle and one.from_ns <= at_ns and (one.to_ns is None or at_ns < one.to_ns):
                return one
        return None
