"""How a field of a frozen value is served outside, and how it stands in files: its class is the only description."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from estimation.values.units import IN_MM, KM_H_IN_M_S


@dataclass(frozen=True, slots=True)
class Served:
    """Name, unit and words of a field, as metadata of its type."""

    text: str = ""  # for the reader of the API
    name: str = ""  # if not its own, or ``x_at`` for ``x_ns``, ``measured_from`` for ``from_ns``, ``_to`` for ``to_ns``
    scale: float = 1.0  # from the unit that the value has into the one that the name says
    example: object = None
    finite: bool = True  # where it need not be, null is served in place of NaN and infinity


def in_mm(text: str, name: str, example: object = None) -> Served:
    """Return how a length, m, that may not be known is served."""
    return Served(text, name, IN_MM, example, finite=False)


JsonValue = str | float | int | bool | None | list["JsonValue"] | dict[str, "JsonValue"]
NEAREST = 4  # neighbours of the quotient that are tried, either way


@dataclass(frozen=True, slots=True)
class FileUnit:
    """A unit of files: the key of a field ends with ``suffix``, and ``value = number * factor / divisor``."""

    suffix: str
    factor: float = 1.0
    divisor: float = 1.0

    def read(self, number: float) -> float:
        """Return the value of a number of a file."""
        return number * self.factor / self.divisor

    def write(self, value: float) -> float:
        """Return the number of a file that is read as a value, to the last bit where there is such a number."""
        tried = above = below = value * (self.divisor / self.factor)
        if self.read(tried) == value:
            return tried
        for _ in range(NEAREST):
            above, below = math.nextafter(above, math.inf), math.nextafter(below, -math.inf)
            for candidate in (above, below):
                if self.read(candidate) == value:
                    return candidate
        return tried


@dataclass(frozen=True, slots=True)
class Key:
    """The key of a field in files, where it is not the name of the field and its unit; None: no file has it."""

    name: str | None


@dataclass(frozen=True, slots=True)
class FileDefault:
    """What a field is where a file does not have it; whoever makes the value must say it."""

    value: object


class FileForm(Enum):
    """How a field stands in files that is no number, or no number there."""

    TEXT = "text"
    FREE_TEXT = "text that may be empty"
    CODE = "short text of one line"
    MOMENT = "time in ISO 8601; ns since 1970"
    CHOICE = "one of some words"


M, S = FileUnit("_m"), FileUnit("_s")
MM, KM = FileUnit("_mm", 1e-3), FileUnit("_km", 1e3)
US, MS, MINUTES = FileUnit("_us", 1e-6), FileUnit("_ms", 1e-3), FileUnit("_minutes", 60.0)
M_S, KM_H, M_S2 = FileUnit("_m_s"), FileUnit("_km_h", 1.0 / KM_H_IN_M_S), FileUnit("_m_s2")
PERCENT = FileUnit("_percent", divisor=100.0)
DEG = FileUnit("_deg")
