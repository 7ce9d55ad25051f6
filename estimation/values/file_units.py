"""How the fields of a frozen value are called in files, and in which unit they stand there."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FileUnit:
    """A unit of files: the key of a field ends with ``suffix``, and ``value = number * factor / divisor``."""

    suffix: str
    factor: float = 1.0
    divisor: float = 1.0

    def read(self, number: float) -> float:
        """Return the value of a number of a file."""
        return number * self.factor / self.divisor


@dataclass(frozen=True, slots=True)
class Key:
    """The key of a field in files, where it is not the name of the field and its unit; None: no file has it."""

    name: str | None


M, S, N, KG = FileUnit("_m"), FileUnit("_s"), FileUnit("_n"), FileUnit("_kg")
MM, KM = FileUnit("_mm", 1e-3), FileUnit("_km", 1e3)
US, MS, MINUTES = FileUnit("_us", 1e-6), FileUnit("_ms", 1e-3), FileUnit("_minutes", 60.0)
M_S, KM_H, M_S2 = FileUnit("_m_s"), FileUnit("_km_h", 1.0 / 3.6), FileUnit("_m_s2")
PERCENT = FileUnit("_percent", divisor=100.0)
DEG = FileUnit("_deg")
