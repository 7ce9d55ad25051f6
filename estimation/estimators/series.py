"""Least squares of R = rL - rR as a series of functions of y - d: what the linear and the cubic fit share.

R c = z2 (Eq. 2 solved for R, the small contact angle term left out) is regressed on the functions, per group of
blocks; beside the target stand its derivatives by the uncertain parameters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from estimation.estimators.interface import (
    CELLS,
    CurveEstimate,
    EstimatorParameters,
    Replicates,
    beside,
    counted,
    covered_range,
    curve_estimate,
    nothing,
    usable,
)
from estimation.estimators.parameters import RIVALS
from estimation.geometry.conicity import too_few_blocks
from estimation.tables.bin_table import group_of
from estimation.values.arrays import FloatArray, FrozenArrays, IntArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import MILLIMETRE
from estimation.values.windows import Motion
from estimation.vehicle.regressors import YAW_TARGETS, regression
from estimation.vehicle.vehicle_class import VehicleParameters

Basis = Callable[[FloatArray], FloatArray]  # y - d (n,) to functions (n, m)


@dataclass(frozen=True, slots=True)
class SeriesState(FrozenArrays):
    """Sums over samples; states add up in any order."""

    parameters: EstimatorParameters
    gram: Annotated[FloatArray, "g", "m", "m"]  # of the functions, by group
    cross: Annotated[FloatArray, "g", "m", "t"]  # with the target and its derivatives by the log parameters
    squares: float  # weighted, of the target
    sums: Annotated[FloatArray, "k", CELLS]  # weighted, by displacement: the target first
    counts: Annotated[FloatArray, CELLS]  # effective samples by displacement
    samples: int
    stretches: int


def empty(
    parameters: EstimatorParameters, functions: int, targets: int = len(YAW_TARGETS), sums: int = 1
) -> SeriesState:
    """Return empty sums for ``functions`` basis functions."""
    gram, cross = (np.zeros((RIVALS.series_groups, functions, columns)) for columns in (functions, targets))
    return SeriesState(parameters, gram, cross, 0.0, np.zeros((sums, CELLS)), np.zeros(CELLS), 0, 0)


def added(state: SeriesState, motion: Motion, basis: Basis, weight: float) -> SeriesState:
    """Return the state with ``motion`` added, R its target."""
    keep = usable(motion)
    equations = regression(motion, state.parameters.vehicle)
    targets = equations.yaw_targets[keep] / equations.yaw[keep, -1:]
    return summed(state, motion, basis(motion.displacement[keep]), targets, targets[:, :1], weight)


def summed(
    state: SeriesState, motion: Motion, features: FloatArray, targets: FloatArray, by_cell: FloatArray, weight: float
) -> SeriesState:
    """Return the state with the usable samples (n,) of ``motion`` added, ``by_cell`` (n, k) by displacement."""
    keep = usable(motion)
    x, groups = motion.displacement[keep], group_of(motion.block[keep], RIVALS.series_groups)
    gram, cross = state.gram.copy(), state.cross.copy()
    for group in np.unique(groups):
        in_group = groups == group
        weighted = weight * features[in_group].T
        gram[group] += weighted @ features[in_group]
        cross[group] += weighted @ targets[in_group]
    return replace(
        state,
        gram=gram,
        cross=cross,
        squares=state.squares + weight * float(targets[:, 0] @ targets[:, 0]),
        sums=state.sums + weight * np.array([counted(x, column) for column in by_cell.T]),
        counts=state.counts + weight * counted(x),
        samples=state.samples + len(x),
        stretches=state.stretches + 1,
    )


class SeriesFit(ABC):
    """An estimator by least squares of a series of functions."""

    __slots__ = ()
    ridge: ClassVar[float] = 0.0  # of the mean diagonal of the normal equations: it holds what has no data at zero

    @abstractmethod
    def basis(self, x: FloatArray) -> FloatArray:
        """Return the functions (n, m) of y - d (n,), m."""

    def init(self, parameters: EstimatorParameters) -> SeriesState:
        """Return the empty sums."""
        return empty(parameters, self.basis(np.zeros(1)).shape[1])

    def update(self, state: SeriesState, motion: Motion, weight: float = 1.0) -> SeriesState:
        """Return the state with ``motion`` added, ``weight`` times."""
        return added(state, motion, self.basis, weight)

    def result(self, state: SeriesState) -> CurveEstimate:
        """Return the curve where there are data, its intervals from groups left out and parameters shifted."""
        given = where_given(state.counts, state.gram)
        if isinstance(given, Reason):
            return nothing(given, state.parameters, state.samples, state.stretches)
        x, present = given
        gram, cross = state.gram.sum(axis=0), state.cross.sum(axis=0)
        small = _small(gram, self.ridge)
        theta = np.linalg.solve(gram + small, cross[:, 0])
        left_out = [np.linalg.solve(gram - state.gram[g] + small, cross[:, 0] - state.cross[g, :, 0]) for g in present]
        functions = self.basis(x)
        value = functions @ theta
        shifted = np.vstack([value + shifts(state, functions, self.ridge), value + misfit(state, x, value)])
        # of least squares that takes every residual for independent
        squares = max(float(state.squares - theta @ cross[:, 0]), 0.0)
        count = max(float(state.counts.sum()) - len(theta), 1.0)
        inverse = np.linalg.inv(gram + small)
        covariance = 0.5 * (inverse + inverse.T) * max(squares / count, RIVALS.smallest_variance)
        own = (functions @ np.linalg.cholesky(covariance)).T
        without = np.array(left_out) @ functions.T
        curve = Replicates(x, value, without, shifted, state.samples, state.stretches, own)
        return curve_estimate(curve, state.parameters)


def shifts(state: SeriesState, functions: FloatArray, ridge: float) -> FloatArray:
    """Return what one std of each uncertain parameter changes of the curve (6, n), m, by its basis functions (n, m)."""
    gram, cross = state.gram.sum(axis=0), state.cross.sum(axis=0)
    theta = np.linalg.solve(gram + _small(gram, ridge), cross[:, 1:])
    return np.asarray((functions @ theta).T * state.parameters.uncertainty.yaw()[:, None])


def misfit(state: SeriesState, x: FloatArray, value: FloatArray) -> FloatArray:
    """Return what the curve cannot follow (n,), m: by how much the mean of R is above it, cell by cell."""
    return beside(x, value, state.sums[0], state.counts)


def where_given(counts: FloatArray, sums: FloatArray) -> tuple[FloatArray, IntArray] | Reason:
    """Return where the curve is given (n,), m, and the groups whose sums (g, m, m) hold data; or why it is nowhere."""
    span, present = covered_range(counts), np.flatnonzero(np.trace(sums, axis1=1, axis2=2) != 0.0)
    if isinstance(span, Reason):
        return span
    if len(present) < RIVALS.fewest_groups:  # what is left without one of them may not determine the functions
        return too_few_blocks(len(present))
    return np.linspace(*span, round((span[1] - span[0]) / RIVALS.curve_spacing) + 1), present


def _small(gram: FloatArray, ridge: float) -> FloatArray:
    return np.asarray(ridge * np.trace(gram) / len(gram) * np.eye(len(gram)))


UNKNOWNS = 3  # f11, f11 R0 and f11 2 lambda, in N, N mm and N
TARGETS = ("yaw_stiffness", "yaw_inertia", "spin_creep", "saturation")  # what is uncertain beside f11


@dataclass(frozen=True, slots=True)
class KnownIrregularity:
    """Conicity and creep coefficient of a linear wheelset by least squares, its irregularity known.

    After Selamat and Yusof (2009), of whom the paper says so. Of the linear Eq. 2 both are unknown here::

        I psi'' + (moments without longitudinal creep) = -f11 (2 l^2/V) psi' - f11 (l/r0) (R0 + 2 lambda (y - d))

    so that the conicity does not rest on a creep coefficient on file, but on the yaw stiffness alone. By how much the
    coefficient found differs from that on file is in the interval: what a line cannot follow, it takes for creep. Least
    squares without forgetting is kept as its sums (docs/estimation.md), which equal the recursion of Eq. 10 to 14.
    """

    name: str = "known_irregularity"
    title: str = "linear wheelset, creep unknown"

    def init(self, parameters: EstimatorParameters) -> SeriesState:
        """Return the empty sums."""
        return empty(parameters, UNKNOWNS, 1 + len(TARGETS), sums=2)

    def update(self, state: SeriesState, motion: Motion, weight: float = 1.0) -> SeriesState:
        """Return the state with ``motion`` added, ``weight`` times: the moments and 2 l^2 psi'/V by displacement."""
        features, targets = (part[usable(motion)] for part in equations(motion, state.parameters.vehicle))
        by_cell = np.column_stack([targets[:, 0], -features[:, 0]])
        return summed(state, motion, features, targets, by_cell, weight)

    def result(self, state: SeriesState) -> CurveEstimate:
        """Return the straight line; nothing where the moments do not tell the creep coefficient."""
        given = where_given(state.counts, state.gram)
        given = given if isinstance(given, Reason) else _refusal(state) or given
        if isinstance(given, Reason):
            return nothing(given, state.parameters, state.samples, state.stretches)
        x, present = given
        gram, cross = state.gram.sum(axis=0), state.cross.sum(axis=0)
        theta = np.linalg.solve(gram, cross)
        value = _line(x, theta[:, 0])
        left_out = [np.linalg.solve(gram - state.gram[g], cross[:, 0] - state.cross[g, :, 0]) for g in present]
        of_yaw = state.parameters.uncertainty.yaw()
        changes = theta[:, 1:] * np.array([of_yaw[YAW_TARGETS.index(name) - 1] for name in TARGETS])
        variance = (state.squares - theta[:, 0] @ cross[:, 0]) / max(state.counts.sum() - UNKNOWNS, 1.0)
        roots = np.linalg.cholesky(np.linalg.inv(gram)) * np.sqrt(max(variance, 0.0))
        moment, rate = state.sums
        lever = state.parameters.vehicle.half_contact_distance / state.parameters.vehicle.nominal_radius
        of_cell = -(moment / theta[0, 0] + rate) / lever
        unfollowed = value + beside(x, value, of_cell, state.counts)
        on_file = state.parameters.vehicle.longitudinal_creep_coefficient
        creep_differs = value * (theta[0, 0] / on_file)
        shifted = np.array([*(_line(x, theta[:, 0] + change) for change in changes.T), unfollowed, creep_differs])
        without = np.array([_line(x, coefficients) for coefficients in left_out])
        stated = np.array([_line(x, theta[:, 0] + root) - value for root in roots.T])
        curve = Replicates(x, value, without, shifted, state.samples, state.stretches, stated)
        return curve_estimate(curve, state.parameters)


def equations(motion: Motion, vehicle: VehicleParameters) -> tuple[FloatArray, FloatArray]:
    """Return regressors (n, 3) of f11, f11 R0 and f11 2 lambda, and the moments (n, 5) with their derivatives, N m."""
    half, r0 = vehicle.half_contact_distance, vehicle.nominal_radius
    rate = 2 * half**2 * motion.yaw_rate / motion.speed
    ones = np.full(len(motion), half / r0 * MILLIMETRE)
    features = -np.column_stack([rate, ones, half / r0 * motion.displacement])
    of_yaw = regression(motion, vehicle).yaw_targets
    columns = [YAW_TARGETS.index(name) for name in TARGETS]
    without_creep = -of_yaw[:, YAW_TARGETS.index("longitudinal_creep")]  # z2 less the moment of creep
    return features, np.column_stack([without_creep, of_yaw[:, columns]])


def _refusal(state: SeriesState) -> Reason | None:
    gram = state.gram.sum(axis=0)
    size = np.sqrt(np.diag(gram))
    eigenvalues = np.linalg.eigvalsh(gram / np.outer(size, size))
    if eigenvalues[0] < RIVALS.least_eigenvalue_share:
        return Reason(ReasonCode.NOT_FINITE, "yaw rate and displacement are proportional")
    creep = float(np.linalg.solve(gram, state.cross.sum(axis=0)[:, 0])[0])
    share = creep / state.parameters.vehicle.longitudinal_creep_coefficient
    if RIVALS.least_creep_share < share < 1.0 / RIVALS.least_creep_share:
        return None
    return Reason(ReasonCode.DIVERGED, f"the creep coefficient comes out as {share:.2f} times that on file")


def _line(x: FloatArray, theta: FloatArray) -> FloatArray:
    return np.asarray((theta[1] * MILLIMETRE + theta[2] * x) / theta[0])
