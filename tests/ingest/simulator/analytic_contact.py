"""Contact geometries given by formulas: a pair of cones, and a smooth asymmetric pair that is also gauge dependent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray

HALF = 0.7452
RADIUS = 0.45


@dataclass(frozen=True)
class AnalyticTable:
    lateral_displacement: FloatArray
    gauge_deviation: FloatArray
    rolling_radius_left: FloatArray
    rolling_radius_right: FloatArray
    contact_angle_left: FloatArray
    contact_angle_right: FloatArray
    roll: FloatArray


def cones(conicity: float, angle_slope: float = 0.0, roll_slope: float = 0.0) -> AnalyticTable:
    x = np.linspace(-20e-3, 20e-3, 41)[:, np.newaxis]
    return AnalyticTable(
        x[:, 0],
        np.zeros(1),
        RADIUS + conicity * x,
        RADIUS - conicity * x,
        conicity + angle_slope * x,
        conicity - angle_slope * x,
        roll_slope * x,
    )


def smooth_pair(step: float = 0.05e-3) -> AnalyticTable:
    """Worn-like and unsymmetric; no two of the seven tables are equal or mirrored."""
    n = round(8e-3 / step)
    x = step * np.arange(-n, n + 1)[:, np.newaxis]
    e = 1e-3 * np.arange(-4, 5)[np.newaxis, :]
    left, right = x - 0.5 * e, -x - 0.5 * e
    return AnalyticTable(
        x[:, 0],
        e[0],
        RADIUS + 1.2e-3 * np.tanh(left / 3e-3) + 12.0 * left**2,
        RADIUS + 0.9e-3 * np.tanh(right / 2.5e-3) + 9.0 * right**2,
        0.06 + 25.0 * left + 900.0 * left**2,
        0.05 + 18.0 * right + 700.0 * right**2,
        0.12 * x + 4.0 * x**2 - 0.02 * e + 6.0 * x * e,
    )
