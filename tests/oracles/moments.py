"""Samples in, packed moments of cells out: what :mod:`estimation.tables.bin_table` solves, from any regressors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.compiled import compiled
from estimation.tables.bin_table import packed_size
from estimation.values.arrays import FloatArray, IntArray, frozen_array


@dataclass(frozen=True, slots=True)
class Moments:
    """Sufficient statistics of ``c`` cells (bins, or groups x bins)."""

    regressors: int
    targets: int
    packed: FloatArray  # (c, packed_size)
    weight: FloatArray  # (c,) number of samples

    def __post_init__(self) -> None:
        c = len(self.weight)
        size = packed_size(self.regressors, self.targets)
        object.__setattr__(self, "packed", frozen_array(self.packed, (c, size), name="packed"))
        object.__setattr__(self, "weight", frozen_array(self.weight, (c,), name="weight"))


@compiled(nogil=True)
def _collect(features: FloatArray, targets: FloatArray, cell: IntArray, packed: FloatArray, weight: FloatArray) -> None:
    n, p = features.shape
    t = targets.shape[1]
    for i in range(n):
        c = cell[i]
        if c < 0:
            continue
        row = packed[c]
        weight[c] += 1.0
        k = 0
        for a in range(p):
            xa = features[i, a]
            for b in range(a, p):
                row[k] += xa * features[i, b]
                k += 1
        for a in range(p):
            xa = features[i, a]
            for j in range(t):
                row[k] += xa * targets[i, j]
                k += 1
        row[k] += targets[i, 0] * targets[i, 0]


def collect(features: FloatArray, targets: FloatArray, cell: IntArray, cells: int) -> Moments:
    """Reduce samples to the moments of their cells, in one pass, in the order given.

    Args:
        features: (n, p) regressors.
        targets: (n, t) targets; column 0 is the measurement.
        cell: (n,) cell of each sample, 0..cells-1; negative: the sample belongs nowhere.
    """
    if not len(features) == len(targets) == len(cell):
        raise ValueError(f"lengths differ: {len(features)}, {len(targets)}, {len(cell)}")
    if len(cell) and int(cell.max()) >= cells:
        raise ValueError(f"cell {int(cell.max())} of {cells}")
    p, t = features.shape[1], targets.shape[1]
    packed = np.zeros((cells, packed_size(p, t)))
    weight = np.zeros(cells)
    _collect(
        np.ascontiguousarray(features, dtype=np.float64),
        np.ascontiguousarray(targets, dtype=np.float64),
        np.ascontiguousarray(cell, dtype=np.int64),
        packed,
        weight,
    )
    return Moments(p, t, packed, weight)
