"""What every estimator of a wheelset's geometry is: init, update, result over frozen values.

An estimator is told what is assumed of the vehicle, then the motion of one wheelset relative to the track, stretch by
stretch, and says at any time what it makes of it: the curve rL - rR over y - d, and what follows from it, each with
its interval. How it gets there (sums, a filter's mean and covariance, particles) is its own, in its own ``State``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from estimation.geometry.conicity import CurveParameters
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.motion import Motion
from estimation.values.quantities import Estimate, Status
from estimation.vehicle.equations_of_motion import VehicleParameters


@dataclass(frozen=True, slots=True)
class EstimatorParameters:
    """What all estimators are told alike; what only one of them knows is a field of that one."""

    vehicle: VehicleParameters = field(default_factory=VehicleParameters)
    uncertainty: ParameterUncertainty = field(default_factory=ParameterUncertainty)
    curve: CurveParameters = field(default_factory=CurveParameters)  # at which amplitudes
    source: str = "ideal"  # what the motion came from
    band_limited: bool = False  # offsets of the motion carry no meaning


@dataclass(frozen=True, slots=True)
class CurveEstimate:
    """What an estimator says of a wheelset: R = rL - rR over y - d, and what follows; NaN where it says nothing."""

    displacement: FloatArray  # (n,) m, y - d, increasing
    difference: FloatArray  # (n,) m, R
    difference_std: FloatArray  # (n,) m
    amplitude: FloatArray  # (k,) m
    conicity: tuple[Estimate, ...]  # (k,) equivalent conicity
    nonlinearity: Estimate  # NP, 1/mm
    zero_crossing: Estimate  # m
    samples: int
    stretches: int  # of motion seen
    status: Status
    reason: str = ""

    def __post_init__(self) -> None:
        n, k = len(self.displacement), len(self.conicity)
        for name in ("displacement", "difference", "difference_std"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))
        object.__setattr__(self, "amplitude", frozen_array(self.amplitude, (k,), name="amplitude"))


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
        """Return the state that has seen nothing."""

    def update(self, state: State, motion: Motion) -> State:
        """Return the state that has seen ``motion`` as well; ``state`` is not touched."""

    def result(self, state: State) -> CurveEstimate:
        """Return what the state says."""


def run(estimator: Estimator[State], parameters: EstimatorParameters, motions: Iterable[Motion]) -> CurveEstimate:
    """Return what ``estimator`` makes of ``motions``, in their order."""
    state = estimator.init(parameters)
    for motion in motions:
        state = estimator.update(state, motion)
    return estimator.result(state)
