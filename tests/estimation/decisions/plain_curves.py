"""Curves of rL - rR whose conicity is known, as replicates over bins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats

from estimation.geometry.conicity import CurveEstimates, CurveParameters, CurveReplicates, curve_estimates
from estimation.geometry.uncertainty import DisplacementError
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Estimate

WIDTH = 0.25e-3
EDGES = (np.arange(-28, 30) - 0.5) * WIDTH
CENTRE = 0.5 * (EDGES[:-1] + EDGES[1:])
BINS = len(CENTRE)
EXACT = DisplacementError(0.0, 0.0, 0.0)
PARAMETERS = CurveParameters()
CONE = 0.1  # tan gamma_e: rL - rR = 2 x 0.1 x
GROUPS = 6
AT_3 = PARAMETERS.amplitudes.index(3e-3)
STRETCHED = CONE * 0.02 * (1.0 + 2.0 * 0.02**2)  # rms over a scale of 0.02, to the second order


def line(slope: float, offset: float = 0.0) -> FloatArray:
    """Return the quadratics (b, 3) over u of a straight curve, m."""
    return np.column_stack([slope * (CENTRE - offset), np.full(BINS, slope * WIDTH), np.zeros(BINS)])


def cubic(linear: float = 2 * CONE, third: float = 3e3) -> FloatArray:
    """Return the quadratics that osculate a cubic at the centres."""
    value = linear * CENTRE + third * CENTRE**3
    slope = (linear + 3 * third * CENTRE**2) * WIDTH
    return np.column_stack([value, slope, 3 * third * CENTRE * WIDTH**2])


def curve(shape: FloatArray | None = None, *others: FloatArray, **changes: object) -> CurveReplicates:
    whole = line(2 * CONE) if shape is None else shape
    rows = np.stack([whole, *(others or (whole,) * GROUPS)])
    made = CurveReplicates(
        EDGES, rows, np.zeros((BINS, 0, 3)), np.ones(BINS, dtype=bool), EXACT, 8.0, band_limited=True
    )
    return replace(made, **changes)


def deviates() -> FloatArray:
    """Return eight values that stand for a normal distribution: in the middles of its eighths, of mean square one."""
    middles = stats.norm.ppf((2.0 * np.arange(8) + 1.0) / 16.0)
    return np.asarray(middles / np.sqrt(np.mean(middles**2)))


def estimates(item: CurveReplicates) -> CurveEstimates:
    return curve_estimates(item, PARAMETERS)


def std(estimate: Estimate) -> float:
    assert estimate.std is not None
    return estimate.std


def value(estimate: Estimate) -> float:
    assert estimate.value is not None
    return estimate.value


def nodes(item: CurveReplicates) -> tuple[FloatArray, list[FloatArray]]:
    """Return edges and centres (2 b + 1,) and every replicate there: the mean of both bins at an edge."""
    x, rows = [], []
    for replicate in item.difference:
        places, values = [], []
        for b, (r, slope, bend) in enumerate(replicate):
            left = r + slope * -0.5 + bend * 0.25
            if b:
                before = replicate[b - 1]
                left = 0.5 * (left + before[0] + before[1] * 0.5 + before[2] * 0.25)
            places += [EDGES[b], CENTRE[b]]
            values += [left, r]
        last = replicate[-1]
        x = np.array([*places, EDGES[-1]])
        rows.append(np.array([*values, last[0] + last[1] * 0.5 + last[2] * 0.25]))
    return np.asarray(x), rows


def usable(low: int, high: int) -> dict[str, object]:
    """Return that bins from ``low`` to ``high`` beside the middle can be used."""
    at = np.arange(BINS) - BINS // 2
    return {"usable": (at >= low) & (at <= high)}
