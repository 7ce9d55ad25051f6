"""Exact sums of bin tables: the same bits in any order, and what was added can be taken away again.

Floating-point addition depends on the order. The sums here are fixed-point numbers of 128 bits, whose addition does
not: a window that comes late costs itself and not its history, and the sum of parts is the sum of the whole. The unit
follows from the axle load, for every moment is a product of two forces or moments: 2^-44 N^2 at 66 to 131 kN. A sum may
grow to 2^82 N^2, where a window of a minute has at most 2^57.
"""

from __future__ import annotations

import math

import numpy as np

from estimation.compiled import compiled
from estimation.tables.bin_table import BinParameters
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.geometry import BinTable, FilledCells
from estimation.values.roll_up import HALF, ExactTable, UnsignedArray

BELOW_LOAD_SQUARED = 76  # powers of two by which the unit is below the square of the axle load
WORD = 2.0**HALF
LARGEST = 2.0**62  # of the upper word


class ExactSum:
    """A running exact sum, begun at ``start``; adding and taking away commute."""

    def __init__(self, start: ExactTable) -> None:
        self._start = start
        self._upper, self._lower = start.upper.copy(), start.lower.copy()
        self._samples, self._windows = start.samples, start.windows

    def add(self, cells: FilledCells, weight: float = 1.0) -> None:
        """Add a table times a weight.

        Args:
            weight: From 0; the product is rounded before it is added.

        Raises:
            ValueError: It was made with other parameters.
            OverflowError: A sum is beyond what the numbers hold.
        """
        self._put(cells, weight, take=False)

    def take(self, cells: FilledCells, weight: float = 1.0) -> None:
        """Take away what :meth:`add` added with the same arguments, to the last bit.

        Raises:
            ValueError: It was made with other parameters.
        """
        self._put(cells, weight, take=True)

    def _put(self, cells: FilledCells, weight: float, *, take: bool) -> None:
        if cells.parameter_key != self._start.parameter_key:
            both = f"{self._start.parameter_key} and {cells.parameter_key}"
            raise ValueError(f"bin tables of parameters {both} do not merge")
        rows = np.column_stack([cells.weight, cells.lateral, cells.yaw]) * (-weight if take else weight)
        scale = 2.0 ** (-self._start.exponent - HALF)
        if not _add(self._upper, self._lower, cells.cells, rows, scale):
            raise OverflowError(f"the sum of bin tables {cells.parameter_key} is beyond 128 bits, or not finite")
        self._samples += -cells.samples if take else cells.samples
        self._windows += -cells.windows if take else cells.windows

    def result(self) -> ExactTable:
        """Return the sum as it is now."""
        start = self._start
        return ExactTable(
            parameter_key=start.parameter_key,
            edges=start.edges,
            groups=start.groups,
            lateral=start.lateral,
            exponent=start.exponent,
            upper=self._upper.copy(),
            lower=self._lower.copy(),
            samples=self._samples,
            windows=self._windows,
        )


def nothing(empty: BinTable, parameters: BinParameters) -> ExactTable:
    """Return the sum of no table.

    Args:
        empty: The table of the parameters without samples.
        parameters: Whose axle load sets the unit.
    """
    groups, bins = empty.weight.shape
    columns = 1 + empty.lateral.shape[2] + empty.yaw.shape[2]
    return ExactTable(
        parameter_key=empty.parameter_key,
        edges=empty.edges,
        groups=groups,
        lateral=empty.lateral.shape[2],
        exponent=2 * math.floor(math.log2(parameters.vehicle.axle_load)) - BELOW_LOAD_SQUARED,
        upper=np.zeros((groups * bins, columns), dtype=np.int64),
        lower=np.zeros((groups * bins, columns), dtype=np.uint64),
    )


@compiled(nogil=True)
def _add(upper: IntArray, lower: UnsignedArray, cells: IntArray, rows: FloatArray, scale: float) -> bool:
    """Add rows (k, c) to the cells named, each rounded towards zero; return whether all sums can be held."""
    for k in range(len(cells)):
        at = cells[k]
        for j in range(rows.shape[1]):
            value = rows[k, j]
            scaled = abs(value) * scale
            if not scaled < LARGEST:
                return False
            whole = np.floor(scaled)
            high, low = np.int64(whole), np.uint64((scaled - whole) * WORD)
            if value < 0.0:  # two's complement
                low = np.uint64(0) - low
                high = -high - (1 if low != 0 else 0)
            total = lower[at, j] + low
            upper[at, j] += high + (1 if total < low else 0)
            lower[at, j] = total
            if abs(upper[at, j]) >= LARGEST:
                return False
    return True
