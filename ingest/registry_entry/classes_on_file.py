"""Whether what is entered belongs to the vehicle classes of the entry and of the store."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from estimation.errors import InputError, NotFoundError
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, VehicleClass
from fleet_db.stores.registry import RegistryStore
from ingest.input_file import Location
from ingest.registry_entry.contents import RegistryContents, Source

WHEELBASE_TOLERANCE = 0.05  # m, between two axle offsets of a bogie and its wheelbase
RADIUS_TOLERANCE = 0.15  # of the class's nominal radius: new and worn out wheels differ by less
_FIELD = "vehicle_classes"


def unfit_vehicles(
    source: Source, vehicles: Sequence[VehicleRecord], classes: Mapping[str, VehicleClass]
) -> Iterator[InputError]:
    """Yield what is wrong with vehicles whose axles are not those of their class.

    A vehicle on bogies has an even number of axles, and two axles of a bogie are its wheelbase apart.

    Args:
        vehicles: As they are entered, in that order.
    """
    for index, vehicle in enumerate(vehicles):
        known = classes.get(vehicle.vehicle_class)
        misfit = None if known is None else _misfit(vehicle, known)
        if misfit is not None:
            field, reason = misfit
            yield source.error(reason, ("vehicles", index, field))


def unfit_classes(
    source: Source, classes: Sequence[VehicleClass], on_file: Mapping[str, Sequence[VehicleRecord]]
) -> Iterator[InputError]:
    """Yield what is wrong with classes to which vehicles on file do not belong.

    Args:
        on_file: By code of the class, its vehicles that are not entered.
    """
    for index, one in enumerate(classes):
        for vehicle in on_file.get(one.code, ()):
            misfit = _misfit(vehicle, one)
            if misfit is not None:
                yield source.error(f"vehicle {vehicle.code!r} on file: {misfit[1]}", (_FIELD, index))


def _misfit(vehicle: VehicleRecord, known: VehicleClass) -> tuple[str, str] | None:
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


@dataclass(frozen=True, slots=True)
class RunningWheelset:
    """A wheelset, and the vehicle and class that it runs under once the records are entered."""

    wheelset: WheelsetRecord
    vehicle: str
    known: VehicleClass


def unfit_wheelsets(
    source: Source, running: Sequence[RunningWheelset], entries: Mapping[str, Sequence[str]]
) -> Iterator[InputError]:
    """Yield what is wrong with wheelsets whose radius is not one of their class, where an entry brings them together.

    Args:
        entries: By array of a registry file, in the order of what is entered: the serials of ``wheelsets``, those of
            ``mountings``, the codes of ``vehicles`` and of ``vehicle_classes``.
    """
    for one in running:
        radius, expected = one.wheelset.nominal_radius_m, one.known.parameters.nominal_radius
        location = _brought_by(one, entries)
        if location is None or abs(radius - expected) <= RADIUS_TOLERANCE * expected:
            continue
        reason = (
            f"{1e3 * radius:g} mm differs by more than {100 * RADIUS_TOLERANCE:g} % "
            f"from the {1e3 * expected:g} mm of class {one.known.code!r}"
        )
        of_file = location[0] == "wheelsets"
        yield source.error(reason if of_file else f"wheelset {one.wheelset.serial!r} on file: {reason}", location)


def _brought_by(one: RunningWheelset, entries: Mapping[str, Sequence[str]]) -> Location | None:
    """Return the place in the file that brings a wheelset and a class together; None where none does."""
    serial = one.wheelset.serial
    for name, key, field in (
        ("wheelsets", serial, ("nominal_radius_mm",)),
        ("mountings", serial, ("wheelset",)),
        ("vehicles", one.vehicle, ("vehicle_class",)),
        (_FIELD, one.known.code, ()),
    ):
        if key in entries[name]:
            return name, list(entries[name]).index(key), *field
    return None


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
