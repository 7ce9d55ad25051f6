"""The running sum of bin tables: one table in memory, however many are added."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.values.geometry import BinTable, FilledCells


@dataclass(slots=True)
class TableSum:
    """What has been added so far, the newest with weight 1.

    Adding and forgetting in turn gives the same bits as ``estimation.tables.bin_table.merge`` table by table.

    Attributes:
        empty: The table of the same parameters without samples.
    """

    empty: BinTable
    _weight: FloatArray = field(init=False)
    _lateral: FloatArray = field(init=False)
    _yaw: FloatArray = field(init=False)
    _samples: int = 0
    _windows: int = 0

    def __post_init__(self) -> None:
        self._weight, self._lateral, self._yaw = (
            array.copy() for array in (self.empty.weight, self.empty.lateral, self.empty.yaw)
        )

    def forget(self, weight: float) -> None:
        """Give what was added so far another weight.

        Args:
            weight: From 0 to 1; 1 changes nothing.
        """
        if weight != 1.0:
            for array in (self._weight, self._lateral, self._yaw):
                np.multiply(array, weight, out=array)

    def add(self, table: BinTable | FilledCells) -> None:
        """Add a table with weight 1.

        Args:
            table: Whole, or its filled cells.

        Raises:
            ValueError: It was made with other parameters.
        """
        if table.parameter_key != self.empty.parameter_key:
            both = f"{self.empty.parameter_key} and {table.parameter_key}"
            raise ValueError(f"bin tables of parameters {both} do not merge")
        sums = (self._weight, self._lateral, self._yaw)
        for whole, added in zip(sums, (table.weight, table.lateral, table.yaw), strict=True):
            if isinstance(table, FilledCells):
                whole.reshape(-1, *whole.shape[2:])[table.cells] += added
            else:
                np.add(whole, added, out=whole)
        self._samples += table.samples
        self._windows += table.windows

    def table(self) -> BinTable:
        """Return the sum."""
        return BinTable(
            parameter_key=self.empty.parameter_key,
            edges=self.empty.edges,
            weight=np.array(self._weight),
            lateral=np.array(self._lateral),
            yaw=np.array(self._yaw),
            samples=self._samples,
            windows=self._windows,
        )
