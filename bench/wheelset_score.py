"""How near the published geometry of a wheelset comes to the truth.

Band-limited signals carry no offset. Bins are therefore compared with the true curve counted from the place on it that
fits them best, and less its mean over the samples (R and D). The place is between the track centre and the true zero
crossing, or within 0.6 mm of either; it is not scored, and the zero crossing is published as unknown. Conicity and NP
do not depend on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from api.comparison.study import TrueWheelset, conicity_errors
from estimation.accuracy.fleet_accuracy import curve_origin
from estimation.values.arrays import FloatArray
from estimation.values.geometry import BinStatus, BinValues, WheelsetGeometry
from estimation.values.quantities import Estimate
from estimation.values.units import NORMAL_95


@dataclass(frozen=True, slots=True)
class Count:
    """Published numbers of a kind, and those whose 95 % interval holds the truth."""

    published: int = 0
    covered: int = 0

    def plus(self, published: int, covered: int) -> Count:
        """Return the sum."""
        return Count(self.published + published, self.covered + covered)


@dataclass(frozen=True, slots=True)
class WheelsetScore:
    """How near the geometry of one wheelset came."""

    serial: str
    error: float | None  # mean absolute error of the conicity over the amplitudes estimated; None without any
    signed: float | None  # mean error
    amplitudes: tuple[float | None, ...]  # error at each amplitude asked for
    conicity: Count
    difference: Count  # R per bin
    other_bins: Count  # S, A and D per bin; by the criterion of the geometry S and A are not published
    nonlinearity: Count
    zero_crossing: Count


def wheelset_score(found: WheelsetGeometry, truth: TrueWheelset) -> WheelsetScore:
    """Return how near ``found`` is to ``truth``."""
    compared = conicity_errors(found, truth)
    errors = [None if item is None else item[0] for item in compared]
    inside = [item[1] for item in compared if item is not None]
    conicity = Count(len(inside), sum(inside))
    given = [error for error in errors if error is not None]
    centre = found.bin_centres
    origin = curve_origin(found, truth.displacement, truth.difference, truth.zero_crossing)
    shift, mean = origin.displacement, origin.difference
    x = centre + shift
    others = Count()
    differences = np.interp(x, truth.displacement, truth.angle_difference)
    unknown = float(found.samples @ differences / found.samples.sum())  # lost with the means, like that of R
    for values, true_values in (
        (found.rolling_radius_sum, np.interp(x, truth.displacement, truth.radius_sum)),
        (found.contact_angle_sum, np.interp(x, truth.displacement, truth.angle_sum)),
        (found.contact_angle_difference, differences - unknown),
    ):
        others = others.plus(*_bins(values, true_values))
    return WheelsetScore(
        serial=truth.serial,
        error=float(np.mean(np.abs(given))) if given else None,
        signed=float(np.mean(given)) if given else None,
        amplitudes=tuple(errors),
        conicity=conicity,
        difference=Count(
            *_bins(found.rolling_radius_difference, np.interp(x, truth.displacement, truth.difference) - mean)
        ),
        other_bins=others,
        nonlinearity=_counted(Count(), found.nonlinearity, truth.nonlinearity),
        zero_crossing=_counted(Count(), found.zero_crossing, truth.zero_crossing),
    )


def _bins(values: BinValues, truth: FloatArray) -> tuple[int, int]:
    known = np.array([status is BinStatus.ESTIMATED for status in values.status])
    inside = np.abs(values.value[known] - truth[known]) <= NORMAL_95 * values.std[known]
    return int(known.sum()), int(inside.sum())


def _counted(count: Count, estimate: Estimate, truth: float) -> Count:
    if estimate.value is None or estimate.low is None or estimate.high is None or not np.isfinite(truth):
        return count
    return count.plus(1, int(estimate.low <= truth <= estimate.high))
