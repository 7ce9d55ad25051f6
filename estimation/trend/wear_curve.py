"""A robust wear curve through points with known standard deviations: level and slope now, and when a limit is reached.

Model, with x the distance or the time, scaled so that the last point is at 0 and the first at -1::

    value_i = a + b x_i + bend(x_i) + noise_i,    noise_i ~ N(0, (std_i^2 + tau^2) / lambda_i)

The bend has two parts. One is lasting: a change of slope that dies out exponentially over one observed span, so that
saturating or accelerating wear is carried on, damped, into the forecast. The other wanders: an integrated random walk
(at knots before the last point, continuously after it), so that a forecast far beyond what was observed is wide.
Extra scatter ``tau`` covers standard deviations that were too small. Outliers are noise from a second, ten times wider
normal; ``lambda_i`` is the precision this leaves each point (expectation-maximisation). Level and slope have flat
priors and both ``tau`` and the wandering are averaged over a grid by their marginal likelihood, so every result is a
mixture of normals: quantiles come from its distribution function, without random numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from estimation.trend.parameters import CURVES
from estimation.values.arrays import FloatArray
from estimation.values.mixture import NormalMixture
from estimation.values.units import STD_PER_MAD

BEND_NODES = np.array(CURVES.bend_nodes)
BEND_PRIOR = np.array(CURVES.bend_prior)


@dataclass(frozen=True, slots=True)
class WearCurve:
    """The posterior of level and slope at the last point, as a mixture over the grid nodes, in the caller's units."""

    weight: FloatArray  # (m,)
    level: FloatArray  # (m,)
    slope: FloatArray  # (m,)
    damped: FloatArray  # (m,) change of slope still to come
    covariance: FloatArray  # (m, 3, 3) of (level, slope, damped)
    wandering: FloatArray  # (m,) standard deviation of the slope per square root of distance
    span: float  # from the first to the last point
    share: FloatArray  # (k,) lambda: what each point counts, 1 for a good one
    converged: bool = True  # whether the shares stopped changing

    def shifted(self, std: float) -> WearCurve:
        """Return the curve with an error of that standard deviation that all its points have in common."""
        if std == 0.0:
            return self
        covariance = self.covariance.copy()
        covariance[:, 0, 0] += std**2
        return replace(self, covariance=covariance)

    def level_now(self) -> NormalMixture:
        """Return the distribution of the fitted value at the last point."""
        return NormalMixture(self.weight, self.level, np.sqrt(self.covariance[:, 0, 0]))

    def slope_now(self) -> NormalMixture:
        """Return the distribution of the slope at the last point."""
        return NormalMixture(self.weight, self.slope, np.sqrt(self.covariance[:, 1, 1]))

    def level_after(self, distance: float) -> NormalMixture:
        """Return the distribution of the fitted value ``distance`` after the last point."""
        effect = np.array([1.0, distance, self.span * float(_damped(np.asarray(distance / self.span)))])
        variance = np.einsum("i,mij,j->m", effect, self.covariance, effect) + self.wandering**2 * distance**3 / 3.0
        mean = self.level * effect[0] + self.slope * effect[1] + self.damped * effect[2]
        return NormalMixture(self.weight, mean, np.sqrt(variance))

    def reaches(self, limit: float, probability: float, horizon: float) -> float | None:
        """Return the distance after which ``limit`` has been reached with ``probability``; None beyond the horizon."""

        # the probability of having reached the limit at a distance is that of the level being above it there or at any
        # shorter distance looked at (its running maximum), as in Fieller's interval for a ratio
        def short(distance: float) -> float:
            return self.level_after(distance).above(limit) - probability

        if short(0.0) >= 0.0:
            return 0.0
        distances = horizon * np.linspace(0.0, 1.0, CURVES.horizon_points + 1) ** 2
        for i in np.flatnonzero(self.above_after(distances, limit) >= probability - CURVES.probability_margin):
            before, distance = float(distances[i - 1]), float(distances[i])
            if i > 0 and short(distance) >= 0.0:
                return float(brentq(short, before, distance, xtol=1e-6 * horizon))
        return None

    def above_after(self, distances: FloatArray, limit: float) -> FloatArray:
        """Return the probabilities (n,) that the level is above a limit at distances (n,) after the last point."""
        damped = self.span * _damped(distances / self.span)
        effect = np.column_stack([np.ones(len(distances)), distances, damped])
        mean = effect @ np.stack([self.level, self.slope, self.damped])
        variance = np.einsum("di,mij,dj->dm", effect, self.covariance, effect, optimize=True)
        variance += np.outer(distances**3 / 3.0, self.wandering**2)
        return np.asarray(ndtr((mean - limit) / np.sqrt(variance)) @ self.weight)


@dataclass(frozen=True, slots=True)
class _Scaled:
    x: FloatArray  # (k,) from -1 to 0
    z: FloatArray  # (k,)
    variance: FloatArray  # (k,)
    design: FloatArray  # (k, 3 + knots): level, slope, damped change of slope, hinges
    spacing: float
    span: float
    unit: float
    shift: float


def fit_wear_curve(x: FloatArray, value: FloatArray, std: FloatArray) -> WearCurve:
    """Fit the curve to points (k,), x not decreasing, std above 0; its level and slope are those at ``x[-1]``."""
    if len(x) < 2 or not x[-1] > x[0] or not np.all(std > 0.0):  # noqa: PLR2004 - a line needs two points
        raise ValueError("a wear curve needs two points, a span between them and positive standard deviations")
    points = _scale(x, value, std)
    pilot_slope, pilot_std, residual = _pilot(points)
    inflation = max(1.0, _weighted_median(np.abs(residual) / np.sqrt(points.variance), np.ones(len(x))) * STD_PER_MAD)
    share = _shares(residual, points.variance * inflation**2)
    scatter, scatter_prior = _scatter_grid(residual)
    bend = BEND_NODES * float(np.hypot(pilot_slope, pilot_std))
    converged = False
    for _ in range(CURVES.fit_rounds):
        nodes = _solve(points, share, scatter, bend, np.outer(scatter_prior, BEND_PRIOR).ravel())
        weight, beta, _, node_scatter, _ = nodes
        residual = points.z - points.design @ (weight @ beta)
        update = _shares(residual, points.variance + float(weight @ node_scatter**2))
        converged = bool(np.max(np.abs(update - share)) < CURVES.share_tolerance)
        share = update
        if converged:
            break
    nodes = _solve(points, share, scatter, bend, np.outer(scatter_prior, BEND_PRIOR).ravel())
    return replace(_unscale(points, nodes, share), converged=converged)


def _scale(x: FloatArray, value: FloatArray, std: FloatArray) -> _Scaled:
    span, unit, shift = float(x[-1] - x[0]), float(np.median(std)), float(np.median(value))
    u = (x - x[-1]) / span
    knots = max(0, min(CURVES.most_knots, len(x) - 2))
    spacing = 1.0 / (knots + 1)
    at = -spacing * np.arange(1, knots + 1)
    # a hinge is zero after its knot, so level and slope keep their meaning at the last point
    hinges = np.maximum(0.0, at[None, :] - u[:, None])
    design = np.column_stack([np.ones(len(x)), u, _damped(u), hinges])
    return _Scaled(
        u,
        (value - shift) / unit,
        np.maximum(std / unit, CURVES.least_std_share) ** 2,
        design,
        spacing,
        span,
        unit,
        shift,
    )


def _damped(u: FloatArray) -> FloatArray:
    """Return the integral of a change of slope that is 0 at u = 0 and goes to 1 as 1 - exp(-u)."""
    return u - 1.0 + np.exp(-u)


def _pilot(points: _Scaled) -> tuple[float, float, FloatArray]:
    k = len(points.x)
    first, second = np.arange(k // 2), np.arange(k // 2) + k - k // 2
    if k <= CURVES.most_paired_points:
        first, second = np.triu_indices(k, 1)
    run = points.x[second] - points.x[first]
    keep = run > 0.0
    first, second, run = first[keep], second[keep], run[keep]
    trust = run / np.sqrt(points.variance[first] + points.variance[second])
    slope = _weighted_median((points.z[second] - points.z[first]) / run, trust)
    level = _weighted_median(points.z - slope * points.x, 1.0 / np.sqrt(points.variance))
    information = 1.0 / points.variance
    centre = float(information @ points.x / information.sum())
    slope_std = float(1.0 / np.sqrt(information @ (points.x - centre) ** 2))
    return slope, slope_std, points.z - level - slope * points.x


def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    order = np.argsort(values, kind="stable")
    ranks = np.cumsum(weights[order])
    half = 0.5 * ranks[-1]
    low = int(np.searchsorted(ranks, half * (1.0 - 1e-12)))
    high = int(np.searchsorted(ranks, half * (1.0 + 1e-12)))
    return float(0.5 * (values[order[low]] + values[order[min(high, len(values) - 1)]]))


def _shares(residual: FloatArray, variance: FloatArray) -> FloatArray:
    if len(residual) < CURVES.points_for_outliers:
        return np.ones(len(residual))
    square = residual**2 / variance
    odds = (
        CURVES.outlier_share / (1.0 - CURVES.outlier_share) / CURVES.outlier_stds
        * np.exp(np.minimum(0.5 * square * (1.0 - CURVES.outlier_stds**-2), 500.0))
    )  # fmt: skip
    good = 1.0 / (1.0 + odds)
    return good + (1.0 - good) / CURVES.outlier_stds**2


def _scatter_grid(residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    largest = max(4.0, 3.0 * float(np.sqrt(np.mean(residual**2))))
    nodes = np.concatenate([[0.0], np.geomspace(0.1, largest, CURVES.scatter_nodes - 1)])
    edges = np.concatenate([[0.0], [0.05], np.sqrt(nodes[1:-1] * nodes[2:]), [largest * 1.2]])
    prior = np.diff(np.arctan(edges / CURVES.scatter_scale))  # half-Cauchy mass of each node's cell
    return nodes, prior / prior.sum()


_Nodes = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


def _solve(points: _Scaled, share: FloatArray, scatter: FloatArray, bend: FloatArray, prior: FloatArray) -> _Nodes:
    """Return weight, coefficients, covariance of (level, slope, damped), tau and bend of every grid node."""
    X, z = points.design, points.z
    width = X.shape[1]
    information = share / (points.variance + scatter[:, None] ** 2)  # (s, k)
    gram = np.einsum("sk,ki,kj->sij", information, X, X, optimize=True)
    moment = information @ (X * z[:, None])  # (s, p)
    energy = information @ z**2  # (s,)
    ridge = np.zeros((len(bend), width))
    ridge[:, 2] = 1.0 / bend**2
    ridge[:, 3:] = (1.0 / ((CURVES.wandering_share * bend) ** 2 * points.spacing))[:, None]
    A = (gram[:, None] + np.eye(width) * ridge[None, :, None, :]).reshape(-1, width, width)
    b = np.repeat(moment, len(bend), axis=0)
    size = np.sqrt(np.diagonal(A, axis1=1, axis2=2))  # scaled to a unit diagonal before it is factored
    L = np.linalg.cholesky(A / (size[:, :, None] * size[:, None, :]) + CURVES.diagonal_jitter * np.eye(width))
    inverse = np.linalg.inv(L)
    half = np.einsum("mij,mj->mi", inverse, b / size)
    beta = np.einsum("mji,mj->mi", inverse, half) / size
    log_size = np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1) + np.log(size).sum(axis=1)
    log_likelihood = (
        0.5 * np.repeat(np.log(information).sum(axis=1) - energy, len(bend))
        + 0.5 * np.tile(np.log(ridge[:, 2:]).sum(axis=1), len(scatter))
        - log_size
        + 0.5 * np.sum(half**2, axis=1)
    )
    weight = prior * np.exp(log_likelihood - log_likelihood.max())
    front = inverse[:, :, :3] / size[:, None, :3]  # L^-1 D^-1 restricted to level, slope and damped
    covariance = np.einsum("mki,mkj->mij", front, front)
    return weight / weight.sum(), beta, covariance, np.repeat(scatter, len(bend)), np.tile(bend, len(scatter))


def _unscale(points: _Scaled, nodes: _Nodes, share: FloatArray) -> WearCurve:
    weight, beta, covariance, _, bend = nodes
    rise = points.unit / points.span
    units = np.array([points.unit, rise, rise])
    return WearCurve(
        weight=weight,
        level=points.shift + points.unit * beta[:, 0],
        slope=rise * beta[:, 1],
        damped=rise * beta[:, 2],
        covariance=covariance * np.outer(units, units),
        wandering=CURVES.wandering_share * bend * rise / np.sqrt(points.span),
        span=points.span,
        share=share,
    )
