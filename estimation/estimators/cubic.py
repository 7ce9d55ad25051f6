"""Piecewise cubic polynomial least squares: R as a cubic in every piece of y - d, twice continuously differentiable.

After Charles, Goodall and Dixon (2008), who fit the conicity so; here on uniform cubic B-splines, which span exactly
the piecewise cubics that join without a step in value, slope or curvature.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from estimation.errors import ParameterError
from estimation.estimators.coverage import REACH
from estimation.estimators.interface import CurveEstimate, EstimatorParameters
from estimation.estimators.series import SeriesState, added, empty, solved
from estimation.values.arrays import FloatArray
from estimation.values.motion import Motion


@dataclass(frozen=True, slots=True)
class CubicFit:
    """Least squares of a piecewise cubic with pieces of ``piece`` m."""

    piece: float = 1e-3  # m
    name: str = "cubic"
    title: str = "piecewise cubic least squares"

    def __post_init__(self) -> None:
        if not 0 < self.piece <= REACH:
            raise ParameterError(f"{self.piece!r} m is outside 0 to {REACH} m", field="piece")

    def init(self, parameters: EstimatorParameters) -> SeriesState:
        """Return the empty sums."""
        return empty(parameters, self._pieces + 3)

    def update(self, state: SeriesState, motion: Motion, weight: float = 1.0) -> SeriesState:
        """Return the state with ``motion`` added, ``weight`` times."""
        return added(state, motion, self._basis, weight)

    def result(self, state: SeriesState) -> CurveEstimate:
        """Return the piecewise cubic where there are data."""
        return solved(state, self._basis, ridge=1e-9)

    @property
    def _pieces(self) -> int:
        return int(np.ceil(2 * REACH / self.piece))

    @property
    def _basis(self) -> partial[FloatArray]:
        return partial(b_splines, first=-0.5 * self._pieces * self.piece, piece=self.piece, pieces=self._pieces)


def b_splines(x: FloatArray, first: float, piece: float, pieces: int) -> FloatArray:
    """Return the uniform cubic B-splines (n, pieces + 3) at ``x``.

    Args:
        x: (n,) m, where to evaluate them; beyond the pieces the outermost are continued.
        first: Start of the first piece, m.
        piece: Length of a piece, m.
    """
    position = (x - first) / piece
    cell = np.clip(np.floor(position), 0, pieces - 1).astype(np.int64)
    u = position - cell
    weights = np.column_stack(
        [(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3],
    )
    values = np.zeros((len(x), pieces + 3))
    np.put_along_axis(values, cell[:, None] + np.arange(4), weights / 6.0, axis=1)
    return values
