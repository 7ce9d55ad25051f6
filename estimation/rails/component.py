"""Cells that wheelsets connect, at one amplitude, as the mixed model takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.rails.cell_table import CellTable
from estimation.rails.two_way import TwoWay
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.rails import RailKey, WheelKey
from estimation.values.reasons import Reason

LEAST_CONICITY = 1e-3  # to which an error may be in proportion


@dataclass(frozen=True, slots=True, eq=False)
class Component:
    """Cells that are connected, at one amplitude."""

    table: CellTable  # of all cells
    cells: IntArray  # (n,) numbers of those that are connected
    k: int  # number of the amplitude
    wheel: IntArray  # (w,) numbers of its wheels, in the order in which they are solved
    rail: IntArray  # (s,) numbers of its rails likewise
    two_way: TwoWay
    level_open: Reason  # what is said where nothing holds the level

    @property
    def wheels(self) -> list[WheelKey]:
        """The wheels, in the order in which they are solved."""
        return [self.table.wheels[place] for place in self.wheel]

    @property
    def rails(self) -> list[RailKey]:
        """The rails, in the order in which they are solved."""
        return [self.table.rails[place] for place in self.rail]

    @property
    def shared(self) -> float:
        """What is systematic in all cells, relative: the median of what is not the scale of the section."""
        conicity = np.maximum(np.abs(self.table.conicity[self.cells, self.k]), LEAST_CONICITY)
        relative = self.table.systematic[self.cells, self.k] / conicity
        return float(np.median(np.sqrt(np.maximum(relative**2 - self.table.scale[self.cells] ** 2, 0.0))))

    def by_rail(self, values: FloatArray) -> FloatArray:
        """Return the mean (s,) of what belongs to cells (n,), over those of each of the rails."""
        rail, s = self.two_way.rail, len(self.rail)
        return np.bincount(rail, values, minlength=s) / np.bincount(rail, minlength=s)


def component(
    table: CellTable,
    cells: IntArray,
    k: int,
    known: tuple[FloatArray, FloatArray],
    known_rails: frozenset[RailKey],
    level_open: Reason,
) -> Component:
    """Return connected cells with what is known of their wheels and rails.

    Args:
        cells: (n,) numbers of those that are connected.
        known: Conicity (w,) of all wheels of the table, NaN where not known, and its standard deviation (w,).
        level_open: What is said where nothing holds the level.
    """
    wheel, of_wheel = np.unique(table.wheel[cells], return_inverse=True)
    rail, of_rail = np.unique(table.rail[cells], return_inverse=True)
    value, std = known
    two_way = TwoWay(
        wheel=of_wheel,
        rail=of_rail,
        value=table.conicity[cells, k],
        variance=table.sampled[cells, k] ** 2,
        known_rail=np.array([table.rails[place] in known_rails for place in rail], np.bool_),
        known_value=value[wheel],
        known_variance=std[wheel] ** 2,
    )
    return Component(table, cells, k, wheel, rail, two_way, level_open)
