"""Rolling radius differences of the two wheelsets of a bogie, straight between even nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.bogie.parameters import BOGIE
from estimation.compiled import compiled
from estimation.values.arrays import FloatArray, FrozenArrays


def nodes() -> FloatArray:
    """Return the displacements (b,), m, of the nodes."""
    half = round(BOGIE.reach / BOGIE.node_step)
    return np.asarray(BOGIE.node_step * np.arange(-half, half + 1))


@dataclass(frozen=True, slots=True)
class Curves(FrozenArrays):
    """R = rL - rR of the leading and of the trailing wheelset at the nodes; beyond them straight on."""

    values: Annotated[FloatArray, 2, "b"]  # m

    @classmethod
    def straight(cls, conicity: float) -> Curves:
        """Return those of one conicity."""
        return cls(np.tile(2.0 * conicity * nodes(), (2, 1)))

    def slope(self, x: FloatArray) -> FloatArray:
        """Return the slopes (2, n) at displacements (2, n), m."""
        steps = np.diff(self.values, axis=1) / BOGIE.node_step
        piece = np.clip(((x - nodes()[0]) / BOGIE.node_step).astype(np.int64), 0, steps.shape[1] - 1)
        return np.take_along_axis(steps, piece, axis=1)


@compiled(nogil=True)
def look_up(values: FloatArray, x0: float, per_x: float, x: float) -> tuple[float, float]:
    """Return value and slope of a curve at ``x``, straight on beyond its ends."""
    at = (x - x0) * per_x
    i = min(max(int(np.floor(at)), 0), len(values) - 2)
    step = values[i + 1] - values[i]
    return values[i] + (at - i) * step, step * per_x


@compiled(nogil=True)
def add_hats(x: FloatArray, x0: float, per_x: float, cell: FloatArray, means: FloatArray) -> None:
    """Write the means (b, m) of hats at the nodes over cells along the run.

    ``cell`` (n,) holds where each sample is, in cells; the time between two samples is shared out between the cells
    that it touches, in proportion to the distance.
    """
    nodes = len(means)
    for i in range(len(x) - 1):
        middle = 0.5 * (x[i] + x[i + 1])
        at = min(max((middle - x0) * per_x, 0.0), nodes - 1.000001)
        j = int(at)
        up = at - j
        begin, end = cell[i], cell[i + 1]
        first = int(begin)
        while first < means.shape[1] and first < end:
            share = min(end, first + 1.0) - max(begin, float(first))
            means[j, first] += (1.0 - up) * share
            means[j + 1, first] += up * share
            first += 1


@compiled(nogil=True)
def add_means(rows: FloatArray, cell: FloatArray, means: FloatArray) -> None:
    """Write the means (r, m) of rows (r, n) over the same cells."""
    for r in range(len(rows)):
        for i in range(rows.shape[1] - 1):
            middle = 0.5 * (rows[r, i] + rows[r, i + 1])
            begin, end = cell[i], cell[i + 1]
            first = int(begin)
            while first < means.shape[1] and first < end:
                means[r, first] += middle * (min(end, first + 1.0) - max(begin, float(first)))
                first += 1
