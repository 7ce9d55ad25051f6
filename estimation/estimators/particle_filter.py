"""Rao-Blackwellised particle filter of a linear conicity.

After Li, Goodall and others (2003 to 2006), as the paper quotes them: particles carry the parameter, a Kalman filter in
each the states that are linear once it is known. R = R0 + 2 lambda (y - d): particles over 2 lambda, a Kalman filter
over y - d, psi and R0. Each block of running is filtered by itself (``block_filters``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from estimation.errors import ParameterError
from estimation.estimators import filter_kernels as kernels
from estimation.estimators.block_filters import FilterState, Inputs, Posterior, Prior, filtered, solved, start
from estimation.estimators.interface import CurveEstimate, EstimatorParameters
from estimation.values.arrays import FloatArray
from estimation.values.windows import Motion
from estimation.vehicle.equations_of_motion import VehicleParameters

STEEPEST = 1.6  # of R per y - d that particles begin with: a conicity of 0.8
OFFSET_STD = 1e-3  # m
PRIOR = Prior(
    np.array([0.0, 0.5 * STEEPEST * kernels.MILLIMETRE]),
    np.array([OFFSET_STD, STEEPEST / np.sqrt(12.0) * kernels.MILLIMETRE]),
)
FEWEST = 16
ROWS = 64  # of numbers drawn, used in turn
SEED = 2003
SMALLEST = 1e-9  # of the variance of the slope, relative to the prior's: particles that are all alike


@dataclass(frozen=True, slots=True)
class ParticleFilter:
    """``particles`` over the conicity, the same for every amplitude."""

    particles: int = 48
    name: str = "particles"
    title: str = "Rao-Blackwellised particle filter"

    def __post_init__(self) -> None:
        if self.particles < FEWEST:
            raise ParameterError(f"{self.particles} particles; at least {FEWEST} are needed", field="particles")

    def init(self, parameters: EstimatorParameters) -> FilterState:
        """Return the state before any block."""
        return start(parameters, len(PRIOR.mean))

    def update(self, state: FilterState, motion: Motion, weight: float = 1.0) -> FilterState:
        """Return the state with the blocks of ``motion`` filtered and added, ``weight`` times."""
        vehicle = state.series.parameters.vehicle

        def run(inputs: Inputs, noise: float) -> Posterior:
            return _filtered(vehicle, inputs, noise, self.particles)

        return filtered(state, motion, _line, PRIOR, run, weight)

    def result(self, state: FilterState) -> CurveEstimate:
        """Return the straight line that all blocks tell."""
        return solved(state, _line, PRIOR)


def _line(x: FloatArray) -> FloatArray:
    return np.column_stack([np.ones(len(x)), x / kernels.MILLIMETRE])


@lru_cache
def _draws(particles: int) -> FloatArray:
    rng = np.random.default_rng(SEED)
    drawn = np.column_stack([rng.uniform(size=ROWS), rng.standard_normal((ROWS, particles))])
    drawn.flags.writeable = False
    return drawn


def _filtered(vehicle: VehicleParameters, inputs: Inputs, noise: float, particles: int) -> Posterior:
    """Return what a block tells of offset and slope."""
    slope = STEEPEST * (np.arange(particles) + 0.5) / particles
    mean = np.zeros((particles, 3))
    P = np.tile(np.diag([1.0, 1.0, OFFSET_STD**2]), (particles, 1, 1))
    lever = 2 * vehicle.half_contact_distance * vehicle.nominal_radius
    square = kernels.particles(*inputs, noise, lever, slope, mean, P, _draws(particles))
    found = np.column_stack([mean[:, 2], slope * kernels.MILLIMETRE])
    covariance = np.cov(found.T, bias=True) + np.diag([P[:, 2, 2].mean(), SMALLEST * PRIOR.std[1] ** 2])
    return Posterior(found.mean(axis=0), covariance, square)
