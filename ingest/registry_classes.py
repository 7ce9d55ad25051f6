"""Vehicle classes of a registry file, and whether vehicles and wheelsets belong to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, VehicleClass
from ingest.input_file import InputFile, Location
from ingest.registry_schema import ClassFileEntry
from ingest.vehicle_class_file import read_vehicle_class
from ingest.vehicle_class_schema import VehicleClassEntry

WHEELBASE_TOLERANCE = 0.05  # m, between two axle offsets of a bogie and its wheelbase
RADIUS_TOLERANCE = 0.15  # of the class's nominal radius: new and worn out wheels differ by less
_FIELD = "vehicle_classes"


def read_classes(file: InputFile, count: int) -> tuple[VehicleClass, ...]:
    """Return the classes of a registry file, those in files of their own included.

    Parameters
    ----------
    file
        The registry file.
    count
        Of the entries of ``vehicle_classes``.

    Raises
    ------
    InputError
        An entry or a file is wrong, or two have the same code.
    """
    found: list[VehicleClass] = []
    for index in range(count):
        one = _class(file, (_FIELD, index))
        if any(one.code == other.code for other in found):
            raise file.error(f"there are two classes {one.code!r}", (_FIELD, index))
        found.append(one)
    return tuple(found)


def _class(file: InputFile, location: Location) -> VehicleClass:
    if "file" in file.at(location):
        name = file.parse(ClassFileEntry, location).file
        return read_vehicle_class(file.path.parent / name)
    return file.parse(VehicleClassEntry, location).record()


def check_vehicles(file: InputFile, vehicles: Sequence[VehicleRecord], classes: Mapping[str, VehicleClass]) -> None:
    """Refuse vehicles whose axles are not those of their class.

    Parameters
    ----------
    file
        The registry file.
    vehicles
        Of the file, in its order.
    classes
        Known classes by code; a vehicle of another is not checked.

    Raises
    ------
    InputError
        A vehicle on bogies has an odd number of axles, or two axles of a bogie are not its wheelbase apart.
    """
    for index, vehicle in enumerate(vehicles):
        known = classes.get(vehicle.vehicle_class)
        misfit = None if known is None else _misfit(vehicle, known)
        if misfit is not None:
            field, reason = misfit
            raise file.error(reason, ("vehicles", index, field))


def check_classes(
    file: InputFile, classes: Sequence[VehicleClass], on_file: Mapping[str, Sequence[VehicleRecord]]
) -> None:
    """Refuse classes to which vehicles on file do not belong.

    Parameters
    ----------
    file
        The registry file.
    classes
        Of the file, in its order.
    on_file
        By code of the class, its vehicles that the file does not change.

    Raises
    ------
    InputError
        As ``check_vehicles``.
    """
    for index, one in enumerate(classes):
        for vehicle in on_file.get(one.code, ()):
            misfit = _misfit(vehicle, one)
            if misfit is not None:
                raise file.error(f"vehicle {vehicle.code!r} on file: {misfit[1]}", (_FIELD, index))


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


@dataclass(frozen=True, slots=True)
class RunningWheelset:
    """A wheelset, and the vehicle and class that it runs under once the file is loaded."""

    wheelset: WheelsetRecord
    vehicle: str
    known: VehicleClass


def check_wheelsets(file: InputFile, running: Sequence[RunningWheelset], entries: Mapping[str, Sequence[str]]) -> None:
    """Refuse wheelsets whose radius is not one of the class of their vehicle, where the file brings them together.

    Parameters
    ----------
    file
        The registry file.
    running
        Wheelsets whose class is known.
    entries
        By array of the file, in its order: the serials of ``wheelsets``, those of ``mountings``, the codes of
        ``vehicles`` and of ``vehicle_classes``.

    Raises
    ------
    InputError
        A nominal radius is too far from that of the class.
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
        raise file.error(reason if of_file else f"wheelset {one.wheelset.serial!r} on file: {reason}", location)


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
