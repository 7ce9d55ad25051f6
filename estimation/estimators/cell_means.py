"""Means of R by cell of y - d and group of blocks: what the intervals of a curve without sums of its own rest on.

An estimator whose own covariance takes every residual for independent and every parameter for right gets from them by
how much its curve moves with a group of blocks left out or a parameter that is another, and what it cannot follow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from estimation.estimators.coverage import CELLS, REACH, WIDTH, beside, counted, usable
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.tables.bin_table import group_of
from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.motion import Motion
from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.regressors import YAW_TARGETS, regression

GROUPS = 16
MIDDLES = frozen_array((np.arange(CELLS) + 0.5) * WIDTH - REACH, (CELLS,), name="middles")  # m


@dataclass(frozen=True, slots=True)
class CellMeans:
    """Weighted sums over samples; they add up in any order."""

    sums: FloatArray  # (g, CELLS) m, of R
    counts: FloatArray  # (g, CELLS)
    derivatives: FloatArray  # (6, CELLS) m, of the derivatives of R by the logarithms of the parameters

    def __post_init__(self) -> None:
        object.__setattr__(self, "sums", frozen_array(self.sums, (GROUPS, CELLS), name="sums"))
        object.__setattr__(self, "counts", frozen_array(self.counts, (GROUPS, CELLS), name="counts"))
        shape = (len(YAW_TARGETS) - 1, CELLS)
        object.__setattr__(self, "derivatives", frozen_array(self.derivatives, shape, name="derivatives"))

    @classmethod
    def empty(cls) -> Self:
        """Return the sums over no sample."""
        nothing = np.zeros((GROUPS, CELLS))
        return cls(nothing, nothing, np.zeros((len(YAW_TARGETS) - 1, CELLS)))

    def added(self, motion: Motion, vehicle: VehicleParameters, weight: float) -> Self:
        """Return the sums with ``motion`` added.

        Args:
            motion: Motion of the wheelset relative to the track over one window.
            weight: Of every sample.
        """
        keep = usable(motion)
        equations = regression(motion, vehicle)
        R, x = equations.yaw_targets[keep] / equations.yaw[keep, -1:], motion.displacement[keep]
        groups = group_of(motion.block[keep], GROUPS)
        sums, counts = self.sums.copy(), self.counts.copy()
        for group in np.unique(groups):
            mine = groups == group
            sums[group] += weight * counted(x[mine], R[mine, 0])
            counts[group] += weight * counted(x[mine])
        derivatives = weight * np.array([counted(x, column) for column in R[:, 1:].T])
        return type(self)(sums, counts, self.derivatives + derivatives)

    def left_out(self, x: FloatArray) -> FloatArray:
        """Return by how much the means change without each group that has samples: (g', n), m.

        Args:
            x: (n,) m.
        """
        total, number = self.sums.sum(axis=0), self.counts.sum(axis=0)
        known = number > 0
        rows = []
        for g in np.flatnonzero(self.counts.any(axis=1)):
            rest = number - self.counts[g]
            kept = known & (rest > 0)
            change = (total - self.sums[g])[kept] / rest[kept] - total[kept] / number[kept]
            rows.append(np.interp(x, MIDDLES[kept], change) if kept.any() else np.zeros(len(x)))
        return np.array(rows).reshape(-1, len(x))

    def shifted(self, x: FloatArray, value: FloatArray, uncertainty: ParameterUncertainty) -> FloatArray:
        """Return what one std of each uncertain parameter changes, and what the curve cannot follow: (7, n), m.

        Args:
            x, value: (n,) m, the curve.
        """
        number = self.counts.sum(axis=0)
        known = number > 0
        means = self.derivatives[:, known] / number[known]
        rows = [std * np.interp(x, MIDDLES[known], row) for std, row in zip(uncertainty.yaw(), means, strict=True)]
        return np.array([*rows, beside(x, value, self.sums.sum(axis=0), number)])
