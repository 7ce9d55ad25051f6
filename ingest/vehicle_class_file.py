"""Vehicle class files: a TOML file in, a vehicle class out; and the classes that the package ships."""

from __future__ import annotations

from functools import cache
from importlib import resources
from pathlib import Path
from typing import Literal

from estimation.errors import InputError, NotFoundError
from estimation.vehicle.vehicle_class import VehicleClass
from ingest.input_file import InputFile, read_toml
from ingest.vehicle_class_schema import VehicleClassEntry

FORMAT = "treadwatch-vehicle-class-1"
_SHIPPED = resources.files(__package__) / "vehicle_classes"


class VehicleClassFile(VehicleClassEntry):
    """The whole file."""

    format: Literal["treadwatch-vehicle-class-1"]


def read_vehicle_class(path: Path, error_type: type[InputError] = InputError) -> VehicleClass:
    """Return the class of a file.

    Raises:
        InputError: As ``error_type``: the file cannot be read, or something in it is wrong; names file, line and field.
    """
    return parse_vehicle_class(read_toml(path, error_type))


def parse_vehicle_class(file: InputFile) -> VehicleClass:
    """Return the class of a file that was read."""
    return file.parse(VehicleClassFile).record()


def shipped_classes() -> tuple[str, ...]:
    """Return the codes of the classes that the package ships, sorted."""
    return tuple(sorted(item.name.removesuffix(".toml") for item in _SHIPPED.iterdir() if item.name.endswith(".toml")))


def shipped_path(code: str) -> Path:
    """Return the file of a class that the package ships."""
    if code not in shipped_classes():
        raise NotFoundError("shipped vehicle class", code)
    return Path(str(_SHIPPED / f"{code}.toml"))


@cache
def class_of_package(code: str) -> VehicleClass | None:
    """Return a class that the package ships; None where it ships none of this code."""
    return shipped_class(code) if code in shipped_classes() else None


def shipped_class(code: str) -> VehicleClass:
    """Return a class that the package ships."""
    return read_vehicle_class(shipped_path(code))
