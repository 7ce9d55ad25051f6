"""The vehicle class that an operator has on file of simulated vehicles: the right one, or another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, VehicleClass


@dataclass(frozen=True, slots=True)
class ClassOnFile:
    """A class file, and what the registry says of vehicles of that class."""

    path: Path
    vehicle_class: VehicleClass
    nominal_radius: float | None = None  # m, of the wheelsets; None: what it is

    def axle_offsets(self, true: tuple[float, ...]) -> tuple[float, ...]:
        """Return the axle offsets, m, of a vehicle with its bogies in place and the wheelbase of the class."""
        bogie = self.vehicle_class.bogie
        if bogie is None or len(true) % AXLES_OF_A_BOGIE:
            return true
        half = 0.5 * bogie.wheelbase
        middles = (0.5 * (front + rear) for front, rear in zip(true[::2], true[1::2], strict=True))
        return tuple(round(middle + side * half, 6) for middle in middles for side in (-1.0, 1.0))
