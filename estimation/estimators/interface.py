"""The interface of every estimator of a wheelset's geometry: init, update, result over frozen values.

An estimator gets what is assumed of the vehicle, then the motion of one wheelset relative to the track, window by
window. At any time it gives the curve rL - rR over y - d, and what follows from it, each with its interval. How it
gets there (sums, mean and covariance of a filter, particles) is its own, in its own ``State``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Protocol, TypeVar

from estimation.geometry.conicity import CurveParameters
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.arrays import FloatArray, FrozenArrays
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
    own_std: Annotated[FloatArray, "k"] | None = (
        None  # of the conicity, by the covariance that the estimator itself states
    )


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
            motion: Motion of the wheelset relative to the track over one window, band-limited where it was measured.
            weight: Above 0, at most 1: how much the samples of ``motion`` count beside those of weight 1. The current
                geometry forgets by mileage so: half the weight after each half-life. An estimator that cannot weight
                ignores it, and its current geometry forgets nothing; its docstring states that.
        """

    def result(self, state: State) -> CurveEstimate:
        """Return the curve and what follows from it."""
