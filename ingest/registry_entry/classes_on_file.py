"""Whether what is entered belongs to the vehicle classes of the entry and of the store."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress

from estimation.errors import InputError, NotFoundError
from estimation.values.registry import VehicleRecord
from estimation.vehicle.vehicle_class import VehicleClass
from fleet_db.stores.registry import RegistryStore
from ingest.registry_entry.class_fit import RunningWheelset, unfit_classes, unfit_vehicles, unfit_wheelsets
from ingest.registry_entry.contents import RegistryContents, Source


def class_refusals(source: Source, contents: RegistryContents, registry: RegistryStore) -> Iterator[InputError]:
    """Yield what is wrong with vehicles and wheelsets that do not belong to their class, entered or on file."""
    if not (contents.classes or contents.vehicles or contents.wheelsets or contents.mountings):
        return
    classes = {one.code: one for one in contents.classes}
    for code in _classes_of(contents) - set(classes):
        known = _on_file(registry, code)
        if known is not None:
            classes[code] = known
    yield from unfit_vehicles(source, contents.vehicles, classes)
    changed = {vehicle.code for vehicle in contents.vehicles}
    on_file = {
        one.code: [vehicle for vehicle in registry.vehicles_of_class(one.code) if vehicle.code not in changed]
        for one in contents.classes
    }
    yield from unfit_classes(source, contents.classes, on_file)
    entries = {
        "wheelsets": [one.serial for one in contents.wheelsets],
        "mountings": [one.wheelset for one in contents.mountings],
        "vehicles": [one.code for one in contents.vehicles],
        "vehicle_classes": [one.code for one in contents.classes],
    }
    yield from unfit_wheelsets(source, _running(contents, registry, classes), entries)


def without_class(contents: RegistryContents, registry: RegistryStore) -> tuple[VehicleRecord, ...]:
    """Return the vehicles that were entered and whose class nobody knows."""
    known = {code for code in _classes_of(contents) if registry.vehicle_class(code) is not None}
    return tuple(vehicle for vehicle in contents.vehicles if vehicle.vehicle_class not in known)


def _classes_of(contents: RegistryContents) -> set[str]:
    return {vehicle.vehicle_class for vehicle in contents.vehicles}


def _running(
    contents: RegistryContents, registry: RegistryStore, classes: Mapping[str, VehicleClass]
) -> list[RunningWheelset]:
    """Return the wheelsets in service as the file leaves them, those of whose class nothing is known left out."""
    wheelsets = {one.serial: one for one in registry.wheelsets()}
    mounted = [one.mounting for one in wheelsets.values() if one.mounting is not None]
    latest = {one.wheelset: one.vehicle for one in sorted([*mounted, *contents.mountings], key=lambda m: m.from_ns)}
    wheelsets |= {one.serial: one for one in contents.wheelsets}
    class_of = {one.code: one.vehicle_class for one in contents.vehicles}
    for code in set(latest.values()) - set(class_of):
        with suppress(NotFoundError):  # refused when the mounting is stored
            class_of[code] = registry.vehicle(code).vehicle_class
    known = {code: classes.get(code) or _on_file(registry, code) for code in set(class_of.values())}
    found = []
    for serial, vehicle in latest.items():
        of_vehicle = known.get(class_of.get(vehicle, ""))
        if serial in wheelsets and of_vehicle is not None:
            found.append(RunningWheelset(wheelsets[serial], vehicle, of_vehicle))
    return found


def _on_file(registry: RegistryStore, code: str) -> VehicleClass | None:
    found = registry.vehicle_class(code)
    return None if found is None else found.vehicle_class
