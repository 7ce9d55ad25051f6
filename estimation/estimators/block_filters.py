"""Estimators that filter each block of running by itself: what the blocks tell of some coefficients is added up.

Every block starts a filter from the same prior. What its posterior tells beyond the prior, precision and precision
times mean, adds up over blocks in any order, by weight, and with any group of blocks left out. So a filter has two
intervals: of its own covariance, and from groups of blocks left out, which is published.

A filter is tested by its innovations: their squares over their variances are 1 on average where the filter follows
(Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4). A block
where they are not, or where a covariance is no more one, has diverged and is left out; where too many have, nothing is
published.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from estimation.errors import ParameterError
from estimation.estimators import filter_kernels as kernels
from estimation.estimators.interface import (
    CurveEstimate,
    EstimatorParameters,
    Replicates,
    curve_estimate,
    nothing,
    usable,
)
from estimation.estimators.parameters import RIVALS
from estimation.estimators.series import SeriesState, added, empty, misfit, shifts, where_given
from estimation.tables.bin_table import group_of
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import MILLIMETRE
from estimation.values.windows import Motion
from estimation.vehicle.regressors import regression
from estimation.vehicle.vehicle_class import VehicleParameters


class Inputs(NamedTuple):
    """What a filter takes of a block, (n,) each; a gap is where ``step_s`` is 0: the linear states begin again."""

    step_s: FloatArray  # since the sample before
    speed: FloatArray  # m/s
    displacement: FloatArray  # m, y - d
    yaw: FloatArray  # rad
    known_rate: FloatArray  # rad/s, yaw rate without R
    lateral_rate: FloatArray  # m/s, rate of y - d beside V psi that the lateral forces make


class Posterior(NamedTuple):
    """What a filter tells of its m coefficients after a block."""

    mean: FloatArray  # (m,)
    covariance: FloatArray  # (m, m)
    square: float  # mean of squared innovations over their variances


@dataclass(frozen=True, slots=True)
class Prior:
    """Mean (m,) and std (m,) of the coefficients before a block."""

    mean: FloatArray
    std: FloatArray


@dataclass(frozen=True, slots=True)
class FilterState(FrozenArrays):
    """What the blocks tell, by group; states add up in any order."""

    series: SeriesState  # counts, and the derivatives by the parameters
    precision: Annotated[FloatArray, "g", "m", "m"]
    information: Annotated[FloatArray, "g", "m"]  # precision times mean
    blocks: int
    diverged: int


def follows(found: Posterior) -> bool:
    """Return whether a filter has followed the motion of a block: by its innovations, and by its covariance."""
    finite = np.isfinite(found.mean).all() and np.isfinite(found.covariance).all() and np.isfinite(found.square)
    if not finite or found.square > RIVALS.most_innovation:
        return False
    return bool(np.linalg.eigvalsh(found.covariance)[0] > 0.0)


def _inputs(motion: Motion, parameters: EstimatorParameters, keep: BoolArray) -> Inputs:
    stride = max(round(RIVALS.step_s / motion.sample_interval_s), 1)
    at = np.flatnonzero(keep)
    run = np.cumsum(np.append(0, np.diff(at) > 1))
    within = np.arange(len(at)) - np.searchsorted(run, run)
    at, run = at[within % stride == 0], run[within % stride == 0]
    p, V = parameters.vehicle, motion.speed[at]
    r0, half = p.nominal_radius, p.half_contact_distance
    equations = regression(motion, p)
    R = equations.yaw_targets[at, 0] / equations.yaw[at, -1]
    rate = motion.yaw_rate[at]
    # the lateral creep velocity that the lateral forces need (Eq. 1 at S = 2 r0, D = 0)
    spring = p.lateral_stiffness * motion.suspension_deflection + p.lateral_damping * motion.suspension_deflection_rate
    spin = 2 * p.lateral_spin_creep_coefficient / motion.speed * motion.yaw_rate
    force = spring - p.wheelset_mass * motion.lateral_acceleration - p.load * motion.roll - spin
    slip = motion.speed / (2 * p.lateral_creep_coefficient) * force
    lateral = -r0 * motion.roll_rate[at] + slip[at]
    step = np.where(np.append(True, np.diff(run) > 0), 0.0, stride * motion.sample_interval_s)
    return Inputs(step, V, motion.displacement[at], motion.yaw[at], rate + V / (2 * half * r0) * R, lateral)


class BlockFilters(ABC):
    """An estimator by a filter of each block of running."""

    __slots__ = ()
    prior: ClassVar[Prior]

    @abstractmethod
    def basis(self, x: FloatArray) -> FloatArray:
        """Return the functions (n, m) of y - d (n,), m, whose coefficients are filtered."""

    @abstractmethod
    def filter_block(self, vehicle: VehicleParameters, inputs: Inputs, noise: float) -> Posterior:
        """Return what a block tells of the coefficients, with the std of y - d, m."""

    def init(self, parameters: EstimatorParameters) -> FilterState:
        """Return the state before any block."""
        m = len(self.prior.mean)
        return FilterState(
            empty(parameters, m), np.zeros((RIVALS.series_groups, m, m)), np.zeros((RIVALS.series_groups, m)), 0, 0
        )

    def update(self, state: FilterState, motion: Motion, weight: float = 1.0) -> FilterState:
        """Return the state with the blocks of ``motion`` filtered and added, ``weight`` times."""
        if not motion.sample_interval_s > 0.0:
            raise ParameterError("the interval between samples is not known", field="sample_interval_s")
        keep, parameters, prior = usable(motion), state.series.parameters, self.prior
        precision, information = state.precision.copy(), state.information.copy()
        blocks, diverged = state.blocks, state.diverged
        of_sensors = math.sqrt(motion.displacement_noise)
        noise = max(math.hypot(parameters.uncertainty.alignment_noise, of_sensors), RIVALS.least_noise_std)
        before = np.diag(prior.std**-2.0)
        for block in np.unique(motion.block[keep]):
            inputs = _inputs(motion, parameters, keep & (motion.block == block))
            if len(inputs.yaw) < RIVALS.shortest_block:
                continue
            found = self.filter_block(parameters.vehicle, inputs, noise)
            blocks += 1
            if not follows(found):
                diverged += 1
                continue
            group = int(group_of(np.array([block]), RIVALS.series_groups)[0])
            after = np.linalg.inv(found.covariance)
            precision[group] += weight * (after - before)
            information[group] += weight * (after @ found.mean - before @ prior.mean)
        return FilterState(added(state.series, motion, self.basis, weight), precision, information, blocks, diverged)

    def result(self, state: FilterState) -> CurveEstimate:
        """Return the curve that all blocks tell; nothing where too many have diverged."""
        series = state.series
        given = where_given(series.counts, state.precision)
        uncovered = isinstance(given, Reason) and given.code is ReasonCode.TOO_FEW_SAMPLES
        if not uncovered and state.diverged > RIVALS.most_diverged_share * state.blocks:
            text = f"the filter has diverged in {state.diverged} of {state.blocks} blocks of running"
            given = Reason(ReasonCode.DIVERGED, text)
        if isinstance(given, Reason):
            return nothing(given, series.parameters, series.samples, series.stretches)
        x, present = given
        before = np.diag(self.prior.std**-2.0)
        precision = before + state.precision.sum(axis=0)
        information = before @ self.prior.mean + state.information.sum(axis=0)
        functions = self.basis(x)
        value = functions @ np.linalg.solve(precision, information)
        left_out = [
            functions @ np.linalg.solve(precision - state.precision[g], information - state.information[g])
            for g in present
        ]
        roots = functions @ np.linalg.cholesky(np.linalg.inv(precision))
        unfollowed = value + misfit(series, x, value)
        shifted = np.vstack([value + shifts(series, functions, ridge=1e-9), unfollowed])
        curve = Replicates(x, value, np.array(left_out), shifted, series.samples, series.stretches, roots.T)
        return curve_estimate(curve, series.parameters)


@dataclass(frozen=True, slots=True)
class ExtendedKalman(BlockFilters):
    """Extended Kalman-Bucy filter whose state is augmented by a nonlinear conicity.

    After Charles, Goodall and Dixon (2008), as the paper quotes them: the coefficients of a smooth R(y - d) are states
    that do not change, beside the states of the wheelset. Here R is a cubic polynomial; too far from a motion, it says
    that it has diverged.
    """

    prior = Prior(np.array([0.0, 0.3e-3, 0.0, 0.0]), np.array([1e-3, 0.3e-3, 0.05e-3, 0.03e-3]))  # m, of powers of mm
    name: str = "extended_kalman"
    title: str = "extended Kalman-Bucy filter"

    def basis(self, x: FloatArray) -> FloatArray:
        """Return the powers."""
        return np.vander(x / MILLIMETRE, len(self.prior.mean), increasing=True)

    def filter_block(self, vehicle: VehicleParameters, inputs: Inputs, noise: float) -> Posterior:
        """Return what a block tells of the coefficients."""
        mean = np.concatenate([[0.0, 0.0], self.prior.mean])
        P = np.diag(np.concatenate([[1.0, 1.0], self.prior.std]) ** 2)
        lever = 2 * vehicle.half_contact_distance * vehicle.nominal_radius
        square = kernels.extended(*inputs, noise, lever, mean, P)
        return Posterior(mean[2:], 0.5 * (P + P.T)[2:, 2:], square)


@dataclass(frozen=True, slots=True)
class ParticleFilter(BlockFilters):
    """Rao-Blackwellised particle filter: ``particles`` over the conicity, the same for every amplitude.

    After Li, Goodall and others (2003 to 2006), as the paper quotes them: particles carry the parameter, a Kalman
    filter in each the states that are linear once it is known. R = R0 + 2 lambda (y - d): particles over 2 lambda, a
    Kalman filter over y - d, psi and R0.
    """

    prior = Prior(
        np.array([0.0, 0.5 * RIVALS.steepest_slope * MILLIMETRE]),
        np.array([RIVALS.offset_std, RIVALS.steepest_slope / np.sqrt(12.0) * MILLIMETRE]),
    )
    particles: int = 48
    name: str = "particles"
    title: str = "Rao-Blackwellised particle filter"

    def basis(self, x: FloatArray) -> FloatArray:
        """Return the constant and the line."""
        return np.column_stack([np.ones(len(x)), x / MILLIMETRE])

    def filter_block(self, vehicle: VehicleParameters, inputs: Inputs, noise: float) -> Posterior:
        """Return what a block tells of offset and slope."""
        slope = RIVALS.steepest_slope * (np.arange(self.particles) + 0.5) / self.particles
        mean = np.zeros((self.particles, 3))
        P = np.tile(np.diag([1.0, 1.0, RIVALS.offset_std**2]), (self.particles, 1, 1))
        lever = 2 * vehicle.half_contact_distance * vehicle.nominal_radius
        square = kernels.particles(*inputs, noise, lever, slope, mean, P, _draws(self.particles))
        found = np.column_stack([mean[:, 2], slope * MILLIMETRE])
        least = [P[:, 2, 2].mean(), RIVALS.least_slope_variance * self.prior.std[1] ** 2]
        covariance = np.cov(found.T, bias=True) + np.diag(least)
        return Posterior(found.mean(axis=0), covariance, square)


@lru_cache
def _draws(particles: int) -> FloatArray:
    rng = np.random.default_rng(RIVALS.draw_seed)
    drawn = np.column_stack([rng.uniform(size=RIVALS.drawn_rows), rng.standard_normal((RIVALS.drawn_rows, particles))])
    drawn.flags.writeable = False
    return drawn
