"""The exact sum of bin tables: fixed-point numbers of 128 bits (``estimation.tables.exact_sum``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.values.arrays import FloatArray, IntArray
from estimation.values.geometry import BinTable
from estimation.values.roll_up import Member, RollUp

UnsignedArray = npt.NDArray[np.uint64]
HALF = 64  # bits of each of the two words


@dataclass(frozen=True, slots=True)
class ExactTable:
    """The sum of bin tables as fixed-point numbers, cells by columns: weight, lateral and yaw moments side by side.

    A number is ``(upper * 2^64 + lower) * 2^exponent``.
    """

    parameter_key: str
    edges: FloatArray  # (b + 1,) m
    groups: int
    lateral: int  # columns of the lateral equation
    exponent: int
    upper: IntArray  # (g b, 1 + q + r)
    lower: UnsignedArray  # (g b, 1 + q + r)
    samples: int = 0
    windows: int = 0

    def table(self) -> BinTable:
        """Return the sum, rounded to floating point."""
        values = _rounded(self.upper, self.lower, self.exponent)
        shape = (self.groups, len(self.edges) - 1)
        return BinTable(
            parameter_key=self.parameter_key,
            edges=self.edges,
            weight=values[:, 0].reshape(shape),
            lateral=values[:, 1 : 1 + self.lateral].reshape(*shape, -1),
            yaw=values[:, 1 + self.lateral :].reshape(*shape, -1),
            samples=self.samples,
            windows=self.windows,
        )


@dataclass(frozen=True, slots=True)
class RolledPart:
    """A roll-up with its sums; ``before`` is the digest of its content as it was read."""

    roll_up: RollUp
    before: str
    plain: ExactTable
    forgetting: ExactTable
    added: tuple[Member, ...]


def _rounded(upper: IntArray, lower: UnsignedArray, exponent: int) -> FloatArray:
    """Return the numbers of both words in floating point."""
    negative = upper < 0
    high = np.where(negative, -upper - (lower != 0), upper)
    low = np.where(negative, ~lower + np.uint64(1), lower)
    size = np.ldexp(high.astype(np.float64), exponent + HALF) + np.ldexp(low.astype(np.float64), exponent)
    return np.asarray(np.where(negative, -size, size))
