"""What measured profiles say of the error that all points of a trend have in common.

The estimate of point i is the truth, plus ``c_i`` and ``a_i s`` which points have in common, plus noise: ``s`` is the
error of the scale in its standard deviations, normal as ``c_i`` is. The ``c_i`` are the more alike, the more alike
their stated sizes are: where the conicity has come to a jump of the contact, what was measured before it says little.
A measured profile shows estimate less truth at its date, with the noise of both; the posterior is that of a joint
normal distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.trend.parameters import CALIBRATION, CalibrationParameters
from estimation.trend.points import PointColumns
from estimation.values.arrays import FloatArray
from estimation.values.quantities import standardised, with_interval
from estimation.values.trend import LevelCalibration, TrendPoint


@dataclass(frozen=True, slots=True)
class SharedError:
    """The error that all points have in common, as it is at the newest."""

    mean: FloatArray  # (2,) of the level, and of the scale in its stds
    covariance: FloatArray  # (2, 2)
    of_scale: float  # what the level has of the scale, per std of it
    scale_std: float  # relative, of all differences
    measured: LevelCalibration | None = None


def shared_error(
    points: PointColumns,
    level: float,
    scale_std: float,
    measured: Sequence[TrendPoint] = (),
    share: FloatArray | None = None,
    params: CalibrationParameters = CALIBRATION,
) -> SharedError:
    """Return the error that points (k,) have in common, at a level, beside measured profiles at their mileages.

    ``share`` is what the newest points (n,) count: the noise of an outlier is wider.
    """
    noise_std = points.noise.copy()
    if share is not None:
        noise_std[len(noise_std) - len(share) :] /= np.sqrt(share)
    known = [replace(p, std=max(p.std, params.least_std)) for p in measured]
    beside = [(p, int(np.argmin(np.abs(points.mileage_km - p.mileage_km)))) for p in known]
    beside = [(p, i) for p, i in beside if abs(points.mileage_km[i] - p.mileage_km) <= params.within_km]
    agree = [(p, i) for p, i in beside if abs(_z(points, p, i)) <= params.contradicting_stds]
    at = np.array([i for _, i in agree], dtype=np.int64)
    truth, std = (np.array([getattr(p, name) for p, _ in agree]) for name in ("value", "std"))
    shared = np.concatenate([[points.shared_std], points.shared[at]])
    scale = np.minimum(shared, scale_std * np.abs(np.concatenate([[level], points.value[at]])))  # a
    constant = np.sqrt(shared**2 - scale**2)  # std of c
    sizes = np.log(np.maximum(constant, params.least_size))
    alike = np.exp(-0.5 * (np.subtract.outer(sizes, sizes) / params.alike_sizes) ** 2)
    common = np.outer(constant, constant) * alike
    noise = np.diag(std**2) + noise_std[at] ** 2 * np.equal.outer(at, at)
    seen = np.stack([common[0, 1:], scale[1:]])  # (2, m) covariance of both with what is seen
    gain = seen @ np.linalg.inv(common[1:, 1:] + np.outer(scale[1:], scale[1:]) + noise)
    mean, covariance = gain @ (points.value[at] - truth), np.diag([constant[0] ** 2, 1.0]) - gain @ seen.T
    effect = np.array([1.0, scale[0]])
    left = float(np.sqrt(max(effect @ covariance @ effect, 0.0)))
    said = LevelCalibration(len(agree), len(beside) - len(agree), -float(effect @ mean), left, tuple(measured))
    return SharedError(mean, covariance, float(scale[0]), scale_std, said if beside else None)


def _z(points: PointColumns, measured: TrendPoint, at: int) -> float:
    estimated = with_interval(float(points.value[at]), float(points.std[at]))
    return standardised(estimated, with_interval(measured.value, measured.std)) or 0.0
