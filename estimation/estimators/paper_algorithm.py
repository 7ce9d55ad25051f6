"""The algorithm of the paper: as it is printed, and as an estimator, stretch by stretch.

Ward, Goodall, Dixon, UKACC 2010, section 4: bins of y - d, a threshold count, grey-box recursion in each bin. Two
multiple-input single-output identifications with the regressors [psi, phi', 1], lateral (Eq. 15-16) and yaw (Eq.
17-18), give the four combinations; signs of the known parts are those of ``estimation.vehicle.regressors``.

Of the estimator only the yaw identification runs, which gives rL - rR; V of the paper is the mean speed of a stretch.
The recursion starts in a bin when the threshold count is reached. Its own covariance takes every residual for
independent and every parameter for right, so that it holds next to nothing of the truth: published intervals come from
groups of blocks left out, uncertain parameters, and what the mean of R by cells has beside the curve. A weight scales
the samples by its square root, which is what weighted least squares does; the paper's own forgetting factor is per
sample and stays 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Self

import numpy as np

from estimation.compiled import compiled
from estimation.contact.conicity import zero_crossing
from estimation.estimators.interface import (
    CELLS,
    REACH,
    WIDTH,
    CurveEstimate,
    EstimatorParameters,
    Replicates,
    beside,
    counted,
    curve_estimate,
    nothing,
    usable,
)
from estimation.estimators.parameters import RIVALS
from estimation.geometry.conicity import run_around, too_few_blocks
from estimation.geometry.sharpening import jumps_displaced
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.tables.bin_table import group_of
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray, frozen_array
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Motion
from estimation.vehicle.regressors import YAW_TARGETS, regression
from estimation.vehicle.vehicle_class import VehicleParameters

REGRESSORS = 3


@dataclass(frozen=True, slots=True)
class PaperGeometry:
    """The four combinations by bin; NaN where the threshold was not reached."""

    centre: FloatArray  # (b,) m
    samples: IntArray  # (b,)
    rolling_radius_sum: FloatArray  # (b,) m
    rolling_radius_difference: FloatArray  # (b,) m
    contact_angle_sum: FloatArray  # (b,) rad
    contact_angle_difference: FloatArray  # (b,) rad


def estimate(motion: Motion, p: VehicleParameters, parameters: PaperAlgorithm) -> PaperGeometry:
    """Run the algorithm over ideal signals in the order of their samples; the mean speed is the paper's V."""
    keep = motion.valid
    V = float(motion.speed[keep].mean())
    nearest = np.floor(motion.displacement[keep] / parameters.width + 0.5).astype(np.int64)
    first, bins = int(nearest.min()), int(nearest.max() - nearest.min()) + 1
    features = np.column_stack([motion.yaw[keep], motion.roll_rate[keep], np.ones(int(keep.sum()))])
    known = (
        -(2 * p.lateral_creep_coefficient / V) * motion.lateral_velocity
        + p.lateral_damping * motion.suspension_deflection_rate
        + p.lateral_stiffness * motion.suspension_deflection
        - (2 * p.lateral_spin_creep_coefficient / V) * motion.yaw_rate
        - p.load * motion.roll
    ) / p.wheelset_mass
    output = np.asarray((motion.lateral_acceleration - known)[keep])
    lateral, count = recursion_in_bins(features, output, nearest - first, bins, parameters)
    yaw, _ = recursion_in_bins(features, yaw_output(motion, p, V, keep), nearest - first, bins, parameters)
    f11, f22, f23 = p.longitudinal_creep_coefficient, p.lateral_creep_coefficient, p.lateral_spin_creep_coefficient
    r0, l = p.nominal_radius, p.half_contact_distance  # noqa: E741 - the paper's l
    return PaperGeometry(
        centre=np.asarray((first + np.arange(bins)) * parameters.width, dtype=np.float64),
        samples=count,
        rolling_radius_sum=(p.wheelset_mass * lateral[:, 0] - 2 * f22 + 2 * f11) * r0 / f11,
        rolling_radius_difference=-p.yaw_inertia * yaw[:, 2] * r0 / (l * f11),
        contact_angle_sum=(p.yaw_inertia * yaw[:, 0] + p.yaw_stiffness + 2 * f23) / (l * p.load / 2),
        contact_angle_difference=p.wheelset_mass * lateral[:, 2] / (f23 / r0 - p.load / 2),
    )


def yaw_output(motion: Motion, p: VehicleParameters, V: float, keep: BoolArray) -> FloatArray:
    """Return psi'' - Omega2 (k,), rad/s^2 (Eq. 17); the frame of a bogie moves the other end of the yaw spring."""
    damping = 2 * p.half_contact_distance**2 * p.longitudinal_creep_coefficient / V + 2 * p.spin_creep_coefficient / V
    known = (
        (2 * p.lateral_spin_creep_coefficient / V) * motion.lateral_velocity
        - (damping + p.yaw_damping) * motion.yaw_rate
    ) / p.yaw_inertia
    if motion.frame_yaw is not None and motion.frame_yaw_rate is not None:
        known = known + (p.yaw_stiffness * motion.frame_yaw + p.yaw_damping * motion.frame_yaw_rate) / p.yaw_inertia
    return np.asarray((motion.yaw_acceleration - known)[keep])


def recursion_in_bins(
    features: FloatArray, output: FloatArray, index: IntArray, bins: int, parameters: PaperAlgorithm
) -> tuple[FloatArray, IntArray]:
    """Run Eq. 10-14 in bins ``index`` (n,); return theta (b, 3), NaN below the threshold, and the counts (b,)."""
    state = parameters.before(EstimatorParameters(), bins)
    state = parameters.recursed(state, features / RIVALS.regressor_scale, output, index)
    return state.theta / RIVALS.regressor_scale, state.count


MIDDLES = frozen_array((np.arange(CELLS) + 0.5) * WIDTH - REACH, (CELLS,), name="middles")  # m


@dataclass(frozen=True, slots=True)
class CellMeans(FrozenArrays):
    """Weighted sums over samples; they add up in any order."""

    sums: Annotated[FloatArray, RIVALS.paper_algorithm_groups, CELLS]  # m, of R
    counts: Annotated[FloatArray, RIVALS.paper_algorithm_groups, CELLS]
    derivatives: Annotated[FloatArray, len(YAW_TARGETS) - 1, CELLS]  # m, of R by the logarithms of the parameters

    @classmethod
    def empty(cls) -> Self:
        """Return the sums over no sample."""
        nothing = np.zeros((RIVALS.paper_algorithm_groups, CELLS))
        return cls(nothing, nothing, np.zeros((len(YAW_TARGETS) - 1, CELLS)))

    def added(self, motion: Motion, vehicle: VehicleParameters, weight: float) -> Self:
        """Return the sums with ``motion`` added."""
        keep = usable(motion)
        equations = regression(motion, vehicle)
        R, x = equations.yaw_targets[keep] / equations.yaw[keep, -1:], motion.displacement[keep]
        groups = group_of(motion.block[keep], RIVALS.paper_algorithm_groups)
        sums, counts = self.sums.copy(), self.counts.copy()
        for group in np.unique(groups):
            mine = groups == group
            sums[group] += weight * counted(x[mine], R[mine, 0])
            counts[group] += weight * counted(x[mine])
        derivatives = weight * np.array([counted(x, column) for column in R[:, 1:].T])
        return type(self)(sums, counts, self.derivatives + derivatives)

    def left_out(self, x: FloatArray) -> FloatArray:
        """Return by how much the means change without each group that has samples: (g', n), m."""
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
        """Return what one std of each uncertain parameter changes, and what the curve cannot follow: (7, n), m."""
        number = self.counts.sum(axis=0)
        known = number > 0
        means = self.derivatives[:, known] / number[known]
        rows = [std * np.interp(x, MIDDLES[known], row) for std, row in zip(uncertainty.yaw(), means, strict=True)]
        return np.array([*rows, beside(x, value, self.sums.sum(axis=0), number)])


@dataclass(frozen=True, slots=True)
class PaperState(FrozenArrays):
    """The recursion of every bin, and the samples of the bins that have not started."""

    parameters: EstimatorParameters
    theta: Annotated[FloatArray, "b", REGRESSORS]  # of the scaled regressors; NaN before the start
    covariance: Annotated[FloatArray, "b", REGRESSORS, REGRESSORS]  # P of Eq. 10
    squares: Annotated[FloatArray, "b"]  # sum of squared residuals
    count: Annotated[IntArray, "b"]
    waiting: Annotated[FloatArray, "b", "threshold", REGRESSORS + 1]  # scaled regressors and output
    cells: CellMeans  # what the published intervals rest on
    stretches: int


@dataclass(frozen=True, slots=True)
class PaperAlgorithm:
    """Division size b, threshold count and forgetting factor W of the paper's section 4."""

    width: float = 0.25e-3  # b, m
    threshold: int = 200
    forgetting: float = 1.0
    name: str = "paper"
    title: str = "the paper's algorithm"

    def init(self, parameters: EstimatorParameters) -> PaperState:
        """Return the state before any sample."""
        return self.before(parameters, 2 * self._half + 1)

    def before(self, parameters: EstimatorParameters, b: int) -> PaperState:
        """Return the state of b bins before any sample."""
        return PaperState(
            parameters,
            np.full((b, REGRESSORS), np.nan),
            np.zeros((b, REGRESSORS, REGRESSORS)),
            np.zeros(b),
            np.zeros(b, dtype=np.int64),
            np.zeros((b, self.threshold, REGRESSORS + 1)),
            CellMeans.empty(),
            0,
        )

    def update(self, state: PaperState, motion: Motion, weight: float = 1.0) -> PaperState:
        """Return the state after the samples of ``motion``, one by one, each counted ``weight`` times."""
        keep = usable(motion)
        if not keep.any():
            return replace(state, stretches=state.stretches + 1)
        V = float(motion.speed[keep].mean())
        index = np.floor(motion.displacement[keep] / self.width + 0.5).astype(np.int64) + self._half
        columns = motion.yaw[keep], motion.roll_rate[keep], np.ones(int(keep.sum()))
        features = np.column_stack(columns) / RIVALS.regressor_scale
        output = yaw_output(motion, state.parameters.vehicle, V, keep)
        root = np.sqrt(weight)
        cells = state.cells.added(motion, state.parameters.vehicle, weight)
        return self.recursed(replace(state, cells=cells), root * features, root * output, index)

    def recursed(self, state: PaperState, features: FloatArray, output: FloatArray, index: IntArray) -> PaperState:
        """Run the recursion of every bin over its samples (n,), in their order."""
        theta, covariance, squares = state.theta.copy(), state.covariance.copy(), state.squares.copy()
        count, waiting = state.count.copy(), state.waiting.copy()
        order = np.argsort(index, kind="stable")  # a bin's samples together, in their own order
        samples = np.column_stack([features, output])[order]
        stops = np.searchsorted(index[order], np.arange(len(count)) + 1)
        for b in np.unique(index):
            in_bin = samples[stops[b - 1] if b else 0 : stops[b]]
            taken = min(max(self.threshold - int(count[b]), 0), len(in_bin))
            waiting[b, count[b] : count[b] + taken] = in_bin[:taken]
            count[b] += len(in_bin)
            if taken and count[b] >= self.threshold:
                theta[b], covariance[b], squares[b] = _start(waiting[b])
            rest = np.ascontiguousarray(in_bin[taken:])
            if len(rest) and np.isfinite(theta[b, 0]):
                X, z = np.ascontiguousarray(rest[:, :REGRESSORS]), np.ascontiguousarray(rest[:, REGRESSORS])
                theta[b], covariance[b], squares[b] = _recurse(
                    theta[b], covariance[b], squares[b], X, z, self.forgetting
                )
        return PaperState(
            state.parameters, theta, covariance, squares, count, waiting, state.cells, state.stretches + 1
        )

    def result(self, state: PaperState) -> CurveEstimate:
        """Return R of the bins that have started, in the unbroken run around zero."""
        p = state.parameters.vehicle
        per_unit = -p.yaw_inertia * p.nominal_radius / (p.half_contact_distance * p.longitudinal_creep_coefficient)
        run = run_around(np.isfinite(state.theta[:, 2]) & (state.count > self.threshold + REGRESSORS), self._half)
        samples = int(state.count.sum())
        if run.stop == self._half or run.stop - run.start < RIVALS.fewest_bins:
            text = f"fewer than {RIVALS.fewest_bins} bins around the centre have reached the threshold"
            return nothing(Reason(ReasonCode.TOO_FEW_BINS, text), state.parameters, samples, state.stretches)
        R = per_unit * state.theta[run, 2] / RIVALS.regressor_scale[2]
        variance = state.squares[run] / (state.count[run] - REGRESSORS)
        std = abs(per_unit) * np.sqrt(variance * state.covariance[run, 2, 2]) / RIVALS.regressor_scale[2]
        x = (np.arange(run.start, run.stop) - self._half) * self.width
        left_out = state.cells.left_out(x)
        if len(left_out) < RIVALS.fewest_groups:
            return nothing(too_few_blocks(len(left_out)), state.parameters, samples, state.stretches)
        uncertain = R + state.cells.shifted(x, R, state.parameters.uncertainty)
        shifted = np.vstack([uncertain, jumps_elsewhere(x, R, self.width / np.sqrt(12.0))])
        curve = Replicates(x, R, R + left_out, shifted, samples, state.stretches, np.diag(std))
        return curve_estimate(curve, state.parameters)

    @property
    def _half(self) -> int:
        return int(np.ceil(REACH / self.width))


def _start(waiting: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Solve the samples (threshold, 4) that have waited in a bin (Eq. 10-11); NaN where they do not determine it."""
    X, z = waiting[:, :REGRESSORS], waiting[:, REGRESSORS]
    size = np.sqrt((X * X).mean(axis=0))
    if size.min() <= 0.0:
        return np.full(REGRESSORS, np.nan), np.zeros((REGRESSORS, REGRESSORS)), 0.0
    root, triangle = np.linalg.qr(X / size)
    diagonal = np.abs(np.diag(triangle))
    if diagonal.min() <= RIVALS.least_rank_share * diagonal.max():
        return np.full(REGRESSORS, np.nan), np.zeros((REGRESSORS, REGRESSORS)), 0.0
    inverse = np.linalg.inv(triangle) / size[:, None]
    theta = inverse @ (root.T @ z)
    return theta, inverse @ inverse.T, float(((z - X @ theta) ** 2).sum())


def jumps_elsewhere(x: FloatArray, curve: FloatArray, std: float) -> FloatArray:
    """Return a curve with its contact jumps further out and nearer by one std, each with half of the variance (2, n).

    A bin has one value: where in it a jump is remains unknown.
    """
    middle = zero_crossing(x, curve)
    if not np.isfinite(middle):
        return np.stack([curve, curve])
    moved = np.stack([jumps_displaced(x, curve, middle, by) for by in (std, -std)])
    return np.asarray(curve + (moved - curve) / np.sqrt(2.0))


@compiled(nogil=True)
def _recurse(
    theta: FloatArray, P: FloatArray, squares: float, X: FloatArray, z: FloatArray, W: float
) -> tuple[FloatArray, FloatArray, float]:
    for i in range(len(z)):
        x = X[i]
        Px = P @ x
        γ = 1.0 / (W + x @ Px)
        error = z[i] - x @ theta
        squares = W * (squares + γ * error * error)
        theta = theta + γ * error * Px
        P = (P - γ * np.outer(Px, Px)) / W
    return theta, P, squares
