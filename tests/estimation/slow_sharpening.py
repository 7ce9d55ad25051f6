"""Sharpening done slowly: the blur by quadrature, the problem built cell by cell, a general solver with bounds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import lsq_linear

from estimation.values.arrays import FloatArray

WIDTH = 0.25e-3  # m of a bin
CELLS = 8
CELL = WIDTH / CELLS
SHARES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.0)
MOST_MISFIT = 1.0


@dataclass(frozen=True, slots=True)
class SlowSharpening:
    """A curve without a blur, and how far it is from the nodes."""

    displacement: FloatArray
    curve: FloatArray
    blur: float
    misfit: float  # rms, in std of the nodes


def node_values(low: FloatArray, samples: FloatArray) -> FloatArray:
    """Return quadratics fitted to evenly spread samples (bins, n) at edges and centres."""
    n = samples.shape[1]
    u = (np.arange(n) + 0.5) / n - 0.5
    fitted = [np.polynomial.Polynomial.fit(u, row, 2, domain=[-1, 1]) for row in samples]
    values = []
    for b, quadratic in enumerate(fitted):
        values.append(0.5 * (fitted[b - 1](0.5) + quadratic(-0.5)) if b else quadratic(-0.5))
        values.append(quadratic(0.0))
    assert len(low) == len(fitted)
    return np.array([*values, fitted[-1](0.5)])


def sample_places(low: FloatArray, n: int) -> FloatArray:
    """Return where samples are that are spread evenly over bins: (bins, n), m."""
    return low[:, None] + WIDTH * (np.arange(n) + 0.5) / n


def mean_ramp(distance: FloatArray, blur: float) -> FloatArray:
    """Return the mean of max(d + error, 0) over a normal error, by the trapezoidal rule."""
    if blur == 0.0:
        return np.maximum(distance, 0.0)
    z = np.linspace(-8.0, 8.0, 4_001)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    once, back = np.unique(np.round(distance / 1e-9), return_inverse=True)
    mean = np.array([np.trapezoid(density * np.maximum(1e-9 * d + blur * z, 0.0), z) for d in once])
    return np.asarray(mean[back].reshape(distance.shape))


@cache
def slow_response(bins: int, beyond: int, blur: float) -> FloatArray:
    """Return what an offset of 1 and a slope of 1 in each cell make of the nodes: (2 bins + 1, 1 + cells)."""
    low = WIDTH * np.arange(bins)
    edges = CELL * np.arange(-beyond, CELLS * bins + beyond + 1)
    ramps = mean_ramp(sample_places(low, 8)[..., None] - edges, blur)
    columns = [node_values(low, ramps[..., k] - ramps[..., k + 1]) for k in range(len(edges) - 1)]
    return np.stack([np.ones(2 * bins + 1), *columns], axis=1)


def slow_with_blur(low: FloatArray, nodes: FloatArray, std: FloatArray, blur: float) -> SlowSharpening:
    """Return the curve whose slopes, blurred, come nearest to the nodes."""
    beyond = max(CELLS, int(np.ceil(3.0 * blur / CELL)))
    edges = low[0] + CELL * np.arange(-beyond, CELLS * len(low) + beyond + 1)
    response = slow_response(len(low), beyond, blur)
    weight = 1.0 / np.sqrt(std**2 + 5e-6**2)
    changes = np.diff(np.eye(len(edges) - 1), axis=0)
    system = np.vstack(
        [weight[:, None] * response, np.column_stack([np.zeros(len(changes)), max(0.25, blur / 0.4e-3) * changes])]
    )
    wanted = np.append(weight * nodes, np.zeros(len(changes)))
    centre_slope = np.diff(nodes[1::2]) / WIDTH
    least = min(0.0, 2.0 * float(centre_slope.min()))
    bounds = (np.append(-np.inf, np.full(len(edges) - 1, least)), np.inf)
    found = lsq_linear(system, wanted, bounds, method="bvls", tol=1e-14).x
    misfit = float(np.sqrt(np.mean((weight * (response @ found - nodes)) ** 2)))
    curve = found[0] + np.append(0.0, CELL * np.cumsum(found[1:]))
    inside = slice(beyond, len(edges) - beyond)
    return SlowSharpening(edges[inside], curve[inside], blur, misfit)


def slow_sharpened(low: FloatArray, nodes: FloatArray, std: FloatArray, longest: float) -> SlowSharpening | None:
    """Return the curve without the longest blur that the nodes allow."""
    for share in SHARES:
        found = slow_with_blur(low, nodes, std, share * longest)
        if found.misfit <= MOST_MISFIT:
            return found
    return None
