"""A robust wear curve through points with known standard deviations: level and slope now, and when a limit is reached.

Model, with ``a`` the distance or time since the profile began to wear::

    value_i = level + wear(a_i) + noise_i,    noise_i ~ N(0, (std_i^2 + tau^2) / lambda_i)
    wear'(a) = rate + change exp(-a / length) + wandering(a)

The rate goes from one at the begin to a lasting one, or grows as ``rate + change a``: wear that saturates, accelerates
or runs in is carried on into the forecast. It may change at once at one of the knots, a knee. It
wanders besides, as a random walk (at knots before the last point, continuously after it), so that a forecast
far beyond what was observed is wide. Rate and change have a prior from the fleet
(``estimation.trend.fleet``), or none: the rate is then flat, the change in shares of a pilot slope. Extra scatter
``tau`` covers standard deviations that were too small. Outliers are noise from a second, ten times wider normal;
``lambda_i`` is the precision this leaves each point (expectation-maximisation). ``tau``, lengths, wandering and the
components of the prior are averaged over a grid by their marginal likelihood, so every result is a mixture of normals:
quantiles come from its distribution function, without random numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from estimation.trend.calibration import SharedError
from estimation.trend.parameters import CURVES
from estimation.trend.wear_grid import Counted, ScaledPoints, robust, scaled_points
from estimation.values.arrays import FloatArray
from estimation.values.mixture import NormalMixture
from estimation.values.trend import WearComponent


@dataclass(frozen=True, slots=True)
class WearCurve:
    """The posterior of level and slope at the last point, as a mixture over the grid nodes, in the caller's units."""

    weight: FloatArray  # (m,)
    level: FloatArray  # (m,)
    slope: FloatArray  # (m,)
    # (m,) change of slope still to come; of one that never dies out, what it is per distance
    damped: FloatArray
    covariance: FloatArray  # (m, 3, 3) of (level, slope, damped)
    wandering: FloatArray  # (m,) standard deviation of the slope per square root of distance
    length: FloatArray  # (m,) distance over which the change of slope dies out; inf where it never does
    share: FloatArray  # (k,) lambda: what each point counts, 1 for a good one
    converged: bool = True  # whether the shares stopped changing

    def less(self, error: SharedError) -> WearCurve:
        """Return the curve less the error that all its points have in common, as far as that is known."""
        off = np.zeros((len(self.weight), 3, 2))
        off[:, 0] = 1.0, error.of_scale
        off[:, 1, 1], off[:, 2, 1] = error.scale_std * self.slope, error.scale_std * self.damped
        level, slope, damped = np.stack(self._means) - (off @ error.mean).T
        covariance = self.covariance + off @ error.covariance @ off.transpose(0, 2, 1)
        return replace(self, level=level, slope=slope, damped=damped, covariance=covariance)

    def growing(self, ahead: float, falling_share: float) -> WearCurve:
        """Return the curve of an indicator that grows: whose slope now and ``ahead`` is below 0 in a small share only.

        A node is split: what is believed of it as it is, and the part with a slope above 0, by its first two moments.
        """
        lasts = np.isinf(self.length)
        later = np.where(lasts, ahead, -np.expm1(-ahead / self.length))
        mean, C = np.stack([self.level, self.slope, self.damped], axis=1), self.covariance
        chance = np.ones(len(self.weight))
        for of_damped in (np.zeros_like(later), later):
            slope = mean[:, 1] + of_damped * mean[:, 2]
            with_all = C[:, :, 1] + of_damped[:, None] * C[:, :, 2]  # covariances with that slope
            std = np.sqrt(with_all[:, 1] + of_damped * with_all[:, 2])
            # moments of the part above 0 of a normal distribution
            share = np.maximum(ndtr(slope / std), CURVES.least_growing)
            hazard = np.exp(-0.5 * (slope / std) ** 2) / np.sqrt(2.0 * np.pi) / share
            toward = with_all / std[:, None]
            mean = mean + toward * hazard[:, None]
            less = np.minimum(hazard * (hazard + slope / std), 1.0)
            C = C - toward[:, :, None] * toward[:, None, :] * less[:, None, None]
            chance *= share
        weight = np.concatenate([falling_share * self.weight, (1.0 - falling_share) * chance * self.weight])
        level, slope, damped = (np.concatenate(pair) for pair in zip(self._means, mean.T, strict=True))
        return replace(
            self,
            weight=weight / weight.sum(),
            level=level,
            slope=slope,
            damped=damped,
            covariance=np.concatenate([self.covariance, C]),
            wandering=np.tile(self.wandering, 2),
            length=np.tile(self.length, 2),
        )

    @property
    def _means(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.level, self.slope, self.damped

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
        lengths, which = np.unique(self.length, return_inverse=True)
        means, C = np.stack(self._means), self.covariance.reshape(-1, 9)
        mean, variance = np.empty((2, len(distances), len(self.weight)))
        for number, length in enumerate(lengths.tolist()):
            of = which == number
            effects = np.column_stack([np.ones(len(distances)), distances, _damped(distances, length)])
            pairs = (effects[:, :, None] * effects[:, None, :]).reshape(-1, 9)
            mean[:, of], variance[:, of] = effects @ means[:, of], pairs @ C[of].T
        variance += (distances**3 / 3.0)[:, None] * self.wandering**2
        return mean, np.sqrt(np.maximum(variance, 0.0))

    def reaches(self, limit: float, probability: float, horizon: float) -> float | None:
        """Return the distance after which ``limit`` has been reached with ``probability``; None beyond the horizon."""
        return self.reached_with(limit, probability, self.ahead(limit, horizon))

    def ahead(self, limit: float, horizon: float) -> tuple[FloatArray, FloatArray]:
        """Return distances (n,) up to the horizon and the probabilities that the level is above a limit there."""
        distances = horizon * np.linspace(0.0, 1.0, CURVES.points_ahead) ** 2
        return distances, self.above_after(distances, limit)

    def reached_with(self, limit: float, probability: float, ahead: tuple[FloatArray, FloatArray]) -> float | None:
        """Return what :meth:`reaches` does, of what is ahead."""

        # the probability of having reached the limit at a distance is that of the level being above it there or at any
        # shorter distance looked at (its running maximum), as in Fieller's interval for a ratio
        def short(distance: float) -> float:
            return self.level_after(distance).above(limit) - probability

        if short(0.0) >= 0.0:
            return 0.0
        distances, above = ahead
        for i in np.flatnonzero(above >= probability - CURVES.probability_margin):
            before, distance = float(distances[i - 1]), float(distances[i])
            if i > 0 and short(distance) >= 0.0:
                return float(brentq(short, before, distance, xtol=1e-6 * float(distances[-1])))
        return None

    def above_after(self, distances: FloatArray, limit: float) -> FloatArray:
        """Return the probabilities (n,) that the level is above a limit at distances (n,) after the last point."""
        mean, std = self._after(distances)
        return np.asarray(ndtr((mean - limit) / std) @ self.weight)


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
    counted = robust(points, prior)
    return _unscale(points, counted)


def _unscale(points: ScaledPoints, counted: Counted) -> WearCurve:
    rise, nodes, shapes = points.unit / points.span, counted.nodes, counted.shapes
    length = shapes.lengths[shapes.which[nodes.shape]]
    # from rate and change to the slope at the last point and what is still to come of the change
    age, lasts = points.age + 1.0, np.isinf(length)
    left = np.exp(-age / length)
    turn = np.zeros((len(length), 3, 3))
    turn[:, 0, 0] = points.unit
    turn[:, 1, 1] = rise
    turn[:, 1, 2] = rise * np.where(lasts, age, left)
    turn[:, 2, 2] = rise * np.where(lasts, 1.0 / points.span, -left)
    level, slope, damped = np.einsum("mij,mj->im", turn, nodes.beta)
    return WearCurve(
        weight=nodes.weight,
        level=points.shift + level,
        slope=slope,
        damped=damped,
        covariance=turn @ nodes.covariance @ turn.transpose(0, 2, 1),
        wandering=shapes.wandering[nodes.shape] * rise / np.sqrt(points.span),
        length=points.span * length,
        share=counted.share,
        converged=counted.converged,
    )


def _damped(distance: FloatArray, length: float) -> FloatArray:
    """Return the integral (n,) of a change of slope from 0 that goes to 1 over a length, or grows as the distance."""
    if np.isinf(length):
        return np.asarray(0.5 * distance**2)
    u = distance / length
    return np.asarray(length * (u - 1.0 + np.exp(-u)))
