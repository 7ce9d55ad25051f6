"""What a fleet says of the wear of one of its wheelsets: rates and lasting changes of rate, pooled with heavy tails.

Of each wheelset stands what its points alone say of rate and change (:class:`OwnWear`), for every length over which a
change may die out and every strength of wandering. Rate and change of the wheelsets of a fleet are normal about a mean,
with a spread; a wheelset that is far off counts less. Mean and spread have a weakly informed prior, and are averaged over a
grid by the marginal likelihood of the other wheelsets: what one is told never rests on its own points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.trend.parameters import FLEET, FleetParameters
from estimation.trend.wear_curve import robust_points
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.trend import OwnWear, WearPrior


def own_wear(
    x: FloatArray, value: FloatArray, std: FloatArray, origin: float | None = None, params: FleetParameters = FLEET
) -> OwnWear:
    """Return what points (k,) alone say of rate and change, x in km, for a wheelset whose wear began at ``origin``."""
    points, share, variance = robust_points(x, value, std, origin)
    rise = points.unit / points.span
    information, moment, evidence = [], [], []
    W = share / variance
    for length in params.lengths_km:
        X = points.design(length / points.span)
        for wandering in params.wanderings:
            of_hinge = wandering**2 * points.span / rise**2 * points.spacing
            C = np.diag(1.0 / W) + of_hinge * points.hinges @ points.hinges.T
            factor = np.linalg.cholesky(C)
            white = np.linalg.solve(factor, np.column_stack([X[:, :3], points.z]))
            level = white[:, :1]
            norm = float((level**2).sum())
            rest = white[:, 1:] - level @ (level.T @ white[:, 1:]) / norm
            information.append(rest[:, :2].T @ rest[:, :2] / rise**2)
            moment.append(rest[:, :2].T @ rest[:, 2] / rise)
            log_size = np.log(np.diagonal(factor)).sum() + 0.5 * np.log(norm)
            evidence.append(-log_size - 0.5 * float(rest[:, 2] @ rest[:, 2]))
    best = max(evidence)
    return OwnWear(np.array(information), np.array(moment), np.array(evidence) - best)


@dataclass(frozen=True, slots=True)
class _Grid:
    wear: IntArray  # (g,) number of length and wandering
    spread: FloatArray  # (g, 2, 2) covariance between wheelsets


def _grid(params: FleetParameters) -> _Grid:
    kinds = len(params.lengths_km) * len(params.wanderings)
    rate, change = (np.array(stds) ** 2 for stds in (params.rate_stds, params.change_stds))
    of_rate, of_change = (axis.ravel() for axis in np.meshgrid(rate, change, indexing="ij"))
    spread = np.zeros((len(of_rate), 2, 2))
    spread[:, 0, 0], spread[:, 1, 1] = of_rate, of_change
    return _Grid(np.repeat(np.arange(kinds), len(of_rate)), np.tile(spread, (kinds, 1, 1)))


def fleet_priors(fleet: Sequence[OwnWear], params: FleetParameters = FLEET) -> list[WearPrior]:
    """Return what the other wheelsets of a fleet say of each; of one alone only what is known of wear."""
    grid = _grid(params)
    prior = np.diag(np.array([params.rate_std, params.change_std]) ** -2.0)
    at = prior @ np.array([params.rate, 0.0])
    count = len(grid.wear)
    if fleet:
        S = np.stack([own.information for own in fleet])[:, grid.wear]  # (w, g, 2, 2)
        h = np.stack([own.moment for own in fleet])[:, grid.wear]
        evidence = np.stack([own.evidence for own in fleet])[:, grid.wear]
    wider = params.tail_factor**2
    near, far = (_marginal(S, h, evidence, grid.spread * factor) for factor in (1.0, wider))
    # how far each wheelset is of the fleet (w, g): expectation-maximisation about the common mean
    like = np.ones((len(fleet), count))
    for _ in range(params.rounds):
        T = like[..., None, None] * near[0] + (1.0 - like)[..., None, None] * far[0]
        v = like[..., None] * near[1] + (1.0 - like)[..., None] * far[1]
        mean = np.linalg.solve(prior + T.sum(axis=0), (at + v.sum(axis=0))[..., None])[..., 0]
        odds = np.log(params.tail_share / (1.0 - params.tail_share)) + _log_at(far, mean) - _log_at(near, mean)
        like = 1.0 / (1.0 + np.exp(np.clip(odds, -500.0, 500.0)))
    T = like[..., None, None] * near[0] + (1.0 - like)[..., None, None] * far[0]
    v = like[..., None] * near[1] + (1.0 - like)[..., None] * far[1]
    c = like * near[2] + (1.0 - like) * far[2]
    c += -(like * np.log(np.maximum(like, 1e-300)) + (1 - like) * np.log(np.maximum(1 - like, 1e-300)))
    c += like * np.log(1.0 - params.tail_share) + (1.0 - like) * np.log(params.tail_share)
    return [
        _merged(grid, prior + T.sum(axis=0) - T[one], at + v.sum(axis=0) - v[one], c.sum(axis=0) - c[one], params)
        for one in range(len(fleet))
    ]


def _marginal(
    S: FloatArray, h: FloatArray, evidence: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return information (w, g, 2, 2), moment and constant that wheelsets give of the mean of their fleet."""
    inside = np.linalg.inv(np.eye(2) + S @ spread)  # (I + S V)^-1
    T = inside @ S
    v = (inside @ h[..., None])[..., 0]
    posterior = spread @ inside  # (V^-1 + S)^-1
    constant = evidence + 0.5 * np.linalg.slogdet(inside)[1] + 0.5 * np.einsum("wgi,wgij,wgj->wg", h, posterior, h)
    return T, v, constant


def _log_at(of: tuple[FloatArray, FloatArray, FloatArray], mean: FloatArray) -> FloatArray:
    T, v, constant = of
    return constant + np.einsum("wgi,gi->wg", v, mean) - 0.5 * np.einsum("gi,wgij,gj->wg", mean, T, mean)


def _merged(grid: _Grid, T: FloatArray, v: FloatArray, constant: FloatArray, params: FleetParameters) -> WearPrior:
    """Return the prior by length and wandering, over which the spreads are averaged."""
    covariance = np.linalg.inv(T)
    mean = (covariance @ v[..., None])[..., 0]
    log_weight = constant - 0.5 * np.linalg.slogdet(T)[1] + 0.5 * np.einsum("gi,gi->g", v, mean)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    of_wear = [np.flatnonzero(grid.wear == kind) for kind in range(int(grid.wear.max()) + 1)]
    rows = []
    for kind, nodes in enumerate(of_wear):
        total = float(weight[nodes].sum())
        if total < params.least_weight:
            continue
        part = weight[nodes] / total
        centre = part @ mean[nodes]
        off = mean[nodes] - centre
        within = np.einsum("g,gij->ij", part, covariance[nodes] + grid.spread[nodes]) + (off * part[:, None]).T @ off
        length, wandering = divmod(kind, len(params.wanderings))
        rows.append((total, params.lengths_km[length], centre, within, params.wanderings[wandering]))
    total, length, centre, within, wandering = (np.array(column) for column in zip(*rows, strict=True))
    return WearPrior(total / total.sum(), length, centre, within, wandering)
