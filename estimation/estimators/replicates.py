"""From a curve and its replicates (blocks left out, parameters shifted) to a ``CurveEstimate``."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from estimation.contact.conicity import equivalent_conicity, zero_crossing
from estimation.estimators.interface import CurveEstimate, EstimatorParameters
from estimation.geometry.conicity import NO_AMPLITUDE, NO_OFFSET, NO_ZERO, not_covered, too_few_blocks
from estimation.geometry.uncertainty import SCALE_UNCERTAINTY
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Estimate, Status, jackknife_std, with_interval
from estimation.values.reasons import Reason

FEWEST_GROUPS = 4


@dataclass(frozen=True, slots=True)
class Replicates:
    """A curve over ``displacement``: from all data, with each group left out, shifted by each uncertainty.

    An estimator without groups gives none: then all that is uncertain is in ``shifted``, one standard deviation each.
    What the scales of R and of y - d leave unknown is added to that for every estimator (``with_scales``).
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
    if 0 < g < FEWEST_GROUPS:
        return nothing(too_few_blocks(g), parameters, curve.samples, curve.stretches)
    x, shifted = curve.displacement, with_scales(curve, parameters)
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
    known = any(item.value is not None for item in conicity)
    return CurveEstimate(
        displacement=x,
        difference=curve.all_data,
        difference_std=np.hypot(_spread(rows, g), np.sqrt(((shifted - curve.all_data) ** 2).sum(axis=0))),
        amplitude=amplitude,
        conicity=conicity,
        nonlinearity=nonlinearity,
        zero_crossing=crossing,
        samples=curve.samples,
        stretches=curve.stretches,
        status=Status.ESTIMATED if known else Status.UNESTIMATED,
        reason=None if known else NO_AMPLITUDE,
        own_std=_own_std(curve, values[0], amplitude),
    )


def with_scales(curve: Replicates, parameters: EstimatorParameters) -> FloatArray:
    """Return what is uncertain of a curve (p + 2, n), m, with R and y - d larger by one std of their scales.

    Args:
        parameters: Stds of the scales; that of y - d holds what integration and alignment leave unknown.
    """
    x, R, unknown = curve.displacement, curve.all_data, parameters.uncertainty
    stretch = np.hypot(SCALE_UNCERTAINTY if parameters.band_limited else 0.0, unknown.displacement)
    return np.vstack([curve.shifted, R * (1.0 + unknown.scale), np.interp(x / (1.0 + stretch), x, R)])


def _own_std(curve: Replicates, conicity: FloatArray, amplitude: FloatArray) -> FloatArray:
    """Return the std (k,) of the conicity by the covariance that the estimator itself states; NaN without one."""
    if not len(curve.own):
        return np.full(len(amplitude), np.nan)
    changed = [equivalent_conicity(curve.displacement, curve.all_data + row, amplitude) for row in curve.own]
    return np.asarray(np.linalg.norm(np.array(changed) - conicity, axis=0))


def estimate_of(values: FloatArray, groups: int, count: float, reason: Reason) -> Estimate:
    """Return one number with its interval from its replicates.

    Args:
        values: (1 + groups + p,) from all data, with each group left out, and with each of p uncertain parameters
            shifted by one std.
        count: How many stretches of running the number rests on.
        reason: Why it is unknown where a replicate is not finite.
    """
    if not np.isfinite(values).all():
        return Estimate.unknown(reason, count)
    systematic = float(np.sqrt(((values[groups + 1 :] - values[0]) ** 2).sum()))
    return with_interval(float(values[0]), float(_spread(values, groups)), systematic, max(groups, 2), count)


def _spread(rows: FloatArray, groups: int) -> FloatArray:
    """Return the jackknife's std of the first row; zero without groups."""
    return jackknife_std(rows[: groups + 1]) if groups else np.zeros(rows.shape[1:])
