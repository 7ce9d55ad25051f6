"""The interface of every estimator of a wheelset's geometry: init, update, result over frozen values.

An estimator gets what is assumed of the vehicle, then the motion of one wheelset relative to the track, window by
window. At any time it gives the curve rL - rR over y - d, and what follows from it, each with its interval. How it
gets there (sums, mean and covariance of a filter, particles) is its own, in its own ``State``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Protocol, TypeVar

import numpy as np

from estimation.geometry.conicity import CurveParameters
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason
from estimation.values.windows import Motion
from estimation.vehicle.equations_of_motion import VehicleParameters


@dataclass(frozen=True, slots=True)
class EstimatorParameters:
    """What all estimators share; what only one of them needs is a field of that one."""

    vehicle: VehicleParameters = field(default_factory=VehicleParameters)
    uncertainty: ParameterUncertainty = field(default_factory=ParameterUncertainty)
    curve: CurveParameters = field(default_factory=CurveParameters)  # at which amplitudes
    source: str = "ideal"  # what the motion came from
    band_limited: bool = False  # offsets of the motion carry no meaning


@dataclass(frozen=True, slots=True)
class CurveEstimate(FrozenArrays):
    """The result of an estimator: R = rL - rR over y - d, and what follows from it; NaN where it is not estimated."""

    displacement: Annotated[FloatArray, "n"]  # m, y - d, increasing
    difference: Annotated[FloatArray, "n"]  # m, R
    difference_std: Annotated[FloatArray, "n"]  # m
    amplitude: Annotated[FloatArray, "k"]  # m
    conicity: Annotated[tuple[Estimate, ...], "k"]  # equivalent conicity
    nonlinearity: Estimate  # NP, 1/mm
    zero_crossing: Estimate  # m
    samples: int
    stretches: int  # windows of motion added
    status: Status
    reason: Reason | None = None
    own_std: Annotated[FloatArray, "k"] | None = None  # of the conicity, by the covariance that it states itself


State = TypeVar("State")


class Estimator(Protocol[State]):
    """Three pure functions; ``State`` is a frozen value of the estimator's own, its parameters included."""

    @property
    def name(self) -> str:
        """One word for tables and files."""

    @property
    def title(self) -> str:
        """What it is, for people."""

    def init(self, parameters: EstimatorParameters) -> State:
        """Return the state before any motion."""

    def update(self, state: State, motion: Motion, weight: float = 1.0) -> State:
        """Return the state with ``motion`` added; ``state`` is not touched.

        Args:
            weight: Above 0, at most 1: how much the samples of ``motion`` count beside those of weight 1. The current
                geometry forgets by mileage so: half the weight after each half-life. An estimator that cannot weight
                ignores it, and its current geometry forgets nothing; its docstring states that.
        """

    def result(self, state: State) -> CurveEstimate:
        """Return the curve and what follows from it."""


WIDTH = 0.25e-3  # m
REACH = 7.0e-3  # m
CELLS = round(2 * REACH / WIDTH)
LEAST_SAMPLES = 100


def usable(motion: Motion) -> BoolArray:
    """Return the samples (n,) that an estimator may use."""
    return np.asarray(
        motion.valid & (motion.block >= 0) & np.isfinite(motion.displacement) & (np.abs(motion.displacement) < REACH)
    )


def counted(displacement: FloatArray, values: FloatArray | None = None) -> FloatArray:
    """Return the number of samples, or the sum of values, (CELLS,) in each cell of ``WIDTH`` over +-``REACH``.

    Args:
        displacement: (n,) m, within the reach.
        values: (n,) of any unit; None to count.
    """
    cell = np.floor((displacement + REACH) / WIDTH).astype(np.int64)
    return np.bincount(cell, values, minlength=CELLS).astype(np.float64)


def beside(x: FloatArray, value: FloatArray, sums: FloatArray, counts: FloatArray) -> FloatArray:
    """Return by how much the mean of each cell is above a curve, straight between cells: (n,).

    Args:
        x, value: (n,) m, the curve.
        sums, counts: (CELLS,) by cell.
    """
    middles = (np.arange(CELLS) + 0.5) * WIDTH - REACH
    known = (counts >= LEAST_SAMPLES) & (middles > x[0]) & (middles < x[-1])
    if not known.any():
        return np.zeros(len(x))
    apart = sums[known] / counts[known] - np.interp(middles[known], x, value)
    return np.asarray(np.interp(x, middles[known], apart))


def covered_range(counts: FloatArray) -> tuple[float, float] | None:
    """Return from where to where, m, every cell has ``LEAST_SAMPLES``, zero inside; None where there is no such run."""
    enough = counts >= LEAST_SAMPLES
    middle = CELLS // 2
    right = middle + int(np.argmin(np.append(enough[middle:], False)))
    left = middle - int(np.argmin(np.append(enough[:middle][::-1], False)))
    if middle in {left, right}:
        return None
    return left * WIDTH - REACH, right * WIDTH - REACH
