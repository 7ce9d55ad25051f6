"""Units of signals that come from outside: what each measures, and its factor to SI."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from estimation.errors import ParameterError

STANDARD_GRAVITY = 9.80665  # m/s2, the unit g of accelerometers (ISO 80000-3)


class Quantity(StrEnum):
    """What a unit measures."""

    TIME = "time"
    LENGTH = "length"
    SPEED = "speed"
    ACCELERATION = "acceleration"
    ANGLE = "angle"
    ANGULAR_RATE = "angular rate"
    ANGULAR_ACCELERATION = "angular acceleration"
    NUMBER = "number"


DERIVATIVES: Mapping[Quantity, int] = MappingProxyType(
    {Quantity.ANGULAR_ACCELERATION: 0, Quantity.ANGULAR_RATE: 1, Quantity.ANGLE: 2}
)
"""How often a signal must be differentiated to be an angular acceleration."""


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit: ``value in SI = value * factor``."""

    quantity: Quantity
    factor: float


_DEGREE = math.pi / 180.0

UNITS: Mapping[str, Unit] = MappingProxyType(
    {
        "s": Unit(Quantity.TIME, 1.0),
        "ms": Unit(Quantity.TIME, 1e-3),
        "us": Unit(Quantity.TIME, 1e-6),
        "ns": Unit(Quantity.TIME, 1e-9),
        "min": Unit(Quantity.TIME, 60.0),
        "d": Unit(Quantity.TIME, 86_400.0),
        "m": Unit(Quantity.LENGTH, 1.0),
        "mm": Unit(Quantity.LENGTH, 1e-3),
        "cm": Unit(Quantity.LENGTH, 1e-2),
        "km": Unit(Quantity.LENGTH, 1e3),
        "m/s": Unit(Quantity.SPEED, 1.0),
        "mm/s": Unit(Quantity.SPEED, 1e-3),
        "km/h": Unit(Quantity.SPEED, 1.0 / 3.6),
        "mph": Unit(Quantity.SPEED, 0.44704),
        "m/s2": Unit(Quantity.ACCELERATION, 1.0),
        "mm/s2": Unit(Quantity.ACCELERATION, 1e-3),
        "g": Unit(Quantity.ACCELERATION, STANDARD_GRAVITY),
        "mg": Unit(Quantity.ACCELERATION, 1e-3 * STANDARD_GRAVITY),
        "rad": Unit(Quantity.ANGLE, 1.0),
        "mrad": Unit(Quantity.ANGLE, 1e-3),
        "deg": Unit(Quantity.ANGLE, _DEGREE),
        "rad/s": Unit(Quantity.ANGULAR_RATE, 1.0),
        "mrad/s": Unit(Quantity.ANGULAR_RATE, 1e-3),
        "deg/s": Unit(Quantity.ANGULAR_RATE, _DEGREE),
        "rad/s2": Unit(Quantity.ANGULAR_ACCELERATION, 1.0),
        "mrad/s2": Unit(Quantity.ANGULAR_ACCELERATION, 1e-3),
        "deg/s2": Unit(Quantity.ANGULAR_ACCELERATION, _DEGREE),
        "": Unit(Quantity.NUMBER, 1.0),
        "1": Unit(Quantity.NUMBER, 1.0),
        "%": Unit(Quantity.NUMBER, 1e-2),
    }
)

_SPELLINGS = {"°": "deg", "µ": "u", "μ": "u", "²": "2", "^": "", "*": "", "kph": "km/h", "kmh": "km/h", "dps": "deg/s"}
_PER_S_PER_S = re.compile(r"/\(?ss\)?$|/s/s$")


def unit_of(name: str, allowed: Iterable[Quantity]) -> Unit:
    """Return the unit of a name as files write it: ``m/s^2``, ``m/s²`` and ``m/s2`` are one."""
    quantities = tuple(allowed)
    plain = name.replace(" ", "")
    for written, meant in _SPELLINGS.items():
        plain = plain.replace(written, meant)
    unit = UNITS.get(_PER_S_PER_S.sub("/s2", plain))
    if unit is not None and unit.quantity in quantities:
        return unit
    known = ", ".join(repr(key) for key, item in UNITS.items() if item.quantity in quantities)
    problem = "is no known unit" if unit is None else f"is a unit of {unit.quantity}"
    wanted = " or ".join(quantities)
    raise ParameterError(f"{name!r} {problem}; {'an' if wanted[0] in 'aeiou' else 'a'} {wanted} is in {known}")
