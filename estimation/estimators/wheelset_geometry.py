"""From the motion of a wheelset to its geometry, by any estimator."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimation.estimators.interface import CurveEstimate, Estimator, EstimatorParameters, usable
from estimation.geometry.conicity import NO_AMPLITUDE, at_reference_amplitude
from estimation.values.arrays import FloatArray, bin_centres
from estimation.values.geometry import BinStatus, BinValues, WheelsetGeometry
from estimation.values.windows import Motion


@dataclass(frozen=True, slots=True)
class PublishedBins:
    """The bins in which the curve of an estimator is published, and the key of the parameters that shaped it."""

    edges: FloatArray  # (b + 1,) m of y - d
    parameter_key: str


def geometry_from_motion(
    estimator: Estimator[Any],
    parameters: EstimatorParameters,
    motions: Iterable[tuple[float, Motion]],
    bins: PublishedBins,
) -> WheelsetGeometry:
    """Return the geometry that ``estimator`` finds.

    Args:
        motions: Weight (at most 1) and motion of each window, oldest first.
    """
    state = estimator.init(parameters)
    samples = np.zeros(len(bins.edges) - 1)
    for weight, motion in motions:
        state = estimator.update(state, motion, weight)
        samples += weight * np.histogram(motion.displacement[usable(motion)], bins.edges)[0]
    return geometry_from_curve(estimator.result(state), parameters, samples, bins)


def geometry_from_curve(
    curve: CurveEstimate, parameters: EstimatorParameters, samples: FloatArray, bins: PublishedBins
) -> WheelsetGeometry:
    """Return a curve as the geometry of a wheelset.

    Of the four combinations only rL - rR is estimated: at the centres of the bins, by linear interpolation of the curve
    inside its range. The others are marked ``UNOBSERVABLE``.

    Args:
        samples: (b,) effective number of samples in each bin.
    """
    best, amplitude = at_reference_amplitude(curve.amplitude, curve.conicity, parameters.curve)
    if best.reason == NO_AMPLITUDE and curve.reason is not None:  # why there is no curve at all
        best = replace(best, reason=curve.reason)
    unknown = np.full(len(samples), np.nan)
    nothing = BinValues(unknown, unknown, (BinStatus.UNOBSERVABLE,) * len(samples))
    return WheelsetGeometry(
        bin_edges=bins.edges,
        samples=samples,
        rolling_radius_sum=nothing,
        rolling_radius_difference=_difference(curve, bins.edges),
        contact_angle_sum=nothing,
        contact_angle_difference=nothing,
        amplitude=curve.amplitude,
        conicity=curve.conicity,
        reported_amplitude=amplitude,
        equivalent_conicity=best,
        nonlinearity=curve.nonlinearity,
        zero_crossing=curve.zero_crossing,
        windows=curve.stretches,
        parameter_key=bins.parameter_key,
        status=best.status,
        reason=best.reason,
    )


def _difference(curve: CurveEstimate, edges: FloatArray) -> BinValues:
    """Return rL - rR at the bin centres that lie within the curve."""
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
