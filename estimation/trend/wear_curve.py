"""A robust wear curve through points with known standard deviations: level and slope now, and when a limit is reached.

Model, with ``a`` the distance or time since the profile began to wear::

    value_i = level + wear(a_i) + noise_i,    noise_i ~ N(0, (std_i^2 + tau^2) / lambda_i)
    wear'(a) = rate + change exp(-a / length) + wandering(a)

The rate goes from one at the begin to a lasting one: wear that saturates, accelerates or runs in is carried on, damped,
into the forecast. The rate wanders besides, as a random walk (at knots before the last point, continuously after it),
so that a forecast far beyond what was observed is wide. Rate and change have a prior from the fleet
(``estimation.trend.fleet``), or none: the rate is then flat, the change in shares of a pilot slope. Extra scatter
``tau`` covers standard deviations that were too small. Outliers are noise from a second, ten times wider normal;
``lambda_i`` is the precision this leaves each point (expectation-maximisation). ``tau``, lengths, wandering and the
components of the prior are averaged over a grid by their marginal likelihood, so every result is a mixture of normals:
quantiles come from its distribution function, without random numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from estimation.trend.parameters import CURVES
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.mixture import NormalMixture
from estimation.values.trend import WearComponent
from estimation.values.units import STD_PER_MAD


@dataclass(frozen=True, slots=True)
class WearCurve:
    """The posterior of level and slope at the last point, as a mixture over the grid nodes, in the caller's units."""

    weight: FloatArray  # (m,)
    level: FloatArray  # (m,)
    slope: FloatArray  # (m,)
    damped: FloatArray  # (m,) change of slope still to come
    covariance: FloatArray  # (m, 3, 3) of (level, slope, damped)
    wandering: FloatArray  # (m,) standard deviation of the slope per square root of distance
    length: FloatArray  # (m,) distance over which the change of slope dies out
    share: FloatArray  # (k,) lambda: what each point counts, 1 for a good one
    converged: bool = True  # whether the shares stopped changing

    def shifted(self, std: float) -> WearCurve:
        """Return the curve with an error of that standard deviation that all its points have in common."""
        if std == 0.0:
            return self
        covariance = self.covariance.copy()
        covariance[:, 0, 0] += std**2
        return replace(self, covariance=covariance)

    def scaled(self, std: float) -> WearCurve:
        """Return the curve whose differences all have a common relative error of that standard deviation."""
        rise = np.stack([np.zeros_like(self.slope), self.slope, self.damped], axis=1)
        return replace(self, covariance=self.covariance + std**2 * rise[:, :, None] * rise[:, None, :])

    def level_now(self) -> NormalMixture:
        """Return the distribution of the fitted value at the last point."""
        return NormalMixture(self.weight, self.level, np.sqrt(self.covariance[:, 0, 0]))

    def slope_now(self) -> NormalMixture:
        """Return the distribution of the slope at the last point."""
        return NormalMixture(self.weight, self.slope, np.sqrt(self.covariance[:, 1, 1]))

    def level_after(self, distance: float) -> NormalMixture:
        """Return the distribution of the fitted value ``distance`` after the last point."""
        mean, std = self._after(np.array([distance]))
        return NormalMixture(self.weight, mean[0], std[0])

    def _after(self, distances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and std (n, m) of the level of each node at distances (n,) after the last point."""
        damped = self.length * _damped(distances[:, None] / self.length)
        effect = np.stack([np.ones_like(damped), np.broadcast_to(distances[:, None], damped.shape), damped], axis=2)
        mean = (effect * np.stack([self.level, self.slope, self.damped], axis=1)).sum(axis=2)
        variance = np.einsum("dmi,mij,dmj->dm", effect, self.covariance, effect, optimize=True)
        variance += np.outer(distances**3 / 3.0, self.wandering**2)
        return mean, np.sqrt(variance)

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
        mean, std = self._after(distances)
        return np.asarray(ndtr((mean - limit) / std) @ self.weight)


@dataclass(frozen=True, slots=True)
class ScaledPoints:
    """Points in units of their span and their median standard deviation."""

    x: FloatArray  # (k,) from -1 to 0
    z: FloatArray  # (k,)
    variance: FloatArray  # (k,)
    hinges: FloatArray  # (k, knots) zero after their knot, so that level and rate keep their meaning at the last point
    spacing: float
    span: float
    unit: float
    shift: float
    age: float  # of the first point, in spans

    def design(self, length: float) -> FloatArray:
        """Return the effects (k, 3 + knots) of level, rate, change and hinges, for a length in spans."""
        fade = np.exp(-(self.age + 1.0 + self.x) / length) - np.exp(-(self.age + 1.0) / length)
        return np.column_stack([np.ones(len(self.x)), self.x, -length * fade, self.hinges])


@dataclass(frozen=True, slots=True)
class Shapes:
    """Components of the prior, in units of the points."""

    weight: FloatArray  # (n,)
    lengths: FloatArray  # (l,)
    which: IntArray  # (n,) number of the length of each
    precision: FloatArray  # (n, 2, 2) of rate and change; a rate of none is flat
    mean: FloatArray  # (n, 2)
    wandering: FloatArray  # (n,)


def fit_wear_curve(
    x: FloatArray,
    value: FloatArray,
    std: FloatArray,
    prior: Sequence[WearComponent] | None = None,
    origin: float | None = None,
) -> WearCurve:
    """Fit the curve to points (k,), x not decreasing, std above 0; its level and slope are those at ``x[-1]``.

    Args:
        prior: What the fleet says of rate and change, in units of ``x`` and ``value``; None for what says nothing.
        origin: Where the profile began to wear, on the scale of ``x``; None for the first point.
    """
    if len(x) < 2 or not x[-1] > x[0] or not np.all(std > 0.0):  # noqa: PLR2004 - a line needs two points
        raise ValueError("a wear curve needs two points, a span between them and positive standard deviations")
    points = scaled_points(x, value, std, origin)
    shares = _robust(points, prior)
    nodes = solve(points, shares.share, shares.scatter, shares.scatter_prior, shares.shapes)
    return replace(_unscale(points, nodes, shares.shapes, shares.share), converged=shares.converged)


def robust_points(
    x: FloatArray, value: FloatArray, std: FloatArray, origin: float | None
) -> tuple[ScaledPoints, FloatArray, FloatArray]:
    """Return points (k,) in their own units, what each counts, and its variance with the scatter they show alone."""
    points = scaled_points(x, value, std, origin)
    shares = _robust(points, None)
    nodes = solve(points, shares.share, shares.scatter, shares.scatter_prior, shares.shapes)
    return points, shares.share, points.variance + nodes.scatter


@dataclass(frozen=True, slots=True)
class _Shares:
    share: FloatArray
    scatter: FloatArray
    scatter_prior: FloatArray
    shapes: Shapes
    converged: bool


def _robust(points: ScaledPoints, prior: Sequence[WearComponent] | None) -> _Shares:
    pilot_slope, pilot_std, residual = _pilot(points)
    inflation = max(
        1.0, _weighted_median(np.abs(residual) / np.sqrt(points.variance), np.ones(len(points.x))) * STD_PER_MAD
    )
    share = _shares(residual, points.variance * inflation**2)
    scatter, scatter_prior = _scatter_grid(residual)
    shapes = _alone(points, float(np.hypot(pilot_slope, pilot_std))) if prior is None else _of_fleet(points, prior)
    converged = False
    for _ in range(CURVES.fit_rounds):
        nodes = solve(points, share, scatter, scatter_prior, shapes)
        residual = points.z - nodes.fitted
        update = _shares(residual, points.variance + nodes.scatter)
        converged = bool(np.max(np.abs(update - share)) < CURVES.share_tolerance)
        share = update
        if converged:
            break
    return _Shares(share, scatter, scatter_prior, shapes, converged)


def scaled_points(x: FloatArray, value: FloatArray, std: FloatArray, origin: float | None) -> ScaledPoints:
    """Return points (k,) in their own units."""
    span, unit, shift = float(x[-1] - x[0]), float(np.median(std)), float(np.median(value))
    u = (x - x[-1]) / span
    knots = max(0, min(CURVES.most_knots, len(x) - 2))
    spacing = 1.0 / (knots + 1)
    at = -spacing * np.arange(1, knots + 1)
    return ScaledPoints(
        x=u,
        z=(value - shift) / unit,
        variance=np.maximum(std / unit, CURVES.least_std_share) ** 2,
        hinges=np.maximum(0.0, at[None, :] - u[:, None]),
        spacing=spacing,
        span=span,
        unit=unit,
        shift=shift,
        age=0.0 if origin is None else max(0.0, float(x[0]) - origin) / span,
    )


def _alone(points: ScaledPoints, slope: float) -> Shapes:
    """Return the prior of a wheelset without a fleet, whose changes are shares of a pilot slope."""
    lengths = np.array(CURVES.lengths_alone)
    bend = slope * np.array(CURVES.bend_nodes)
    which = np.repeat(np.arange(len(lengths)), len(bend))
    bends = np.tile(bend, len(lengths))
    # a change that is still to come at the last point is what is left of that at the first one
    precision = np.zeros((len(bends), 2, 2))
    precision[:, 1, 1] = 1.0 / (bends * np.exp((points.age + 1.0) / lengths[which])) ** 2
    return Shapes(
        weight=np.tile(CURVES.bend_prior, len(lengths)) / len(lengths),
        lengths=lengths,
        which=which,
        precision=precision,
        mean=np.zeros((len(bends), 2)),
        wandering=CURVES.wandering_share * bends,
    )


def _of_fleet(points: ScaledPoints, prior: Sequence[WearComponent]) -> Shapes:
    """Return the prior of a fleet in units of the points: a wheelset is like it, less so, or has left it."""
    rise = points.unit / points.span
    columns = np.array([astuple(component) for component in prior]).T
    weight, length, rate, change, rate_std, change_std, correlation, wandering = columns
    lengths, which = np.unique(length / points.span, return_inverse=True)
    stds = np.stack([rate_std, change_std], axis=1) / rise
    correlated = np.where(np.eye(2, dtype=bool), 1.0, correlation[:, None, None])
    covariance = stds[:, :, None] * stds[:, None, :] * correlated
    wider = np.array(CURVES.tail_factors) ** 2
    count = len(wider)
    return Shapes(
        weight=np.outer(weight, CURVES.tail_prior).ravel(),
        lengths=lengths,
        which=np.repeat(which, count),
        precision=np.linalg.inv((covariance[:, None] * wider[:, None, None]).reshape(-1, 2, 2)),
        mean=np.repeat(np.stack([rate, change], axis=1) / rise, count, axis=0),
        wandering=np.repeat(wandering * np.sqrt(points.span) / rise, count),
    )


def _damped(u: FloatArray) -> FloatArray:
    """Return the integral of a change of slope that is 0 at u = 0 and goes to 1 as 1 - exp(-u)."""
    return u - 1.0 + np.exp(-u)


def _pilot(points: ScaledPoints) -> tuple[float, float, FloatArray]:
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


@dataclass(frozen=True, slots=True)
class Nodes:
    """The posterior of every node of scatter (s,) and shape (n,)."""

    weight: FloatArray  # (s, n)
    beta: FloatArray  # (s, n, p) of level, rate, change and hinges
    covariance: FloatArray  # (s, n, 3, 3) of level, rate and change
    fitted: FloatArray  # (k,) mean curve at the points
    scatter: float  # mean of tau^2


def solve(
    points: ScaledPoints, share: FloatArray, scatter: FloatArray, scatter_prior: FloatArray, shapes: Shapes
) -> Nodes:
    """Return the posterior of all nodes, the points counting their shares (k,)."""
    X = np.stack([points.design(length) for length in shapes.lengths.tolist()])  # (l, k, p)
    z, width = points.z, X.shape[2]
    information = share / (points.variance + scatter[:, None] ** 2)  # (s, k)
    gram = np.einsum("sk,lki,lkj->slij", information, X, X, optimize=True)[:, shapes.which]
    moment = np.einsum("sk,lki->sli", information * z, X, optimize=True)[:, shapes.which]
    energy = information @ z**2  # (s,)
    # the priors of rate, change and hinges
    ridge = np.zeros((len(shapes.which), width, width))
    ridge[:, 1:3, 1:3] = shapes.precision
    hinge = 1.0 / (shapes.wandering**2 * points.spacing)
    hinges = np.arange(3, width)
    ridge[:, hinges, hinges] = hinge[:, None]
    pull = np.einsum("nij,nj->ni", shapes.precision, shapes.mean)
    moment[:, :, 1:3] += pull
    A = gram + ridge
    size = np.sqrt(np.diagonal(A, axis1=2, axis2=3))  # scaled to a unit diagonal before it is factored
    L = np.linalg.cholesky(A / (size[..., :, None] * size[..., None, :]) + CURVES.diagonal_jitter * np.eye(width))
    inverse = np.linalg.inv(L)
    half = np.einsum("snij,snj->sni", inverse, moment / size)
    beta = np.einsum("snji,snj->sni", inverse, half) / size
    log_size = np.log(np.diagonal(L, axis1=2, axis2=3)).sum(axis=2) + np.log(size).sum(axis=2)
    # a flat rate has no precision: what it leaves is the same for all nodes
    proper = shapes.precision[:, 0, 0] > 0.0
    log_prior = 0.5 * len(hinges) * np.log(hinge) - 0.5 * np.einsum("ni,ni->n", pull, shapes.mean)
    log_prior += 0.5 * np.log(np.where(proper, np.linalg.det(shapes.precision), shapes.precision[:, 1, 1]))
    log_likelihood = (
        0.5 * (np.log(information).sum(axis=1) - energy)[:, None] + log_prior - log_size + 0.5 * np.sum(half**2, axis=2)
    )
    weight = np.outer(scatter_prior, shapes.weight) * np.exp(log_likelihood - log_likelihood.max())
    weight /= weight.sum()
    front = inverse[..., :3] / size[..., None, :3]  # L^-1 D^-1 restricted to level, rate and change
    covariance = np.einsum("snki,snkj->snij", front, front)
    of_length = np.zeros((len(shapes.lengths), width))
    np.add.at(of_length, shapes.which, np.einsum("sn,sni->ni", weight, beta))
    fitted = np.einsum("lki,li->k", X, of_length)
    return Nodes(weight, beta, covariance, fitted, float(weight.sum(axis=1) @ scatter**2))


def _unscale(points: ScaledPoints, nodes: Nodes, shapes: Shapes, share: FloatArray) -> WearCurve:
    rise = points.unit / points.span
    counts = nodes.weight > CURVES.negligible_node * nodes.weight.max()
    weight = nodes.weight[counts] / nodes.weight[counts].sum()
    shape = np.broadcast_to(np.arange(len(shapes.which)), counts.shape)[counts]
    length = shapes.lengths[shapes.which[shape]]
    # from rate and change to the slope at the last point and what is still to come of the change
    left = np.exp(-(points.age + 1.0) / length)
    turn = np.zeros((len(weight), 3, 3))
    turn[:, 0, 0] = points.unit
    turn[:, 1, 1] = rise
    turn[:, 1, 2], turn[:, 2, 2] = rise * left, -rise * left
    level, slope, damped = np.einsum("mij,mj->im", turn, nodes.beta[..., :3][counts])
    return WearCurve(
        weight=weight,
        level=points.shift + level,
        slope=slope,
        damped=damped,
        covariance=turn @ nodes.covariance[counts] @ turn.transpose(0, 2, 1),
        wandering=shapes.wandering[shape] * rise / np.sqrt(points.span),
        length=points.span * length,
        share=share,
    )
