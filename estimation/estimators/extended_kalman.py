"""Extended Kalman-Bucy filter whose state is augmented by a nonlinear conicity.

After Charles, Goodall and Dixon (2008), as the paper quotes them: the coefficients of a smooth R(y - d) are states that
do not change, beside the states of the wheelset. Here R is a cubic polynomial; each block of running is filtered by
itself (``block_filters``), the equations are those of ``filter_kernels``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from estimation.estimators import filter_kernels as kernels
from estimation.estimators.block_filters import FilterState, Inputs, Posterior, Prior, filtered, solved, start
from estimation.estimators.interface import CurveEstimate, EstimatorParameters
from estimation.values.arrays import FloatArray
from estimation.values.windows import Motion
from estimation.vehicle.equations_of_motion import VehicleParameters

PRIOR = Prior(np.array([0.0, 0.3e-3, 0.0, 0.0]), np.array([1e-3, 0.3e-3, 0.05e-3, 0.03e-3]))  # m, of powers of mm


@dataclass(frozen=True, slots=True)
class ExtendedKalman:
    """Cubic polynomial as augmented state; too far from a motion, it says that it has diverged."""

    name: str = "extended_kalman"
    title: str = "extended Kalman-Bucy filter"

    def init(self, parameters: EstimatorParameters) -> FilterState:
        """Return the state before any block."""
        return start(parameters, len(PRIOR.mean))

    def update(self, state: FilterState, motion: Motion, weight: float = 1.0) -> FilterState:
        """Return the state with the blocks of ``motion`` filtered and added, ``weight`` times."""
        run = partial(_filtered, state.series.parameters.vehicle)
        return filtered(state, motion, _powers, PRIOR, run, weight)

    def result(self, state: FilterState) -> CurveEstimate:
        """Return the polynomial that all blocks tell."""
        return solved(state, _powers, PRIOR)


def _powers(x: FloatArray) -> FloatArray:
    return np.vander(x / kernels.MILLIMETRE, len(PRIOR.mean), increasing=True)


def _filtered(vehicle: VehicleParameters, inputs: Inputs, noise: float) -> Posterior:
    """Return what a block tells of the coefficients."""
    mean = np.concatenate([[0.0, 0.0], PRIOR.mean])
    P = np.diag(np.concatenate([[1.0, 1.0], PRIOR.std]) ** 2)
    lever = 2 * vehicle.half_contact_distance * vehicle.nominal_radius
    square = kernels.extended(*inputs, noise, lever, mean, P)
    return Posterior(mean[2:], 0.5 * (P + P.T)[2:, 2:], square)
