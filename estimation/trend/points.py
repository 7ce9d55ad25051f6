"""The points of a trend as columns: values with their standard deviations, and what is noise of these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.trend.parameters import CURVES
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.trend import TrendPoint


@dataclass(frozen=True, slots=True)
class PointColumns:
    """The points of a trend, in order of mileage."""

    mileage_km: FloatArray
    measured_ns: IntArray
    value: FloatArray
    std: FloatArray
    noise: FloatArray  # part of it that differs from point to point

    @property
    def shared(self) -> FloatArray:
        """Of each point the std of what its error has in common with others (k,)."""
        return np.asarray(np.sqrt(np.maximum(self.std**2 - self.noise**2, 0.0)))

    @property
    def shared_std(self) -> float:
        """What the errors of all points have in common, as it is at the newest: it may grow with the value."""
        return float(np.median(self.shared[-CURVES.last_shared :]))


def columns_of(points: Sequence[TrendPoint], smallest_std: float) -> PointColumns:
    """Return the points that are numbers, in order of mileage; no std is below the smallest one."""
    usable = sorted(
        (p for p in points if np.isfinite([p.mileage_km, p.value, p.std]).all() and p.std > 0.0),
        key=lambda p: (p.mileage_km, p.measured_ns, p.value, p.std),
    )
    return PointColumns(
        np.array([p.mileage_km for p in usable], dtype=np.float64),
        np.array([p.measured_ns for p in usable], dtype=np.int64),
        np.array([p.value for p in usable], dtype=np.float64),
        np.array([max(p.std, smallest_std) for p in usable], dtype=np.float64),
        np.array([_noise(p, smallest_std) for p in usable], dtype=np.float64),
    )


def _noise(point: TrendPoint, smallest_std: float) -> float:
    """Return the part of an error that differs from point to point; one that is no number is all of it."""
    noise = point.noise if point.noise is not None and np.isfinite(point.noise) else point.std
    return max(min(noise, point.std), smallest_std)
