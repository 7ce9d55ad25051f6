"""A smooth curve through noisy points along their arc: a quintic spline whose penalty follows the data.

The penalty is on the third derivative, weighted by the inverse of its local variance, which maximises the evidence
(MacKay, 1992), so that corners and joints of arcs are kept where the data show them. Its level minimises the
generalised cross-validation score (Craven and Wahba, 1979), or, where the noise is known, Mallows' Cp; the covariance
is that of Wahba (1983). Points of a known design are fitted by this design and a spline, the difference. See
``docs/decisions/measured-profile-smoothing.md``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import nnls

from estimation.contact.design_curve import DesignCurve
from estimation.contact.parameters import PROFILES
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays
from estimation.values.units import STD_PER_MAD

DEGREE = 5
ORDER = 3  # of the penalised derivative
BAND = DEGREE + 5  # of the normal equations; noise that is alike links points up to 2 mm apart
_PRODUCTS = tuple(2.0 * product / 4.375 for product in (-3.5, 1.75, -0.5, 0.0625))
"""Of the coefficients 1/4, -1, 3/2, -1, 1/4 of the differences with themselves, 1 to 4 steps on."""


_TINY = PROFILES.tiny_variance
_MIDDLE = 0.5  # of a chord between two neighbours


@dataclass(frozen=True, slots=True)
class PenalisedSpline(FrozenArrays):
    """The spline and how well it is known; mm."""

    coefficients: Annotated[FloatArray, "k", 2]  # mm
    knots: Annotated[FloatArray, f"k + {DEGREE + 1}"]  # mm of arc
    root: Annotated[FloatArray, "k", "k"]  # mm: square root of the covariance of the coefficients of either coordinate
    noise_std: float  # mm, root mean square across the curve
    residual: Annotated[FloatArray, "n"]  # mm, of each point across the curve
    design: DesignCurve | None = None  # to which the spline is added

    def at(self, arc: FloatArray, coefficients: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return points and derivatives (n, 2) at arc (n,), mm; of other coefficients, if some are given."""
        return _curve(arc, self.knots, self.coefficients if coefficients is None else coefficients, self.design)


def _curve(
    arc: FloatArray, knots: FloatArray, coefficients: FloatArray, design: DesignCurve | None
) -> tuple[FloatArray, FloatArray]:
    spline = BSpline(knots, coefficients, DEGREE)
    point, derivative = np.asarray(spline(arc)), np.asarray(spline(arc, nu=1))
    if design is None:
        return point, derivative
    at, tangent = design.at(arc)
    return at + point, tangent + derivative


@dataclass(frozen=True, slots=True)
class _Fit:
    coefficients: FloatArray  # (k, 2)
    covariance: FloatArray  # (k, k) of either coordinate, for unit weights
    noise: float  # variance, mm^2
    local: FloatArray  # (k - ORDER,) variance of the third difference
    freedom: float  # equivalent number of parameters


def fit_spline(
    points: FloatArray, weight: FloatArray, noise_std: float | None, design: DesignCurve | None = None
) -> PenalisedSpline:
    """Return the smooth curve through points and its uncertainty.

    Args:
        points, weight: (n, 2) mm, in their order along the curve; (n,) 1, or 0 for points that are left out.
        noise_std: Of the points across the curve, mm; None if it is to be estimated.
        design: The curve is the sum of this and a spline; without, the spline is all of it.
    """
    arc, spacing = _first_arc(points)
    arc = arc if design is None else design.foot(points)
    weights = weight.copy()
    rough, length = correlated_noise(points)
    noise = noise_std**2 if noise_std is not None else max(rough**2, _TINY)
    for rounds in (PROFILES.first_fit_rounds, PROFILES.fit_rounds):
        knots, basis = _basis(arc, spacing)
        rows = _whitened(points - design.at(arc)[0] if design else points, basis, weights, arc, length)
        fit = _evidence_fit(rows, noise, rounds, known=noise_std is not None, pooled=_on_design(design, knots))
        arc, residual, tangent = _projected(points, arc, knots, fit.coefficients, design)
        if noise_std is None:
            weights = weight * _relative_precision(tangent, residual, weight)
    knots, basis = _basis(arc, spacing)
    rows = _whitened(points - design.at(arc)[0] if design else points, basis, weights, arc, length)
    pooled = _on_design(design, knots)
    fit = _evidence_fit(rows, fit.noise, PROFILES.fit_rounds, known=noise_std is not None, pooled=pooled)
    if design is None:
        fit = _levelled(rows, fit, known=noise_std is not None)
    _, residual, _ = _projected(points, arc, knots, fit.coefficients, design)
    root = np.asarray(np.linalg.cholesky(fit.covariance * PROFILES.penalty_widening**2), dtype=np.float64)
    return PenalisedSpline(fit.coefficients, knots, root, float(np.sqrt(fit.noise)), residual, design)


def _on_design(design: DesignCurve | None, knots: FloatArray) -> BoolArray | None:
    """Return of which third differences (k - ORDER,) the points were found to be those of the design."""
    if design is None:
        return None
    middle = 0.5 * (knots[ORDER + 1 : -DEGREE] + knots[DEGREE : -ORDER - 1])
    return np.asarray((middle >= design.inner[0]) & (middle <= design.inner[1]))


def correlated_noise(points: FloatArray) -> tuple[float, float]:
    """Return the noise of points (n, 2) across their curve, and the arc over which it is alike, all mm; before any fit.

    Fourth differences at several distances: of white noise they are alike, of noise that neighbours share they grow
    with the distance. The correlation is taken as exponential.
    """
    spacing = float(np.median(np.hypot(*np.diff(points, axis=0).T)))
    steps = sorted({max(1, round(distance / max(spacing, _TINY))) for distance in PROFILES.noise_distances})
    steps = [step for step in steps if step == 1 or PROFILES.fewest_difference_spans * step < len(points)]
    found = np.log([max(rough_noise(points, step) ** 2, _TINY) for step in steps])
    best = (np.inf, 0.0, 0.0)
    white = np.inf
    for length in PROFILES.correlation_lengths:
        alike = np.exp(-np.outer(np.array(steps) * spacing, np.arange(1, 5)) / length) if length else np.zeros((1, 4))
        expected = np.log(np.maximum(1.0 + alike @ np.array(_PRODUCTS), PROFILES.least_variance_share))
        level = float(np.mean(found - expected))
        cost = float(((found - expected - level) ** 2).sum())
        white = cost if length == 0.0 else white
        best = min(best, (cost, length, level))
    cost, length, level = best
    if white - cost < PROFILES.significant_correlation:
        return float(np.exp(0.5 * np.mean(found))), 0.0
    return float(np.exp(0.5 * level)), length


def rough_noise(points: FloatArray, step: int = 1) -> float:
    """Return the noise of points (n, 2) across their curve from differences of neighbours, mm: robust, before a fit."""
    if len(points) < 4 * step + 1:
        return 0.0
    chord = points[2 * step :] - points[: -2 * step]
    length = np.maximum(np.hypot(chord[:, 0], chord[:, 1]), _TINY)
    offset = points[step:-step] - points[: -2 * step]
    share = (offset * chord).sum(axis=1) / length**2
    height = (offset[:, 1] * chord[:, 0] - offset[:, 0] * chord[:, 1]) / length
    bend = np.where(np.abs(share - _MIDDLE) < _MIDDLE, height, 0.0)
    rest = bend[step:-step] - 0.5 * (bend[: -2 * step] + bend[2 * step :])
    return float(STD_PER_MAD * np.median(np.abs(rest)) / np.sqrt(4.375))


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
    first, last = float(arc.min()), float(arc.max())
    count = max(2 * DEGREE, round((last - first) / max(PROFILES.knot_step, spacing)))
    knots: FloatArray = first + (last - first) / count * np.arange(-DEGREE, count + DEGREE + 1, dtype=np.float64)
    inside = np.clip(arc, knots[DEGREE], knots[-DEGREE - 1])
    return knots, np.asarray(BSpline.design_matrix(inside, knots, DEGREE).toarray())


_Rows = tuple[FloatArray, FloatArray]


def _whitened(points: FloatArray, basis: FloatArray, weights: FloatArray, arc: FloatArray, length: float) -> _Rows:
    """Return design (m, k) and target (m, 2) of the points that count, their noise white and of one variance."""
    kept = weights > 0.0
    scale = np.sqrt(weights[kept])[:, np.newaxis]
    design, target = basis[kept] * scale, points[kept] * scale
    if length == 0.0:
        return design, target
    gap = np.abs(np.diff(arc[kept]))
    correlation = np.minimum(np.exp(-gap / length), PROFILES.most_correlation)
    alike = np.where(gap > PROFILES.correlated_reach, 0.0, correlation)[:, np.newaxis]
    own = np.sqrt(1.0 - alike**2)
    return (
        np.concatenate([design[:1], (design[1:] - alike * design[:-1]) / own]),
        np.concatenate([target[:1], (target[1:] - alike * target[:-1]) / own]),
    )


def _evidence_fit(rows: _Rows, noise: float, rounds: int, *, known: bool, pooled: BoolArray | None = None) -> _Fit:
    """Return the fit whose variance of third differences, local or ``pooled``, explains points best (MacKay)."""
    local = np.full(rows[0].shape[1] - ORDER, (PROFILES.first_third_derivative * PROFILES.knot_step**ORDER) ** 2)
    least = (PROFILES.least_third_derivative * PROFILES.knot_step**ORDER) ** 2
    normal = rows[0].T @ rows[0], rows[0].T @ rows[1]
    fit = _posterior(normal, noise, local)
    for _ in range(rounds):
        third = np.diff(fit.coefficients, n=ORDER, axis=0)
        variance = np.diff(np.diff(fit.covariance, n=ORDER, axis=0), n=ORDER, axis=1).diagonal()
        determined = np.clip(1.0 - variance / fit.local, PROFILES.least_determined_share, 1.0)
        squares = (third**2).sum(axis=1)
        local = np.maximum(_over_neighbours(squares) / _over_neighbours(determined), least)
        if pooled is not None:
            unseen = (PROFILES.unseen_third_derivative * np.sqrt(noise) * PROFILES.knot_step**ORDER) ** 2
            local[pooled] = max(float(squares[pooled].sum() / determined[pooled].sum()), unseen)
        noise = fit.noise if known else _noise(rows, fit)
        fit = _posterior(normal, noise, local)
    return fit


def _over_neighbours(values: FloatArray) -> FloatArray:
    reach = PROFILES.variance_neighbours
    kernel = np.bartlett(2 * reach + 3)[1:-1]
    return np.asarray(np.convolve(np.pad(values, reach, mode="edge"), kernel / kernel.sum(), "valid"))


def _levelled(rows: _Rows, fit: _Fit, *, known: bool) -> _Fit:
    design, target = rows
    n = float(len(design))
    normal = design.T @ design, design.T @ target
    best, lowest = fit, np.inf
    for level in PROFILES.levels:
        tried = _posterior(normal, fit.noise, fit.local * level)
        squares = float(((target - design @ tried.coefficients) ** 2).sum())
        score = squares / n + 2.0 * fit.noise * tried.freedom / n if known else n * squares / (n - tried.freedom) ** 2
        if score < lowest:
            best, lowest = tried, score
    if known:
        return best
    noise = _noise(rows, best)
    return _Fit(best.coefficients, best.covariance * (noise / best.noise), noise, best.local, best.freedom)


def _posterior(normal: tuple[FloatArray, FloatArray], noise: float, local: FloatArray) -> _Fit:
    gram, moment = normal
    k = len(gram)
    difference = np.diff(np.eye(k), n=ORDER, axis=0)
    precision = gram / noise + difference.T @ (difference / local[:, np.newaxis])
    width = min(BAND, k - 1)
    banded = np.zeros((width + 1, k))
    for offset in range(width + 1):
        banded[width - offset, offset:] = np.diagonal(precision, offset)
    covariance = cho_solve_banded((cholesky_banded(banded), False), np.eye(k))
    covariance = 0.5 * (covariance + covariance.T)
    return _Fit(covariance @ moment / noise, covariance, noise, local, float((covariance * gram).sum() / noise))


def _noise(rows: _Rows, fit: _Fit) -> float:
    design, target = rows
    squares = float(((target - design @ fit.coefficients) ** 2).sum())
    return max(squares / max(len(design) - fit.freedom, 1.0), _TINY)


def _projected(
    points: FloatArray, arc: FloatArray, knots: FloatArray, coefficients: FloatArray, design: DesignCurve | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the arc length of each point's foot on the curve, its signed distance, and the tangent (n, 2) there."""
    inside = np.clip(arc, knots[DEGREE], knots[-DEGREE - 1])
    at, tangent = _curve(inside, knots, coefficients, design)
    rest = points - at
    speed = np.maximum((tangent**2).sum(axis=1), _TINY)
    foot = np.clip(inside + (rest * tangent).sum(axis=1) / speed, knots[DEGREE], knots[-DEGREE - 1])
    across = (rest[:, 1] * tangent[:, 0] - rest[:, 0] * tangent[:, 1]) / np.sqrt(speed)
    if design is not None:  # whose arc is that of the curve but for the slope of the difference
        return foot, across, tangent
    fine = np.linspace(knots[DEGREE], knots[-DEGREE - 1], 8 * len(coefficients))
    length = np.concatenate(
        [[0.0], np.cumsum(np.hypot(*np.diff(_curve(fine, knots, coefficients, None)[0], axis=0).T))]
    )
    return np.interp(foot, fine, length), across, tangent


def _relative_precision(tangent: FloatArray, residual: FloatArray, weight: FloatArray) -> FloatArray:
    """Return weights (n,), geometric mean 1: noise has one variance in height (cos^2) and one laterally (sin^2)."""
    share = tangent**2 / np.maximum((tangent**2).sum(axis=1), _TINY)[:, np.newaxis]  # cos^2, sin^2
    variance = np.full(len(residual), max(float((weight @ residual**2) / weight.sum()), _TINY))
    for _ in range(PROFILES.noise_rounds):
        scaled = np.sqrt(weight) / variance
        found, _ = nnls(share * scaled[:, np.newaxis], residual**2 * scaled)
        found = np.maximum(found, max(PROFILES.least_noise_share * float(found.max()), _TINY))
        variance = share @ found
    return np.asarray(np.exp(np.log(variance).mean()) / variance)
