"""What a fleet says of the wear of one of its wheelsets: rates and lasting changes of rate, pooled with heavy tails.

Of each wheelset stands what its points alone say of rate and change (:class:`OwnWear`), for every length over which a
change may die out and every strength of wandering. Rate and change of the wheelsets of a fleet are normal about a mean,
with a spread; a wheelset that is far off counts less. Mean and spread have a weakly informed prior, and are averaged
over a grid by the marginal likelihood of the other wheelsets: what is said of one never rests on its own points.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import xlogy

from estimation.trend.parameters import CURVES, FLEET, FleetParameters
from estimation.trend.wear_grid import robust, scaled_points
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.trend import BeyondReached, FleetWear, OwnWear, WearComponent


def own_wear(
    x: FloatArray,
    value: FloatArray,
    std: FloatArray,
    origin: float | None = None,
    amplitude: float = CURVES.limit_amplitude,
    params: FleetParameters = FLEET,
) -> OwnWear:
    """Return what points (k,) alone say of rate and change, x in km, for a wheelset whose wear began at ``origin``."""
    points = scaled_points(x, value, std, origin)
    counted = robust(points, None)
    rise = points.unit / points.span
    W = counted.share / (points.variance + counted.nodes.scatter)
    held = np.array(params.wanderings) ** 2 * points.span / rise**2 * points.spacing  # (q,) variances of hinges
    knees = points.hinges.shape[1]
    freed = (CURVES.knee_share * params.rate / rise) ** 2 * np.vstack([np.zeros(knees), np.eye(knees)])
    ridge = 1.0 / (held[:, None, None] + freed)  # (q, 1 + knees, knees), without a knee and with one at each knot
    chance = np.concatenate([[1.0 - CURVES.knee_chance], np.full(knees, CURVES.knee_chance / max(knees, 1))])
    rows = []
    for length in params.lengths_km:
        X = points.design(length / points.span)
        gram, moment = (X.T * W) @ X, X.T @ (W * points.z)
        rest = np.zeros((*ridge.shape[:2], knees + 1, knees + 1))  # of level and hinges
        rest[..., np.arange(1, knees + 1), np.arange(1, knees + 1)] = ridge
        others = [0, *range(3, X.shape[1])]
        rest += gram[np.ix_(others, others)]
        sides = np.column_stack([gram[others, 1:3], moment[others]])
        solved = np.linalg.solve(rest, np.broadcast_to(sides, (*rest.shape[:2], *sides.shape)))
        reduced = sides.T @ solved  # (q, 1 + knees, 3, 3)
        evidence = 0.5 * (np.log(ridge).sum(axis=2) - np.linalg.slogdet(rest)[1] + reduced[..., 2, 2]) + np.log(chance)
        unit = np.array([1.0, 1.0 / points.span if np.isinf(length) else 1.0]) * rise
        information = (gram[1:3, 1:3] - reduced[..., :2, :2]) / np.outer(unit, unit)
        pull = (moment[1:3] - reduced[..., :2, 2]) / unit
        rows += [_likeliest(*of_wandering) for of_wandering in zip(information, pull, evidence, strict=True)]
    information, moment, evidence = (np.array(column) for column in zip(*rows, strict=True))
    return OwnWear(amplitude, information, moment, evidence - evidence.max())


def _likeliest(
    information: FloatArray, moment: FloatArray, evidence: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Return information, moment and evidence of the knee, or of none, that is likeliest at its own best wear."""
    # two points do not tell a rate from its change: the direction that they do not show is left out
    size = np.sqrt(np.maximum(np.einsum("nii->ni", information), np.finfo(np.float64).tiny))
    scaled, pull = information / (size[:, :, None] * size[:, None, :]), moment / size
    inverse = np.linalg.pinv(scaled, CURVES.smallest_eigenvalue, hermitian=True)
    best = evidence + 0.5 * np.einsum("ni,nij,nj->n", pull, inverse, pull)
    return information[at := int(np.argmax(best))], moment[at], float(evidence[at])


@dataclass(frozen=True, slots=True)
class _Grid:
    wear: IntArray  # (g,) number of length and wandering
    prior: FloatArray  # (g,)
    unit: FloatArray  # (g,) of changes
    spread: FloatArray  # (g, 2, 2) covariance between wheelsets


def _grid(params: FleetParameters) -> _Grid:
    units = np.array(params.change_units)
    kinds = [np.arange(len(of)) for of in (params.lengths_km, params.wanderings, params.rate_stds, params.change_stds)]
    length, wandering, rate, change = (axis.ravel() for axis in np.meshgrid(*kinds, indexing="ij"))
    spread = np.zeros((len(length), 2, 2))
    spread[:, 0, 0] = np.array(params.rate_stds)[rate] ** 2
    spread[:, 1, 1] = (np.array(params.change_stds)[change] * units[length]) ** 2
    prior = np.array(params.length_prior)[length]
    return _Grid(length * len(params.wanderings) + wandering, prior, units[length], spread)


def fleet_priors(fleet: Sequence[OwnWear], params: FleetParameters = FLEET) -> list[FleetWear]:
    """Return what the other wheelsets of a fleet say of each; of one alone only what is known of wear."""
    grid = _grid(params)
    S, h, evidence = (np.stack([getattr(own, name) for own in fleet])[:, grid.wear] for name in _OF_WEAR)
    precision, pull = _of_mean(grid, params)
    near, far = (_marginal(S, h, evidence, grid.spread * wider**2) for wider in (1.0, params.tail_factor))
    # how far each wheelset is of the fleet (w, g): expectation-maximisation about the common mean
    like = np.ones(evidence.shape)
    for _ in range(params.rounds):
        T = (like[..., None, None] * near[0] + (1.0 - like)[..., None, None] * far[0]).sum(axis=0)
        v = (like[..., None] * near[1] + (1.0 - like)[..., None] * far[1]).sum(axis=0)
        mean = np.linalg.solve(precision + T, (pull + v)[..., None])[..., 0]
        odds = np.log(params.tail_share / (1.0 - params.tail_share)) + _log_at(far, mean) - _log_at(near, mean)
        like = 1.0 / (1.0 + np.exp(np.clip(odds, -500.0, 500.0)))
    T = like[..., None, None] * near[0] + (1.0 - like)[..., None, None] * far[0]
    v = like[..., None] * near[1] + (1.0 - like)[..., None] * far[1]
    c = like * (near[2] + np.log1p(-params.tail_share)) + (1.0 - like) * (far[2] + np.log(params.tail_share))
    c -= xlogy(like, like) + xlogy(1.0 - like, 1.0 - like)
    T, v, c = precision + T.sum(axis=0) - T, pull + v.sum(axis=0) - v, c.sum(axis=0) - c  # of all others
    return [
        FleetWear(
            _merged(grid, T[w], v[w], c[w], params),
            len(fleet) - 1,
            beyond_of([*fleet[:w], *fleet[w + 1 :]], params),
        )
        for w in range(len(fleet))
    ]


def beyond_of(others: Sequence[OwnWear], params: FleetParameters = FLEET) -> tuple[BeyondReached, ...]:
    """Return by how much the conicity of one more wheelset will be off what is extrapolated, by what others reached."""
    shown: defaultdict[float, list[BeyondReached]] = defaultdict(list)
    for own in others:
        for reached in own.beyond:
            shown[reached.amplitude].append(reached)
    return tuple(
        _beyond(amplitude, reached, params)
        for amplitude, reached in sorted(shown.items())
        if len(reached) >= params.fewest_beyond
    )


def _beyond(amplitude: float, shown: Sequence[BeyondReached], params: FleetParameters) -> BeyondReached:
    errors, spread = np.array([reached.error for reached in shown]), float(np.mean([reached.std for reached in shown]))
    expected = params.alike_weight * (params.alike_share * spread) ** 2
    between = (expected + float(np.sum((errors - errors.mean()) ** 2))) / (params.alike_weight + len(errors) - 1.0)
    mean = float(errors.mean()) / (1.0 + between / (len(errors) * spread**2))
    std = _round_up(np.sqrt(between * (1.0 + 1.0 / len(errors))), params)
    return BeyondReached(amplitude, float(np.round(mean / std * params.mean_steps) * std / params.mean_steps), std)


def _round_up(std: float, params: FleetParameters) -> float:
    return float(2.0 ** (np.ceil(np.log2(std) * params.std_steps) / params.std_steps))


_OF_WEAR = ("information", "moment", "evidence")


@cache
def usual_wear(params: FleetParameters = FLEET) -> FleetWear:
    """Return what is known of the wear of a wheelset without a fleet."""
    grid = _grid(params)
    precision, pull = _of_mean(grid, params)
    return FleetWear(_merged(grid, precision, pull, np.zeros(len(grid.wear)), params), 0)


def _of_mean(grid: _Grid, params: FleetParameters) -> tuple[FloatArray, FloatArray]:
    """Return precision (g, 2, 2) and pull (g, 2) of the mean of a fleet, before any of its wheelsets is known."""
    precision = np.zeros((len(grid.wear), 2, 2))
    precision[:, 0, 0] = params.rate_std**-2.0
    precision[:, 1, 1] = (params.change_std * grid.unit) ** -2.0
    return precision, precision @ np.array([params.rate, 0.0])


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
    square = np.einsum("gi,wgij,gj->wg", mean, T, mean)
    return np.asarray(constant + np.einsum("wgi,gi->wg", v, mean) - 0.5 * square)


def _merged(
    grid: _Grid, T: FloatArray, v: FloatArray, constant: FloatArray, params: FleetParameters
) -> tuple[WearComponent, ...]:
    """Return the prior by length and wandering, over which the spreads are averaged."""
    covariance = np.linalg.inv(T)
    mean = (covariance @ v[..., None])[..., 0]
    log_weight = (
        constant + np.log(grid.prior / grid.unit) - 0.5 * np.linalg.slogdet(T)[1] + 0.5 * np.einsum("gi,gi->g", v, mean)
    )
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    of_wear = [np.flatnonzero(grid.wear == kind) for kind in range(int(grid.wear.max()) + 1)]
    totals = np.array([weight[nodes].sum() for nodes in of_wear])
    kept = np.flatnonzero(totals >= params.least_weight)
    shares = _rounded_shares(totals[kept] / totals[kept].sum(), params)
    components = []
    for kind, share in zip(kept.tolist(), shares, strict=True):
        nodes = of_wear[kind]
        part = weight[nodes] / totals[kind]
        centre = part @ mean[nodes]
        off = mean[nodes] - centre
        within = np.einsum("g,gij->ij", part, covariance[nodes] + grid.spread[nodes]) + (off * part[:, None]).T @ off
        length, wandering = divmod(kind, len(params.wanderings))
        about = (params.lengths_km[length], params.wanderings[wandering])
        components.append(_rounded(share, centre, within, about, params))
    return tuple(component for component in components if component.weight > 0.0)


def _rounded_shares(shares: FloatArray, params: FleetParameters) -> list[float]:
    rounded = np.round(shares / params.share_step)
    return [float(share) for share in rounded / rounded.sum()]


def _rounded(
    share: float, mean: FloatArray, covariance: FloatArray, about: tuple[float, float], params: FleetParameters
) -> WearComponent:
    """Return a component rounded in steps of its spread, so that few points more leave it as it was."""
    stds = np.sqrt(np.diag(covariance))
    steps = np.round(np.log2(stds) * params.std_steps)
    rounded = 2.0 ** (steps / params.std_steps)
    rate, change = np.round(mean / rounded * params.mean_steps) * rounded / params.mean_steps
    correlation = np.round(covariance[0, 1] / stds.prod() / params.share_step) * params.share_step
    limit = 1.0 - params.share_step
    return WearComponent(
        weight=share,
        length=about[0],
        rate=float(rate),
        change=float(change),
        rate_std=float(rounded[0]),
        change_std=float(rounded[1]),
        correlation=float(np.clip(correlation, -limit, limit)),
        wandering=about[1],
    )
