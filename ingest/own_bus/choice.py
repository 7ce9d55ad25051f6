"""Which bus a vehicle has: by its class, among those of a deployment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from estimation.errors import CatalogueError, ParameterError
from ingest.catalogue import Catalogue
from ingest.own_bus.bus import OwnBus


@dataclass(frozen=True, slots=True)
class BusChoice:
    """The buses of a deployment: those of some classes, and the one of all other classes.

    Of the classes in ``missing``, and of all others where ``others_missing``, recordings were decoded with a mapping
    file that this process was not given.

    Raises:
        CatalogueError: A class has two buses, or two buses are for all other classes.
    """

    others: Catalogue
    by_class: dict[str, OwnBus]
    missing: frozenset[str] = frozenset()
    others_missing: bool = False

    def of_class(self, vehicle_class: str | None) -> Catalogue:
        """Return the bus of a class; of a vehicle that the registry does not know, that of all other classes.

        Raises:
            ParameterError: The mapping file of its bus is missing.
        """
        found = self.others if vehicle_class is None else self.by_class.get(vehicle_class, self.others)
        if vehicle_class in self.missing or (self.others_missing and found is self.others):
            raise ParameterError(
                f"recordings of class {vehicle_class!r} were decoded with a mapping file that is not given here:"
                " name it in TREADWATCH_CATALOGUES, or with --catalogue",
                field="catalogue",
            )
        return found

    def of_vehicle(self, class_of: Callable[[str], str | None], vehicle: str) -> Catalogue:
        """Return the bus of a vehicle; ``class_of`` gives the class of a vehicle, and is asked where that decides."""
        return self.of_class(class_of(vehicle)) if self.by_class or self.missing or self.others_missing else self.others


def bus_choice(shipped: Catalogue, buses: Sequence[OwnBus]) -> BusChoice:
    """Return the choice among buses; the shipped one is that of classes without a bus of their own.

    Args:
        buses: Buses from mapping files: one may name no class.

    Raises:
        CatalogueError: A class has two buses, or two buses name no class.
    """
    by_class: dict[str, OwnBus] = {}
    others = [bus for bus in buses if not bus.vehicle_classes]
    if len(others) > 1:
        raise CatalogueError("two mapping files name no class: of which vehicles are they?", field="vehicle_classes")
    for bus in buses:
        for code in bus.vehicle_classes:
            if code in by_class:
                raise CatalogueError(f"class {code!r} is in two mapping files", field="vehicle_classes")
            by_class[code] = bus
    return BusChoice(others[0] if others else shipped, by_class)
