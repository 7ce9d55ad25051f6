"""Whether what is entered belongs to the vehicle classes of the entry and of the store."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress

from estimation.errors import InputError, NotFoundError
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, VehicleClass
from fleet_db.stores.registry import RegistryStore
from ingest.registry_entry.contents import RegistryContents, Source

WHEELBASE_TOLERANCE = 0.05  # m, between two axle offsets of a bogie and its wheelbase
RADIUS_TOLERANCE = 0.15  # of the class's nominal radius: new and worn out wheels differ by less


def class_refusals(source: Source, contents: RegistryContents, registry: RegistryStore) -> Iterator[InputError]:
    """Yield what is wrong with vehicles and wheelsets that do not belong to their class, entered or on file.

    A vehicle on bogies has an even number of axles, and two axles of a bogie are its wheelbase apart; the radius of a
    wheelset is one of its class.
    """
    if not (contents.classes or contents.vehicles or contents.wheelsets or contents.mountings):
        return
    classes = {one.code: one for one in contents.classes}
    for code in {vehicle.vehicle_class for vehicle in contents.vehicles} - set(classes):
        known = _on_file(registry, code)
        if known is not None:
            classes[code] = known
    for index, vehicle in enumerate(contents.vehicles):
        if vehicle.vehicle_class in classes and (misfit := _misfit(vehicle, classes[vehicle.vehicle_class])):
            yield source.error(misfit[1], ("vehicles", index, misfit[0]))
    entered = {vehicle.code for vehicle in contents.vehicles}
    for index, one in enumerate(contents.classes):
        for vehicle in registry.vehicles_of_class(one.code):
            if vehicle.code not in entered and (misfit := _misfit(vehicle, one)):
                yield source.error(f"vehicle {vehicle.code!r} on file: {misfit[1]}", ("vehicle_classes", index))
    yield from _unfit_wheelsets(source, contents, _running(contents, registry, classes))


def _misfit(vehicle: VehicleRecord, known: VehicleClass) -> tuple[str, str] | None:
    """Return field and reason why the axles of a vehicle are not those of a class; None where they are."""
    if known.bogie is None:
        return None
    if vehicle.axles % AXLES_OF_A_BOGIE:
        return "axles", f"{vehicle.axles}: class {known.code!r} runs on bogies of two axles"
    offsets = vehicle.axle_offsets_m
    for front, rear in zip(offsets[::2], offsets[1::2], strict=True):
        if abs(abs(rear - front) - known.bogie.wheelbase) > WHEELBASE_TOLERANCE:
            return "axle_offsets_m", (
                f"axles at {front:g} and {rear:g} m are {abs(rear - front):g} m apart, "
                f"the wheelbase of class {known.code!r} is {known.bogie.wheelbase:g} m"
            )
    return None


_Running = tuple[WheelsetRecord, str, VehicleClass]
"""A wheelset, and the code of the vehicle and the class that it runs under once the records are entered."""


def _unfit_wheelsets(source: Source, contents: RegistryContents, running: Sequence[_Running]) -> Iterator[InputError]:
    """Yield what is wrong with wheelsets that an entry brings together with a class of another radius."""
    entries = {
        "wheelsets": [one.serial for one in contents.wheelsets],
        "mountings": [one.wheelset for one in contents.mountings],
        "vehicles": [one.code for one in contents.vehicles],
        "vehicle_classes": [one.code for one in contents.classes],
    }
    fields = {"wheelsets": ("nominal_radius_mm",), "mountings": ("wheelset",), "vehicles": ("vehicle_class",)}
    for wheelset, vehicle, known in running:
        serial, radius, expected = wheelset.serial, wheelset.nominal_radius_m, known.parameters.nominal_radius
        keys = {"wheelsets": serial, "mountings": serial, "vehicles": vehicle, "vehicle_classes": known.code}
        brought_by = next((name for name, key in keys.items() if key in entries[name]), None)
        if brought_by is None or abs(radius - expected) <= RADIUS_TOLERANCE * expected:
            continue
        reason = (
            f"{1e3 * radius:g} mm differs by more than {100 * RADIUS_TOLERANCE:g} % "
            f"from the {1e3 * expected:g} mm of class {known.code!r}"
        )
        on_file = "" if brought_by == "wheelsets" else f"wheelset {serial!r} on file: "
        place = entries[brought_by].index(keys[brought_by])
        yield source.error(on_file + reason, (brought_by, place, *fields.get(brought_by, ())))


def without_class(contents: RegistryContents, registry: RegistryStore) -> tuple[VehicleRecord, ...]:
    """Return the vehicles that were entered and whose class nobody knows."""
    codes = {vehicle.vehicle_class for vehicle in contents.vehicles}
    known = {code for code in codes if registry.vehicle_class(code) is not None}
    return tuple(vehicle for vehicle in contents.vehicles if vehicle.vehicle_class not in known)


def _running(
    contents: RegistryContents, registry: RegistryStore, classes: Mapping[str, VehicleClass]
) -> list[_Running]:
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
            found.append((wheelsets[serial], vehicle, of_vehicle))
    return found


def _on_file(registry: RegistryStore, code: str) -> VehicleClass | None:
    found = registry.vehicle_class(code)
    return None if found is None else found.vehicle_class
