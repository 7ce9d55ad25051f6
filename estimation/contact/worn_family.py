"""How conicity goes on with amplitude: the curves of design pairs, new and worn, at several gauges.

Each row is one wheelset on one track: a wheel of a standard on a rail of a standard, hollow and flange worn to some
depth in one of three forms, at one gauge or blurred over several. The rows are computed once and kept in
``worn_family.npy``; ``python -m bench.worn_family`` writes them again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files

import numpy as np

from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.table import ContactMethod
from estimation.contact.wear import TreadWear, worn
from estimation.values.arrays import FloatArray, IntArray, frozen_array

TABLE = "worn_family.npy"
UNIT = 1e-4  # of a stored conicity
AMPLITUDES: FloatArray = np.arange(2, 13, dtype=np.float64) * 0.25e-3  # m
GAUGES = (-1e-3, 0.0, 1e-3, 3e-3)  # m, deviation from 1435 mm
SINGLE_GAUGES = (0, 1, 3)
BLURRED = ((0, 1, 2), (0.25, 0.5, 0.25))  # which gauges, and their shares
DISPLACEMENT = np.arange(-75, 76) * 1e-4  # m
DEPTHS = np.arange(9) * 0.25e-3  # m
USUAL_CONICITY = (0.02, 0.8)  # at 3 mm; what is outside is no wheelset in service
MOST_CONICITY = 1.2  # at any amplitude
WHEELS = (  # with centre and half width of the hollow, m
    ("P8", 3e-3, 44e-3),
    ("S1002", 4e-3, 33e-3),
    ("EN13715-1/40/h28/e32.5", 3e-3, 38e-3),
    ("EN13715-S1002/h30/e29", 4e-3, 36e-3),
)
RAILS = (  # with the inclinations they are laid at
    ("56E1", (20,)),
    ("60E1", (20, 40)),
    ("60E2", (40,)),
    ("54E1", (20,)),
    ("49E1", (40,)),
    ("49E5", (40,)),
    ("46E1", (20,)),
    ("50E1", (20, 40)),
)


@dataclass(frozen=True, slots=True)
class Pair:
    """A design wheel on a design rail, and where its hollow forms."""

    wheel: str
    rail: str
    inclination: int  # 1 : inclination
    centre: float  # m
    half_width: float  # m


PAIRS = tuple(
    Pair(wheel, rail, inclination, centre, half_width)
    for wheel, centre, half_width in WHEELS
    for rail, inclinations in RAILS
    for inclination in inclinations
)


@dataclass(frozen=True, slots=True)
class WornFamily:
    """Conicities of many wheelsets by amplitude."""

    amplitude: FloatArray  # (a,) m
    conicity: FloatArray  # (m, a)
    pair: IntArray  # (m,) index into ``PAIRS``

    def __post_init__(self) -> None:
        m, a = self.conicity.shape
        object.__setattr__(self, "amplitude", frozen_array(self.amplitude, (a,), name="amplitude"))
        object.__setattr__(self, "conicity", frozen_array(self.conicity, (m, a), name="conicity"))
        object.__setattr__(self, "pair", frozen_array(self.pair, (m,), np.int64, name="pair"))

    def without(self, pair: int) -> WornFamily:
        """Return the family without one of its pairs.

        Parameters
        ----------
        pair
            Index into ``PAIRS``.
        """
        others = self.pair != pair
        return WornFamily(self.amplitude, self.conicity[others], self.pair[others])


def conicities_of(pair: Pair) -> FloatArray:
    """Return the conicities (m, a) of a pair, new and worn, at ``AMPLITUDES``, as far as they are usual in service.

    Parameters
    ----------
    pair
        Design profiles.
    """
    wheel, rail = wheel_profile(pair.wheel), rail_profile(pair.rail)
    found = []
    for left, right in _wear(pair):
        sides = worn(wheel, left), worn(wheel, right)
        on_track = WheelsetOnTrack(*sides, rail, rail, 1.0 / pair.inclination, 1.435)
        table = contact_table(on_track, DISPLACEMENT, GAUGES, method=ContactMethod.EN15302, outside="hold")
        difference = table.rolling_radius_difference
        curves = [difference[:, k] for k in SINGLE_GAUGES]
        curves.append(difference[:, BLURRED[0]] @ np.array(BLURRED[1]))
        found += [equivalent_conicity(DISPLACEMENT, curve, AMPLITUDES) for curve in curves]
    rows = np.array(found)
    low, high = USUAL_CONICITY
    with np.errstate(invalid="ignore"):
        usual = (rows[:, -1] >= low) & (rows[:, -1] <= high) & (rows.max(axis=1) <= MOST_CONICITY)
    return np.asarray(rows[usual])


def _wear(pair: Pair) -> Iterator[tuple[TreadWear, TreadWear]]:
    """Yield the wear of the left and the right wheel: both alike, one less than the other, and a narrower hollow."""
    for step, depth in enumerate(DEPTHS):
        usual = TreadWear(depth, pair.centre, pair.half_width, depth)
        yield usual, usual
        if step and step % 2 == 0:
            yield usual, TreadWear(0.6 * depth, pair.centre, pair.half_width, 0.6 * depth)
            narrow = TreadWear(depth, pair.centre - 2e-3, 0.8 * pair.half_width, 0.5 * depth)
            yield narrow, narrow


@cache
def worn_family() -> WornFamily:
    """Return all pairs, as they are kept beside this module."""
    with as_file(files("estimation.contact") / TABLE) as path:
        stored = np.load(path, allow_pickle=False)
    return WornFamily(AMPLITUDES, np.asarray(stored[:, 1:] * UNIT), stored[:, 0].astype(np.int64))
