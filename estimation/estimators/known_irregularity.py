"""Linear conicity with known irregularity: recursive least squares of a linear wheelset.

After Selamat and Yusof (2009), of whom the paper says that the wheelset is linear and the lateral irregularity known.
Of the linear Eq. 2 both the conicity and the creep coefficient are unknown here::

    I psi'' + (moments without longitudinal creep) = -f11 (2 l^2/V) psi' - f11 (l/r0) (R0 + 2 lambda (y - d))

so that the conicity does not rest on a creep coefficient on file, but on the yaw stiffness alone. By how much the
coefficient found differs from that on file is in the interval: what a line cannot follow, it takes for creep. Least
squares without forgetting is kept as its sums (docs/estimation.md), which equal the recursion of Eq. 10 to 14.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from estimation.estimators.interface import (
    CELLS,
    CurveEstimate,
    EstimatorParameters,
    beside,
    counted,
    covered_range,
    usable,
)
from estimation.estimators.replicates import FEWEST_GROUPS, Replicates, curve_estimate, nothing
from estimation.estimators.series import GROUPS, SPACING
from estimation.geometry.conicity import too_few_blocks
from estimation.tables.bin_table import group_of
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Motion
from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.regressors import YAW_TARGETS, regression

UNKNOWNS = 3  # f11, f11 R0 and f11 2 lambda, in N, N mm and N
MILLIMETRE = 1e-3
LEAST_SHARE = 1e-9  # smallest to largest eigenvalue of scaled sums that still are solved
LEAST_STIFF = 0.2  # of the creep coefficient on file: below, the moments beside creep say too little
TARGETS = ("yaw_stiffness", "yaw_inertia", "spin_creep", "saturation")  # what is uncertain beside f11


@dataclass(frozen=True, slots=True)
class RecursionState(FrozenArrays):
    """Sums over samples; states add up in any order."""

    parameters: EstimatorParameters
    gram: Annotated[FloatArray, "g", UNKNOWNS, UNKNOWNS]
    cross: Annotated[FloatArray, "g", UNKNOWNS, 1 + len(TARGETS)]  # with the moments and their derivatives, N m
    squares: float  # N2 m2, weighted
    sums: Annotated[FloatArray, 2, CELLS]  # N m and m, weighted: the moments and 2 l^2 psi'/V, by displacement
    counts: Annotated[FloatArray, CELLS]
    samples: int
    stretches: int


@dataclass(frozen=True, slots=True)
class KnownIrregularity:
    """Conicity and creep coefficient of a linear wheelset by least squares."""

    name: str = "known_irregularity"
    title: str = "linear wheelset, creep unknown"

    def init(self, parameters: EstimatorParameters) -> RecursionState:
        """Return the empty sums."""
        gram, cross = np.zeros((GROUPS, UNKNOWNS, UNKNOWNS)), np.zeros((GROUPS, UNKNOWNS, 1 + len(TARGETS)))
        return RecursionState(parameters, gram, cross, 0.0, np.zeros((2, CELLS)), np.zeros(CELLS), 0, 0)

    def update(self, state: RecursionState, motion: Motion, weight: float = 1.0) -> RecursionState:
        """Return the state with ``motion`` added, ``weight`` times."""
        keep = usable(motion)
        features, targets = equations(motion, state.parameters.vehicle)
        groups = group_of(motion.block[keep], GROUPS)
        features, targets, x = features[keep], targets[keep], motion.displacement[keep]
        sums = np.array([counted(x, targets[:, 0]), counted(x, -features[:, 0])])
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
            sums=state.sums + weight * sums,
            counts=state.counts + weight * counted(x),
            samples=state.samples + int(keep.sum()),
            stretches=state.stretches + 1,
        )

    def result(self, state: RecursionState) -> CurveEstimate:
        """Return the straight line; nothing where the moments do not tell the creep coefficient."""
        span = covered_range(state.counts)
        present = np.flatnonzero(np.trace(state.gram, axis1=1, axis2=2) > 0)
        refusal = _refusal(state, span is None, len(present))
        if span is None or refusal is not None:
            assert refusal is not None  # without a span there is a reason
            return nothing(refusal, state.parameters, state.samples, state.stretches)
        x = np.linspace(*span, round((span[1] - span[0]) / SPACING) + 1)
        gram, cross = state.gram.sum(axis=0), state.cross.sum(axis=0)
        theta = np.linalg.solve(gram, cross)
        value = _line(x, theta[:, 0])
        left_out = [np.linalg.solve(gram - state.gram[g], cross[:, 0] - state.cross[g, :, 0]) for g in present]
        changes = theta[:, 1:] * _stds(state.parameters)
        variance = (state.squares - theta[:, 0] @ cross[:, 0]) / max(state.counts.sum() - UNKNOWNS, 1.0)
        own = np.linalg.cholesky(np.linalg.inv(gram)) * np.sqrt(max(variance, 0.0))
        moment, rate = state.sums
        of_cell = -(moment / theta[0, 0] + rate) / _lever(state.parameters.vehicle)
        unfollowed = value + beside(x, value, of_cell, state.counts)
        on_file = state.parameters.vehicle.longitudinal_creep_coefficient
        creep_differs = value * (theta[0, 0] / on_file)
        rows = [_line(x, theta[:, 0] + change) for change in changes.T]
        shifted = np.array([*rows, unfollowed, creep_differs])
        return curve_estimate(
            Replicates(
                x,
                value,
                np.array([_line(x, one) for one in left_out]),
                shifted,
                state.samples,
                state.stretches,
                np.array([_line(x, theta[:, 0] + one) - value for one in own.T]),
            ),
            state.parameters,
        )


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


def _refusal(state: RecursionState, uncovered: bool, groups: int) -> Reason | None:  # noqa: FBT001 - of one caller
    """Return why there is no estimate; None where there is one."""
    if uncovered:
        return Reason(ReasonCode.TOO_FEW_SAMPLES, "too few samples around the centre")
    if groups < FEWEST_GROUPS:
        return too_few_blocks(groups)
    gram = state.gram.sum(axis=0)
    size = np.sqrt(np.diag(gram))
    eigenvalues = np.linalg.eigvalsh(gram / np.outer(size, size))
    if eigenvalues[0] < LEAST_SHARE:
        return Reason(ReasonCode.NOT_FINITE, "yaw rate and displacement are proportional")
    creep = float(np.linalg.solve(gram, state.cross.sum(axis=0)[:, 0])[0])
    share = creep / state.parameters.vehicle.longitudinal_creep_coefficient
    if not LEAST_STIFF < share < 1.0 / LEAST_STIFF:
        text = f"the creep coefficient comes out as {share:.2f} times that on file"
        return Reason(ReasonCode.DIVERGED, text)
    return None


def _lever(vehicle: VehicleParameters) -> float:
    """Return l/r0."""
    return vehicle.half_contact_distance / vehicle.nominal_radius


def _line(x: FloatArray, theta: FloatArray) -> FloatArray:
    """Return R (n,), m, of the unknowns (3,)."""
    return np.asarray((theta[1] * MILLIMETRE + theta[2] * x) / theta[0])


def _stds(parameters: EstimatorParameters) -> FloatArray:
    """Return the stds (4,) of what is uncertain, in the order of ``TARGETS``."""
    of_yaw = parameters.uncertainty.yaw()
    return np.array([of_yaw[YAW_TARGETS.index(name) - 1] for name in TARGETS])
