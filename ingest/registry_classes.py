"""Vehicle classes of a registry file."""

from __future__ import annotations

from estimation.errors import ParameterError
from estimation.vehicle.class_on_file import class_of_document
from estimation.vehicle.vehicle_class import VehicleClass
from ingest.input_file import InputFile, Location
from ingest.registry_schema import ClassFileEntry, RecordedClassEntry
from ingest.vehicle_class_file import read_vehicle_class
from ingest.vehicle_class_schema import VehicleClassEntry

_FIELD = "vehicle_classes"


def read_classes(file: InputFile, count: int) -> tuple[VehicleClass, ...]:
    """Return the classes of a registry file, those in files of their own included.

    Args:
        count: Of the entries of ``vehicle_classes``.

    Raises:
        InputError: An entry or a file is wrong, or two have the same code.
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
    if "recorded" in file.at(location):
        return _recorded(file, location)
    return file.parse(VehicleClassEntry, location).record()


def _recorded(file: InputFile, location: Location) -> VehicleClass:
    document = file.parse(RecordedClassEntry, location).recorded
    try:
        return class_of_document(document)
    except (KeyError, TypeError, ValueError, AttributeError, ParameterError) as error:
        raise file.error(f"is no vehicle class as an export has it: {error}", (*location, "recorded")) from error
