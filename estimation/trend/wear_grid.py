"""The grid behind a wear curve: what points and prior say at every node of scatter, shape and knee.

The model is that of ``estimation.trend.wear_curve``. Points are in units of their span and of their median standard
deviation; all nodes are solved together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from estimation.trend.parameters import CURVES
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.trend import WearComponent
from estimation.values.units import STD_PER_MAD


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
        age, last = self.age + 1.0 + self.x, self.age + 1.0
        if np.isinf(length):  # it never dies out, and grows
            change = 0.5 * (age**2 - last**2)
        else:
            change = -length * (np.exp(-age / length) - np.exp(-last / length))
        return np.column_stack([np.ones(len(self.x)), self.x, change, self.hinges])


@dataclass(frozen=True, slots=True)
class Shapes:
    """Components of the prior, in units of the points."""

    weight: FloatArray  # (n,)
    weight_behind: FloatArray  # (n,) of one that has a knee, and may have left its fleet with it
    lengths: FloatArray  # (l,)
    which: IntArray  # (n,) number of the length of each
    precision: FloatArray  # (n, 2, 2) of rate and change; a rate of none is flat
    mean: FloatArray  # (n, 2)
    wandering: FloatArray  # (n,)
    knee: FloatArray  # (n,) std of a change of rate at once


@dataclass(frozen=True, slots=True)
class Counted:
    """Points with what each counts, and the posterior that follows."""

    share: FloatArray  # (k,)
    shapes: Shapes
    nodes: Nodes
    converged: bool


def robust(points: ScaledPoints, prior: Sequence[WearComponent] | None) -> Counted:
    """Return what points (k,) count and show, by expectation-maximisation."""
    pilot_slope, pilot_std, residual = _pilot(points)
    off = np.abs(residual) / np.sqrt(points.variance)
    inflation = max(1.0, _weighted_median(off, np.ones(len(off))) * STD_PER_MAD)
    share = _shares(residual, points.variance * inflation**2)
    scatter, scatter_prior = _scatter_grid(residual)
    shapes = _alone(points, float(np.hypot(pilot_slope, pilot_std))) if prior is None else _of_fleet(points, prior)
    converged = False
    for _ in range(CURVES.fit_rounds):
        nodes = solve(points, share, scatter, scatter_prior, shapes)
        update = _shares(points.z - nodes.fitted, points.variance + nodes.scatter)
        converged = bool(np.max(np.abs(update - share)) < CURVES.share_tolerance)
        share = update
        if converged:
            break
    nodes = solve(points, share, scatter, scatter_prior, shapes)
    return Counted(share, shapes, over_scatter(nodes), converged)


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
    weight = np.tile(CURVES.bend_prior, len(lengths)) / len(lengths)
    return Shapes(
        weight=weight,
        weight_behind=weight,
        lengths=lengths,
        which=which,
        precision=precision,
        mean=np.zeros((len(bends), 2)),
        wandering=CURVES.wandering_share * bends,
        knee=np.full(len(bends), CURVES.knee_share * slope),
    )


def _of_fleet(points: ScaledPoints, prior: Sequence[WearComponent]) -> Shapes:
    """Return the prior of a fleet in units of the points: a wheelset is like it, less so, or has left it."""
    rise = points.unit / points.span
    columns = np.array([astuple(component) for component in prior]).T
    weight, length, rate, change, rate_std, change_std, correlation, wandering = columns
    lengths, which = np.unique(length / points.span, return_inverse=True)
    # of a change that never dies out the unit is that of a rate per span
    of_change = np.where(np.isinf(length), points.span, 1.0)
    stds = np.stack([rate_std, change_std * of_change], axis=1) / rise
    correlated = np.where(np.eye(2, dtype=bool), 1.0, correlation[:, None, None])
    covariance = stds[:, :, None] * stds[:, None, :] * correlated
    wider = np.array(CURVES.tail_factors) ** 2
    count = len(wider)
    return Shapes(
        weight=np.outer(weight, CURVES.tail_prior).ravel(),
        weight_behind=np.outer(weight, CURVES.tail_behind).ravel(),
        lengths=lengths,
        which=np.repeat(which, count),
        precision=np.linalg.inv((covariance[:, None] * wider[:, None, None]).reshape(-1, 2, 2)),
        mean=np.repeat(np.stack([rate, change * of_change], axis=1) / rise, count, axis=0),
        wandering=np.repeat(wandering * np.sqrt(points.span) / rise, count),
        knee=np.repeat(CURVES.knee_share * np.hypot(rate, rate_std) / rise, count),
    )


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
    """The posterior of the nodes of scatter, shape and knee that count."""

    weight: FloatArray  # (m,)
    beta: FloatArray  # (m, 3) of level, rate and change
    covariance: FloatArray  # (m, 3, 3)
    shape: IntArray  # (m,) number of it
    knee: IntArray  # (m,) number of its knot; 0 for none
    fitted: FloatArray  # (k,) mean curve at the points
    scatter: float  # mean of tau^2


def solve(
    points: ScaledPoints, share: FloatArray, scatter: FloatArray, scatter_prior: FloatArray, shapes: Shapes
) -> Nodes:
    """Return the posterior of all nodes, the points counting their shares (k,)."""
    X = np.stack([points.design(length) for length in shapes.lengths.tolist()])  # (l, k, p)
    information = share / (points.variance + scatter[:, None] ** 2)  # (s, k)
    posterior = _posterior(points, X, information, shapes)
    log_weight = 0.5 * (np.log(information).sum(axis=1) - information @ points.z**2)[:, None] + posterior.evidence
    # a knee is a hinge that is hardly held: of each node, without one and with one at each knot
    knees = len(points.hinges[0])
    chance = np.concatenate([[1.0 - CURVES.knee_chance], np.full(knees, CURVES.knee_chance / max(knees, 1))])
    held = 1.0 / (shapes.wandering**2 * points.spacing)
    freed = np.maximum(held - 1.0 / (shapes.wandering**2 * points.spacing + shapes.knee**2), 0.0)  # (n,)
    C, beta = posterior.covariance, posterior.beta
    open_share = 1.0 - freed[:, None] * np.diagonal(C, axis1=2, axis2=3)[..., 3:]  # (s, n, knees)
    gain = freed[:, None] / open_share
    of_knee = 0.5 * (np.log1p(-freed / held)[:, None] - np.log(open_share) + gain * beta[..., 3:] ** 2)
    log_weight = log_weight[..., None] + np.log(chance) + np.concatenate([np.zeros((*C.shape[:2], 1)), of_knee], axis=2)
    of_shape = np.column_stack([shapes.weight, *[shapes.weight_behind] * knees])
    weight = scatter_prior[:, None, None] * of_shape * np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    moved = gain * beta[..., 3:]  # by how much of a column of C
    mean = weight.sum(axis=2)[..., None] * beta + np.einsum("snij,snj->sni", C[..., 3:], weight[..., 1:] * moved)
    of_length = np.zeros((len(shapes.lengths), X.shape[2]))
    np.add.at(of_length, shapes.which, mean.sum(axis=0))
    s, n, knee = np.nonzero(weight > _least(weight))
    column = C[s, n][np.arange(len(s)), :3, np.where(knee > 0, knee + 2, 0)]  # (m, 3)
    with_knee = (knee > 0).astype(float)
    at = np.maximum(knee - 1, 0)
    none = np.zeros(len(s)) if knees == 0 else gain[s, n, at] * with_knee
    shift = none if knees == 0 else moved[s, n, at] * with_knee
    kept = weight[s, n, knee]
    return Nodes(
        weight=kept / kept.sum(),
        beta=beta[s, n, :3] + shift[:, None] * column,
        covariance=C[s, n, :3, :3] + none[:, None, None] * column[:, :, None] * column[:, None, :],
        shape=n,
        knee=knee,
        fitted=np.einsum("lki,li->k", X, of_length),
        scatter=float(weight.sum(axis=(1, 2)) @ scatter**2),
    )


def over_scatter(nodes: Nodes) -> Nodes:
    """Return nodes that differ in scatter alone as one normal, by its moments: a forecast takes as long as they are."""
    _, first, which = np.unique([nodes.shape, nodes.knee], axis=1, return_index=True, return_inverse=True)
    weight: FloatArray = np.bincount(which, nodes.weight).astype(np.float64)
    part = nodes.weight / weight[which]

    def mean(values: FloatArray) -> FloatArray:
        sums = np.zeros((len(weight), *values.shape[1:]))
        np.add.at(sums, which, (values.T * part).T)
        return sums

    beta = mean(nodes.beta)
    off = nodes.beta - beta[which]
    covariance = mean(nodes.covariance + off[:, :, None] * off[:, None, :])
    return replace(
        nodes, weight=weight, beta=beta, covariance=covariance, shape=nodes.shape[first], knee=nodes.knee[first]
    )


def _least(weight: FloatArray) -> float:
    """Return the weight that the heaviest of those have that count for nothing together."""
    ordered = np.sort(weight, axis=None)
    return float(ordered[max(0, int(np.searchsorted(np.cumsum(ordered), CURVES.negligible_share)) - 1)])


@dataclass(frozen=True, slots=True)
class _Posterior:
    beta: FloatArray  # (s, n, p) of level, rate, change and hinges
    covariance: FloatArray  # (s, n, p, p)
    evidence: FloatArray  # (s, n) logarithm, but for what is the same for all shapes


def _posterior(points: ScaledPoints, X: FloatArray, information: FloatArray, shapes: Shapes) -> _Posterior:
    """Return the posterior of all nodes without a knee, of points with information (s, k)."""
    width = X.shape[2]
    gram = np.einsum("sk,lki,lkj->slij", information, X, X, optimize=True)[:, shapes.which]
    moment = np.einsum("sk,lki->sli", information * points.z, X, optimize=True)[:, shapes.which]
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
    inverse = np.linalg.inv(L) / size[..., None, :]
    half = np.einsum("snij,snj->sni", inverse, moment)
    log_size = np.log(np.diagonal(L, axis1=2, axis2=3)).sum(axis=2) + np.log(size).sum(axis=2)
    # a flat rate has no precision: what it leaves is the same for all nodes
    proper = shapes.precision[:, 0, 0] > 0.0
    log_prior = 0.5 * len(hinges) * np.log(hinge) - 0.5 * np.einsum("ni,ni->n", pull, shapes.mean)
    log_prior += 0.5 * np.log(np.where(proper, np.linalg.det(shapes.precision), shapes.precision[:, 1, 1]))
    return _Posterior(
        beta=np.einsum("snji,snj->sni", inverse, half),
        covariance=inverse.transpose(0, 1, 3, 2) @ inverse,
        evidence=log_prior - log_size + 0.5 * np.sum(half**2, axis=2),
    )
