"""By how much the linear creep of vehicles differs from that of their class, from the level of their creep.

The level of a place is what e shows in proportion to q, whatever its shape. Half of the places of a section, at least,
are rails as rails are: over the places of a vehicle the median of what exceeds the creep of usual rails is its b, as
far as b is likely at all. The shape of e over q says nothing of b here: what alignment, curves, cross level and contact
jumps put into e has a shape, too, and quiet sensors would make it sure that a b of that shape, and rails of a tenth of
their friction, are there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.adhesion.pass_sums import PassSums
from estimation.values.arrays import BoolArray, FloatArray, IntArray, frozen_array

MEDIAN_ERROR = 1.2533  # std of a median over that of a mean
ROBUST = 1.4826  # std over median absolute deviation
TINY = np.finfo(float).tiny


@dataclass(frozen=True, slots=True)
class RailsBefore:
    """What is known beforehand of b and of the rails of a section."""

    usual: float  # 1/mu of half of the places
    level_std: float  # of it
    creep_error_std: float  # of b


@dataclass(frozen=True, slots=True)
class CreepLevels:
    """b of v vehicles, and the std that what all share leaves to it."""

    creep: FloatArray  # (v,)
    std: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "creep", frozen_array(self.creep, (len(self.creep),), name="creep"))


def creep_levels(sums: PassSums, slope: FloatArray, slippery: BoolArray, before: RailsBefore) -> CreepLevels:
    """Return b of the vehicles.

    Args:
        slope: (w,) a of the wheelsets.
        slippery: (c,) places that are no usual rails; a vehicle that has met them for the most part is held against all
            of its.
        before: What is known beforehand.
    """
    usual = sums.at(np.full(len(sums.cells), before.usual))[2]
    entry = sums.vehicle * len(sums.cells) + sums.place
    left = sums.squares[:, 1] - slope[sums.wheelset] * sums.squares[:, 4] - usual
    passed, index = np.unique(entry, return_inverse=True)
    square = _summed(sums.squares[:, 2], index, len(passed)) + TINY
    exceeds, expected = _summed(left, index, len(passed)) / square, _summed(usual, index, len(passed)) / square
    vehicle = passed // len(sums.cells)
    by_rails = before.level_std * float(np.median(expected)) / before.usual
    usual_rails = ~slippery[passed % len(sums.cells)]
    found = []
    for one in range(len(sums.vehicles)):
        of_vehicle = vehicle == one
        chosen = of_vehicle & usual_rails
        chosen = chosen if 2 * chosen.sum() >= of_vehicle.sum() else of_vehicle
        found.append(_shrunk(exceeds[chosen], by_rails, before.creep_error_std))
    return CreepLevels(np.array(found), float(1.0 / np.sqrt(before.creep_error_std**-2 + by_rails**-2)))


def _shrunk(exceeds: FloatArray, by_rails: float, likely: float) -> float:
    """Return the median of what places (p,) exceed the usual by, as far as a b of std ``likely`` is its cause."""
    middle = float(np.median(exceeds))
    spread = ROBUST * float(np.median(np.abs(exceeds - middle)))
    sampled = MEDIAN_ERROR * spread / np.sqrt(len(exceeds))
    return float(middle * likely**2 / (likely**2 + by_rails**2 + sampled**2))


def _summed(values: FloatArray, index: IntArray, count: int) -> FloatArray:
    return np.asarray(np.bincount(index, weights=values, minlength=count), np.float64)
