"""Linear effective conicity: one slope, R = R0 + 2 lambda (y - d), lambda the same at every amplitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.estimators.interface import CurveEstimate, EstimatorParameters
from estimation.estimators.series import SeriesState, added, empty, solved
from estimation.values.arrays import FloatArray
from estimation.values.motion import Motion

MILLIMETRE = 1e-3


@dataclass(frozen=True, slots=True)
class LinearConicity:
    """Least squares of one straight line."""

    name: str = "linear"
    title: str = "linear effective conicity"

    def init(self, parameters: EstimatorParameters) -> SeriesState:
        """Return the empty sums."""
        return empty(parameters, 2)

    def update(self, state: SeriesState, motion: Motion, weight: float = 1.0) -> SeriesState:
        """Return the state with ``motion`` added, ``weight`` times."""
        return added(state, motion, _line, weight)

    def result(self, state: SeriesState) -> CurveEstimate:
        """Return the straight line, its conicity at every amplitude inside the data."""
        return solved(state, _line, ridge=0.0)


def _line(x: FloatArray) -> FloatArray:
    return np.column_stack([np.ones(len(x)), x / MILLIMETRE])
