"""A vehicle class as the registry has it: its value, which version it is, and its digest."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.vehicle_class import Arrangement, BogieParameters, SensorChannel, SensorLayout, VehicleClass

SHIPPED_VERSION = 0  # of a class that the package holds and the registry does not
_CHANNELS = ("lateral", "yaw", "roll", "mass_lateral")


@dataclass(frozen=True, slots=True)
class ClassOnFile:
    """A version of a vehicle class.

    Attributes:
        vehicle_class: Its value.
        version: From 1, as registered; ``SHIPPED_VERSION`` for a class of the package.
        recorded_ns: When this version was registered, ns UTC; None for a class of the package.
    """

    vehicle_class: VehicleClass
    version: int = SHIPPED_VERSION
    recorded_ns: int | None = None

    @property
    def digest(self) -> str:
        """Digest of the whole value."""
        return class_digest(self.vehicle_class)


def class_document(vehicle_class: VehicleClass) -> dict[str, Any]:
    """Return a class as JSON can hold it: a limit that is infinite is None."""
    document = asdict(vehicle_class)
    document["relative_std"] = dict(sorted(vehicle_class.relative_std.items()))
    for name in _CHANNELS:
        if math.isinf(document["sensors"][name]["limit"]):
            document["sensors"][name]["limit"] = None
    return document


def class_of_document(document: Mapping[str, Any]) -> VehicleClass:
    """Return the class that :func:`class_document` described.

    Args:
        document: As stored; a field that it does not have takes its default.

    Raises:
        ParameterError: A value is impossible.
        TypeError: A field is unknown, or one without default is missing.
    """
    bogie, sensors = document["bogie"], dict(document["sensors"])
    for name in _CHANNELS:
        limit = sensors[name]["limit"]
        sensors[name] = SensorChannel(**{**sensors[name], "limit": math.inf if limit is None else limit})
    return VehicleClass(
        **{
            **document,
            "arrangement": Arrangement(document["arrangement"]),
            "parameters": VehicleParameters(**document["parameters"]),
            "bogie": None if bogie is None else BogieParameters(**bogie),
            "sensors": SensorLayout(**sensors),
        }
    )


def same_motion(first: VehicleClass, second: VehicleClass) -> bool:
    """Return whether two classes turn a window into the same motion; their standard deviations may differ."""
    return all(
        getattr(first, name) == getattr(second, name) for name in ("arrangement", "parameters", "bogie", "sensors")
    )


def class_digest(vehicle_class: VehicleClass) -> str:
    """Return the digest of the whole value of a class."""
    text = json.dumps(class_document(vehicle_class), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
