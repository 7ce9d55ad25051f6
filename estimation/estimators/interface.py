"""The interface of every estimator of a wheelset's geometry: init, update, result over frozen values.

An estimator gets what is assumed of the vehicle, then the motion of one wheelset relative to the track, window by
window. At any time it gives the curve rL - rR over y - d, and what follows from it, each with its interval. How it
gets there (sums, mean and covariance of a filter, particles) is its own, in its own ``State``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Protocol, TypeVar

import numpy as np

from estimation.contact.conicity import equivalent_conicity, zero_crossing
from estimation.estimators.parameters import RIVALS
from estimation.geometry.conicity import (
    NO_AMPLITUDE,
    NO_OFFSET,
    NO_ZERO,
    CurveParameters,
    at_reference_amplitude,
    estimate_of,
    not_covered,
    run_around,
    too_few_blocks,
)
from estimation.geometry.parameters import PRIORS
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, bin_centres
from estimation.values.geometry import BinStatus, BinValues, WheelsetGeometry
from estimation.values.quantities import Estimate, Status, jackknife_std
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Motion
from estimation.vehicle.vehicle_class import VehicleParameters


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


WIDTH = RIVALS.bin_width
REACH = RIVALS.bin_reach
CELLS = round(2 * REACH / WIDTH)


def usable(motion: Motion) -> BoolArray:
    """Return the samples (n,) that an estimator may use."""
    return np.asarray(
        motion.valid & (motion.block >= 0) & np.isfinite(motion.displacement) & (np.abs(motion.displacement) < REACH)
    )


def counted(displacement: FloatArray, values: FloatArray | None = None) -> FloatArray:
    """Return the number of samples, or the sum of values (n,), (CELLS,) in each cell of ``WIDTH`` over +-``REACH``."""
    cell = np.floor((displacement + REACH) / WIDTH).astype(np.int64)
    return np.bincount(cell, values, minlength=CELLS).astype(np.float64)


def beside(x: FloatArray, value: FloatArray, sums: FloatArray, counts: FloatArray) -> FloatArray:
    """Return by how much the mean of each cell is above a curve, straight between cells: (n,)."""
    middles = (np.arange(CELLS) + 0.5) * WIDTH - REACH
    known = (counts >= RIVALS.least_samples) & (middles > x[0]) & (middles < x[-1])
    if not known.any():
        return np.zeros(len(x))
    apart = sums[known] / counts[known] - np.interp(middles[known], x, value)
    return np.asarray(np.interp(x, middles[known], apart))


def covered_range(counts: FloatArray) -> tuple[float, float] | Reason:
    """Return from where to where, m, every cell has ``least_samples``, zero inside; why not without such a run."""
    run = run_around(counts >= RIVALS.least_samples, CELLS // 2)
    if CELLS // 2 in {run.start, run.stop}:
        return Reason(ReasonCode.TOO_FEW_SAMPLES, "too few samples around the centre")
    return run.start * WIDTH - REACH, run.stop * WIDTH - REACH


@dataclass(frozen=True, slots=True)
class Replicates:
    """A curve over ``displacement``: from all data, with each group left out, shifted by each uncertainty.

    An estimator without groups gives none: then all that is uncertain is in ``shifted``, one standard deviation each.
    What the scales of R and of y - d leave unknown is added to that for every estimator.
    ``own`` is a root of the covariance that the estimator itself states; it takes no part in the published intervals.
    """

    displacement: FloatArray  # (n,) m
    all_data: FloatArray  # (n,) m
    left_out: FloatArray  # (g, n) m; g may be 0
    shifted: FloatArray  # (p, n) m
    samples: int
    stretches: int
    own: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))  # (q, n) m


def nothing(reason: Reason, parameters: EstimatorParameters, samples: int, stretches: int) -> CurveEstimate:
    """Return the estimate without any number, for one reason."""
    amplitude = np.array(parameters.curve.amplitudes)
    unknown = Estimate.unknown(reason, float(stretches))
    empty = np.empty(0)
    return CurveEstimate(
        displacement=empty,
        difference=empty,
        difference_std=empty,
        amplitude=amplitude,
        conicity=(unknown,) * len(amplitude),
        nonlinearity=unknown,
        zero_crossing=unknown,
        samples=samples,
        stretches=stretches,
        status=Status.UNESTIMATED,
        reason=reason,
        own_std=np.full(len(amplitude), np.nan),
    )


def curve_estimate(curve: Replicates, parameters: EstimatorParameters) -> CurveEstimate:
    """Return curve, conicity, NP and zero crossing, intervals from the spread of the replicates."""
    g = len(curve.left_out)
    if 0 < g < RIVALS.fewest_groups:
        return nothing(too_few_blocks(g), parameters, curve.samples, curve.stretches)
    x, R, unknown = curve.displacement, curve.all_data, parameters.uncertainty
    # R and y - d are larger by one std of their scales
    stretch = np.hypot(PRIORS.projection_scale_std if parameters.band_limited else 0.0, unknown.displacement)
    shifted = np.vstack([curve.shifted, R * (1.0 + unknown.scale), np.interp(x / (1.0 + stretch), x, R)])
    rows = np.concatenate([curve.all_data[None], curve.left_out, shifted])
    amplitude = np.array(parameters.curve.amplitudes)
    values = np.stack([equivalent_conicity(x, row, amplitude) for row in rows])
    count = float(curve.stretches)
    conicity = tuple(estimate_of(values[:, k], g, count, not_covered(a)) for k, a in enumerate(amplitude))
    ends = (parameters.curve.nonlinearity_low, parameters.curve.nonlinearity_high)
    low, high = (values[:, int(np.argmin(np.abs(amplitude - end)))] for end in ends)
    nonlinearity = estimate_of((high - low) / (1e3 * (ends[1] - ends[0])), g, count, not_covered(ends[1]))
    if parameters.band_limited:
        crossing = Estimate.unknown(NO_OFFSET, count)
    else:
        zeros = np.array([zero_crossing(x, row) for row in rows])
        crossing = estimate_of(zeros, g, count, NO_ZERO)
    sampled = jackknife_std(rows[: g + 1]) if g else 0.0
    covered = any(item.value is not None for item in conicity)
    return CurveEstimate(
        displacement=x,
        difference=curve.all_data,
        difference_std=np.hypot(sampled, np.sqrt(((shifted - curve.all_data) ** 2).sum(axis=0))),
        amplitude=amplitude,
        conicity=conicity,
        nonlinearity=nonlinearity,
        zero_crossing=crossing,
        samples=curve.samples,
        stretches=curve.stretches,
        status=Status.ESTIMATED if covered else Status.UNESTIMATED,
        reason=None if covered else NO_AMPLITUDE,
        own_std=_own_std(curve, values[0], amplitude),
    )


def _own_std(curve: Replicates, conicity: FloatArray, amplitude: FloatArray) -> FloatArray:
    if not len(curve.own):
        return np.full(len(amplitude), np.nan)
    changed = [equivalent_conicity(curve.displacement, curve.all_data + row, amplitude) for row in curve.own]
    return np.asarray(np.linalg.norm(np.array(changed) - conicity, axis=0))


def geometry_from_motion(
    estimator: Estimator[Any],
    parameters: EstimatorParameters,
    motions: Iterable[tuple[float, Motion]],
    edges: FloatArray,
    parameter_key: str,
) -> WheelsetGeometry:
    """Return the geometry that ``estimator`` finds from weight (at most 1) and motion of each window, oldest first.

    It is published in bins between ``edges`` (b + 1,), m of y - d.
    """
    state = estimator.init(parameters)
    samples = np.zeros(len(edges) - 1)
    for weight, motion in motions:
        state = estimator.update(state, motion, weight)
        samples += weight * np.histogram(motion.displacement[usable(motion)], edges)[0]
    return geometry_from_curve(estimator.result(state), parameters, samples, edges, parameter_key)


def geometry_from_curve(
    curve: CurveEstimate, parameters: EstimatorParameters, samples: FloatArray, edges: FloatArray, parameter_key: str
) -> WheelsetGeometry:
    """Return a curve as the geometry of a wheelset.

    Of the four combinations only rL - rR is estimated: at the centres of the bins, by linear interpolation of the curve
    inside its range. The others are marked ``UNOBSERVABLE``.
    """
    best, amplitude = at_reference_amplitude(curve.amplitude, curve.conicity, parameters.curve)
    if best.reason == NO_AMPLITUDE and curve.reason is not None:  # why there is no curve at all
        best = replace(best, reason=curve.reason)
    unknown = np.full(len(samples), np.nan)
    nothing = BinValues(unknown, unknown, (BinStatus.UNOBSERVABLE,) * len(samples))
    return WheelsetGeometry(
        bin_edges=edges,
        samples=samples,
        rolling_radius_sum=nothing,
        rolling_radius_difference=_difference(curve, edges),
        contact_angle_sum=nothing,
        contact_angle_difference=nothing,
        amplitude=curve.amplitude,
        conicity=curve.conicity,
        reported_amplitude=amplitude,
        equivalent_conicity=best,
        nonlinearity=curve.nonlinearity,
        zero_crossing=curve.zero_crossing,
        windows=curve.stretches,
        parameter_key=parameter_key,
        status=best.status,
        reason=best.reason,
    )


def _difference(curve: CurveEstimate, edges: FloatArray) -> BinValues:
    centres = bin_centres(edges)
    known = np.isfinite(curve.difference) & np.isfinite(curve.difference_std)
    if not known.any():
        nothing = np.full(len(centres), np.nan)
        return BinValues(nothing, nothing, (BinStatus.TOO_FEW,) * len(centres))
    x = curve.displacement[known]
    inside = (centres >= x[0]) & (centres <= x[-1])
    value = np.where(inside, np.interp(centres, x, curve.difference[known]), np.nan)
    std = np.where(inside, np.interp(centres, x, curve.difference_std[known]), np.nan)
    return BinValues(value, std, tuple(BinStatus.ESTIMATED if yes else BinStatus.TOO_FEW for yes in inside))
