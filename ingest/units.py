"""Signals that come from outside: their units, and the derivative of those that are rates or angles.

The derivative belongs to the trapezoidal running integral: integrated again, it is what was measured. The exact inverse
of the trapezoidal rule, ``a[k+1] = 2 (r[k+1] - r[k]) / dt - a[k]``, never forgets its start and adds up noise at half
the sampling rate without bound. Here it is cut off there: with ``s = sin(w dt / 2)``, the running integral of the
derivative is the signal times ``1 - s^8``. At 250 Hz that is 1 within 6e-8 up to 10 Hz and within 0.3 % at 40 Hz, and 0
at 125 Hz. What a sample becomes depends on the four samples to either side and on nothing else, so that it does not
depend on how a recording was cut.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from types import MappingProxyType

import numpy as np

from estimation.errors import ParameterError
from estimation.values.arrays import BoolArray, FloatArray, IntArray

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

_FACTORS: Mapping[Quantity, Mapping[str, float]] = {
    Quantity.TIME: {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "d": 86_400.0},
    Quantity.LENGTH: {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3},
    Quantity.SPEED: {"m/s": 1.0, "mm/s": 1e-3, "km/h": 1.0 / 3.6, "mph": 0.44704},
    Quantity.ACCELERATION: {"m/s2": 1.0, "mm/s2": 1e-3, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY},
    Quantity.ANGLE: {"rad": 1.0, "mrad": 1e-3, "deg": _DEGREE},
    Quantity.ANGULAR_RATE: {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEGREE},
    Quantity.ANGULAR_ACCELERATION: {"rad/s2": 1.0, "mrad/s2": 1e-3, "deg/s2": _DEGREE},
    Quantity.NUMBER: {"": 1.0, "1": 1.0, "%": 1e-2},
}
UNITS: Mapping[str, Unit] = MappingProxyType(
    {name: Unit(quantity, factor) for quantity, factors in _FACTORS.items() for name, factor in factors.items()}
)

SENSOR_QUANTITIES: Mapping[str, tuple[Quantity, ...]] = {
    "lateral": (Quantity.ACCELERATION,),
    "yaw": tuple(DERIVATIVES),
    "roll": tuple(DERIVATIVES),
    "mass_lateral": (Quantity.ACCELERATION,),
    "speed": (Quantity.SPEED,),
}
"""What signals of a vehicle may measure, by their names here."""

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
    names = ", ".join(repr(key) for key, item in UNITS.items() if item.quantity in quantities)
    problem = "is no known unit" if unit is None else f"is a unit of {unit.quantity}"
    wanted = " or ".join(quantities)
    raise ParameterError(f"{name!r} {problem}; {'an' if wanted[0] in 'aeiou' else 'a'} {wanted} is in {names}")


REACH = 4  # samples to either side of a derivative


@cache
def kernel() -> FloatArray:
    """Return the weights (2 ``REACH`` + 1,) of a convolution, for a sampling interval of 1.

    ``2 j tan(w/2) (1 - s^(2 REACH))`` is ``j sin(w)``, the central difference, times the sum of ``s^(2 i)`` for
    i = 0 .. REACH - 1, and ``s^2`` is minus a quarter of the second difference.
    """
    power = np.array([1.0])
    total = np.zeros(2 * REACH - 1)
    for i in range(REACH):
        total[REACH - 1 - i : REACH + i] += power
        power = np.convolve(power, [-0.25, 0.5, -0.25])
    weights = np.convolve(total, [0.5, 0.0, -0.5])
    weights.flags.writeable = False
    return weights


def derivative(values: FloatArray, interval_s: float, times: int = 1) -> FloatArray:
    """Return the derivative (n,) of uniform samples; NaN where a sample in its reach is NaN or missing."""
    result = values
    for _ in range(times):
        padded = np.pad(result, REACH, constant_values=np.nan)
        result = np.convolve(padded, kernel() / interval_s, mode="valid")
    return np.asarray(result)


def derivative_with_gaps(
    tick: IntArray, values: FloatArray, interval_s: float, bridged: int, times: int = 1
) -> FloatArray:
    """Return the derivative (n,) at samples with gaps between them; NaN near to a gap that is not bridged.

    So many samples in a row may be missing or not valid: for the derivative of their neighbours a straight line stands
    for them. Their own derivative is NaN.
    """
    result = np.full(len(tick), np.nan)
    places = np.flatnonzero(~np.isnan(values))
    if len(places) == 0:
        return result
    breaks = np.flatnonzero(np.diff(tick[places]) > bridged + 1)
    for part in np.split(places, breaks + 1):
        grid = np.arange(tick[part[0]], tick[part[-1]] + 1)
        result[part] = derivative(np.interp(grid, tick[part], values[part]), interval_s, times)[tick[part] - grid[0]]
    return result


def clipped_reach(flags: BoolArray, times: int = 1) -> BoolArray:
    """Return which derivatives (n,) a flagged sample of the signal is part of."""
    return np.asarray(np.convolve(flags, np.ones(2 * REACH * times + 1, np.int64), mode="same") > 0)
