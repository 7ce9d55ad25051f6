"""A smooth curve through noisy points along their arc: a quintic spline whose penalty follows the data.

Both coordinates are splines of the arc length s. The penalty is on their third derivative, the change of curvature,
so that straight lines and arcs, of which new profiles consist, cost next to nothing. Its weight varies along the arc:
it is the inverse of the local variance of the third derivative, which maximises the evidence (MacKay, 1992; over
neighbouring coefficients together), so that a corner, or a joint of two arcs, is kept where the data show one. The
level of the penalty then minimises the generalised cross-validation score (Craven and Wahba, 1979), or, where the
noise is known, the unbiased estimate of the risk (Mallows' Cp). The covariance is that of Wahba's Bayesian model
(1983), for white noise with one variance in height and one in lateral position.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import nnls

from estimation.values.arrays import FloatArray, frozen_array

DEGREE = 5
ORDER = 3  # of the penalised derivative
KNOT_STEP = 0.5  # mm of arc, unless points are farther apart
NEIGHBOURS = 4  # to either side, over which the local variance is averaged
NOISE_ROUNDS = 4
LEAST_NOISE = 0.05  # of the larger variance, height or lateral
FIRST_ROUNDS, ROUNDS = 8, 15
UNKNOWN_PENALTY = 1.3
"""Factor on the std for what Wahba's model leaves out: the penalty is an estimate too, and joints of arcs are rounded.
The bench of contact geometry (noise on every design profile) shows what it covers.
"""

FIRST_THIRD_DERIVATIVE = 1e-2  # 1/mm^2, where the search for the local variance begins
LEAST_THIRD_DERIVATIVE = 1e-5  # 1/mm^2
LEAST_DETERMINED = 1e-3
LEVELS = tuple(float(10.0**exponent) for exponent in np.arange(-2.0, 2.01, 0.25))
_TINY = 1e-20
_MIDDLE = 0.5  # of a chord between two neighbours


@dataclass(frozen=True, slots=True)
class PenalisedSpline:
    """The spline and how well it is known; mm."""

    knots: FloatArray  # (k + DEGREE + 1,) mm of arc
    coefficients: FloatArray  # (k, 2) mm
    root: FloatArray  # (k, k) mm: square root of the covariance of the coefficients of either coordinate
    noise_std: float  # mm, root mean square across the curve
    residual: FloatArray  # (n,) mm, of each point across the curve

    def __post_init__(self) -> None:
        k = len(self.coefficients)
        object.__setattr__(self, "knots", frozen_array(self.knots, (k + DEGREE + 1,), name="knots"))
        object.__setattr__(self, "coefficients", frozen_array(self.coefficients, (k, 2), name="coefficients"))
        object.__setattr__(self, "root", frozen_array(self.root, (k, k), name="root"))
        object.__setattr__(self, "residual", frozen_array(self.residual, (None,), name="residual"))


@dataclass(frozen=True, slots=True)
class _Fit:
    coefficients: FloatArray  # (k, 2)
    covariance: FloatArray  # (k, k) of either coordinate, for unit weights
    noise: float  # variance, mm^2
    local: FloatArray  # (k - ORDER,) variance of the third difference
    freedom: float  # equivalent number of parameters


def fit_spline(points: FloatArray, weight: FloatArray, noise_std: float | None) -> PenalisedSpline:
    """Return the smooth curve through points and its uncertainty.

    Parameters
    ----------
    points
        (n, 2) mm, in their order along the curve.
    weight
        (n,) 1, or 0 for points that are left out.
    noise_std
        Of the points across the curve, mm; None if it is to be estimated.
    """
    arc, spacing = _first_arc(points)
    weights = weight.copy()
    noise = noise_std**2 if noise_std is not None else max(rough_noise(points) ** 2, _TINY)
    for rounds in (FIRST_ROUNDS, ROUNDS):
        knots, basis = _basis(arc, spacing)
        fit = _evidence_fit(points, basis, weights, noise, rounds, known=noise_std is not None)
        arc, residual, tangent = _projected(points, arc, knots, fit.coefficients)
        if noise_std is None:
            weights = weight * _relative_precision(tangent, residual, weight)
    knots, basis = _basis(arc, spacing)
    fit = _evidence_fit(points, basis, weights, fit.noise, ROUNDS, known=noise_std is not None)
    fit = _levelled(points, basis, weights, fit, known=noise_std is not None)
    _, residual, _ = _projected(points, arc, knots, fit.coefficients)
    scale = UNKNOWN_PENALTY**2 * _correlation_factor(residual[weight > 0.0])
    root = np.asarray(np.linalg.cholesky(fit.covariance * scale), dtype=np.float64)
    return PenalisedSpline(knots, fit.coefficients, root, float(np.sqrt(fit.noise)), residual)


def rough_noise(points: FloatArray) -> float:
    """Return the noise of points across their curve from second differences of neighbours, mm: robust, before any fit.

    Parameters
    ----------
    points
        (n, 2) mm, in their order along the curve.
    """
    chord = points[2:] - points[:-2]
    length = np.maximum(np.hypot(chord[:, 0], chord[:, 1]), _TINY)
    offset = points[1:-1] - points[:-2]
    share = (offset * chord).sum(axis=1) / length**2
    height = (offset[:, 1] * chord[:, 0] - offset[:, 0] * chord[:, 1]) / length
    bend = np.where(np.abs(share - _MIDDLE) < _MIDDLE, height, 0.0)
    rest = bend[1:-1] - 0.5 * (bend[:-2] + bend[2:])
    return float(1.4826 * np.median(np.abs(rest)) / np.sqrt(4.375)) if len(rest) else 0.0


def _first_arc(points: FloatArray) -> tuple[FloatArray, float]:
    """Return the arc length (n,) along the running mean of the points, and the median distance of two of them."""
    spacing = float(np.median(np.hypot(*np.diff(points, axis=0).T)))
    half = max(1, round(0.5 / max(spacing, 0.02)))
    half = min(half, (len(points) - 1) // 2)
    padded = np.pad(points, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    kernel = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    mean = np.column_stack([np.convolve(padded[:, axis], kernel, "valid") for axis in (0, 1)])
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(mean, axis=0).T))])
    return arc, float(np.median(np.diff(arc)))


def _basis(arc: FloatArray, spacing: float) -> tuple[FloatArray, FloatArray]:
    """Return uniform knots over the arc and the basis functions (n, k) at it."""
    first, last = float(arc.min()), float(arc.max())
    count = max(2 * DEGREE, round((last - first) / max(KNOT_STEP, spacing)))
    knots: FloatArray = first + (last - first) / count * np.arange(-DEGREE, count + DEGREE + 1, dtype=np.float64)
    inside = np.clip(arc, knots[DEGREE], knots[-DEGREE - 1])
    return knots, np.asarray(BSpline.design_matrix(inside, knots, DEGREE).toarray())


def _evidence_fit(
    points: FloatArray, basis: FloatArray, weights: FloatArray, noise: float, rounds: int, *, known: bool
) -> _Fit:
    """Return the fit whose local variance of the third difference explains the points best (MacKay's fixed point).

    The variance is the sum of squares over the number of well-determined differences, both over the neighbours.
    """
    local = np.full(basis.shape[1] - ORDER, (FIRST_THIRD_DERIVATIVE * KNOT_STEP**ORDER) ** 2)
    least = (LEAST_THIRD_DERIVATIVE * KNOT_STEP**ORDER) ** 2
    normal = _normal(points, basis, weights)
    fit = _posterior(normal, noise, local)
    for _ in range(rounds):
        third = np.diff(fit.coefficients, n=ORDER, axis=0)
        variance = np.diff(np.diff(fit.covariance, n=ORDER, axis=0), n=ORDER, axis=1).diagonal()
        determined = np.clip(1.0 - variance / fit.local, LEAST_DETERMINED, 1.0)
        local = np.maximum(_over_neighbours((third**2).sum(axis=1)) / _over_neighbours(determined), least)
        noise = fit.noise if known else _noise(points, basis, weights, fit)
        fit = _posterior(normal, noise, local)
    return fit


def _over_neighbours(values: FloatArray) -> FloatArray:
    kernel = np.bartlett(2 * NEIGHBOURS + 3)[1:-1]
    return np.asarray(np.convolve(np.pad(values, NEIGHBOURS, mode="edge"), kernel / kernel.sum(), "valid"))


def _levelled(points: FloatArray, basis: FloatArray, weights: FloatArray, fit: _Fit, *, known: bool) -> _Fit:
    """Return the fit at the level of the penalty with the best score."""
    n = float(np.count_nonzero(weights))
    normal = _normal(points, basis, weights)
    best, lowest = fit, np.inf
    for level in LEVELS:
        tried = _posterior(normal, fit.noise, fit.local * level)
        squares = float((weights * ((points - basis @ tried.coefficients) ** 2).sum(axis=1)).sum())
        score = squares / n + 2.0 * fit.noise * tried.freedom / n if known else n * squares / (n - tried.freedom) ** 2
        if score < lowest:
            best, lowest = tried, score
    if known:
        return best
    noise = _noise(points, basis, weights, best)
    return _Fit(best.coefficients, best.covariance * (noise / best.noise), noise, best.local, best.freedom)


_Normal = tuple[FloatArray, FloatArray]


def _normal(points: FloatArray, basis: FloatArray, weights: FloatArray) -> _Normal:
    weighted = basis * weights[:, np.newaxis]
    return weighted.T @ basis, weighted.T @ points


def _posterior(normal: _Normal, noise: float, local: FloatArray) -> _Fit:
    """Return mean and covariance of the coefficients, given noise and the variance of their third differences."""
    gram, moment = normal
    k = len(gram)
    difference = np.diff(np.eye(k), n=ORDER, axis=0)
    precision = gram / noise + difference.T @ (difference / local[:, np.newaxis])
    banded = np.zeros((DEGREE + 1, k))
    for offset in range(DEGREE + 1):
        banded[DEGREE - offset, offset:] = np.diagonal(precision, offset)
    covariance = cho_solve_banded((cholesky_banded(banded), False), np.eye(k))
    covariance = 0.5 * (covariance + covariance.T)
    return _Fit(covariance @ moment / noise, covariance, noise, local, float((covariance * gram).sum() / noise))


def _noise(points: FloatArray, basis: FloatArray, weights: FloatArray, fit: _Fit) -> float:
    squares = float((weights * ((points - basis @ fit.coefficients) ** 2).sum(axis=1)).sum())
    return max(squares / max(np.count_nonzero(weights) - fit.freedom, 1.0), _TINY)


def _projected(
    points: FloatArray, arc: FloatArray, knots: FloatArray, coefficients: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the arc length of each point's foot on the curve, its signed distance, and the tangent (n, 2) there."""
    curve = BSpline(knots, coefficients, DEGREE)
    inside = np.clip(arc, knots[DEGREE], knots[-DEGREE - 1])
    tangent = curve(inside, nu=1)
    rest = points - curve(inside)
    speed = np.maximum((tangent**2).sum(axis=1), _TINY)
    foot = np.clip(inside + (rest * tangent).sum(axis=1) / speed, knots[DEGREE], knots[-DEGREE - 1])
    across = (rest[:, 1] * tangent[:, 0] - rest[:, 0] * tangent[:, 1]) / np.sqrt(speed)
    fine = np.linspace(knots[DEGREE], knots[-DEGREE - 1], 8 * len(coefficients))
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve(fine), axis=0).T))])
    return np.interp(foot, fine, length), across, tangent


def _relative_precision(tangent: FloatArray, residual: FloatArray, weight: FloatArray) -> FloatArray:
    """Return weights (n,), geometric mean 1: the noise has one variance in height and one in lateral position.

    Across a surface at angle a its variance is that in height times cos^2 a and the lateral one times sin^2 a.
    """
    share = tangent**2 / np.maximum((tangent**2).sum(axis=1), _TINY)[:, np.newaxis]  # cos^2, sin^2
    variance = np.full(len(residual), max(float((weight @ residual**2) / weight.sum()), _TINY))
    for _ in range(NOISE_ROUNDS):
        scaled = np.sqrt(weight) / variance
        found, _ = nnls(share * scaled[:, np.newaxis], residual**2 * scaled)
        found = np.maximum(found, max(LEAST_NOISE * float(found.max()), _TINY))
        variance = share @ found
    return np.asarray(np.exp(np.log(variance).mean()) / variance)


def _correlation_factor(residual: FloatArray) -> float:
    """Return by how much noise that is alike in neighbouring points raises the variance of local means."""
    n = len(residual)
    scaled = residual - residual.mean()
    power = float(scaled @ scaled)
    factor = 1.0
    for lag in range(1, min(20, n // 4)):
        correlation = float(scaled[lag:] @ scaled[:-lag]) / max(power, _TINY)
        if correlation < 2.0 / np.sqrt(n):
            break
        factor += 2.0 * correlation
    return factor
