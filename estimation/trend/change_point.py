"""Has an indicator changed at once? A step at one place, against outliers and wear, as hypotheses on the same points.

Model of the points about a place, with x the distance, t the time::

    value_i = level + slope x_i + bend(x_i) + wander(t_i) + size [i >= k] + noise_i

All but the level have normal priors (``StepModel``): the slope of wear and its change, an integrated random walk; the
wandering of weather and friction; the size of a step. Noise is a share of the stated standard deviations, most of which
all points have in common, so that the share is averaged over by its likelihood. Any point may be an outlier, and the
next one is more often after an outlier: what lasts for two points only is no step. A third on end is as rare as any: it
and the two before it are a step. Hypotheses are "no step", "a step before point k" and "a step within point k", which
is then of both sides; each has its own outliers, found one after the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from estimation.trend.parameters import CURVES
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.units import DAY_NS, STD_PER_MAD

NOISE_SHARES = np.geomspace(*CURVES.noise_shares, CURVES.noise_points)


@dataclass(frozen=True, slots=True)
class StepModel:
    """What an indicator does when nothing happens to it, and what a step is; by default equivalent conicity."""

    slope: float = 1e-6  # per km, of usual wear
    slope_std: float = 1.2e-6  # per km
    bend_std: float = 5e-7  # per km, change of slope
    bend_km: float = 30_000.0  # over so much
    wander_std: float = 0.01  # of friction and weather, and of another version of the track
    wander_days: float = 30.0  # in which it changes
    step_std: float = 0.15
    outlier_std: float = 0.1
    step_chance: float = 1e-2  # before any point
    outlier_chance: float = 0.03
    outlier_lasts: float = 0.3  # chance of another one after it
    noise_floor: float = 5e-4
    least_size: float = 0.03  # a step is larger than that with ``sure``
    sure: float = 0.8  # least probability of a step
    least_points: int = 3  # on either side of it
    least_good: int = 2  # of them that are no outliers
    widest: int = 2  # intervals between the points on either side: one may be of both
    points_before: int = 16  # points about a place that decide whether there is a step
    points_behind: int = 12
    places_around: int = 2  # places before and behind the likeliest that share its probability
    points_beside: int = 5  # points of which a median shows where a step may be
    smallest_run_km: float = 1.0  # between points, of which a slope is made
    most_wear: float = 3.0  # standard deviations off the usual slope: among few points noise passes for more
    most_places: int = 4  # that are looked at, those of the largest changes
    usual_noise_share: float = 0.15  # of the prior, as a median and a standard deviation of the logarithm
    noise_spread: float = 0.8
    level_std: float = 10.0  # of the level, in standard deviations of a step: as good as flat
    outlier_deviations: float = 5.0  # median deviations from a running median with which a point begins as an outlier
    most_flips: int = 12
    least_gain: float = 1e-9  # of log evidence: rounding never flips an outlier to and fro
    far_log_odds: float = 7.0  # log odds of a step at a place, below which its neighbours are not looked at
    alike_log_odds: float = 1.0  # of the log odds: places that differ by less
    mixed_share: float = 0.5  # of a step, in an interval in which it happened: mean and standard deviation
    mixed_share_std: float = 0.25
    outlier_share: float = 0.25  # of a step, between an outlier and the level on the other side
    least_change_ratio: float = 1.0  # of a median change over the least size, below which no hypothesis is computed


CONICITY = StepModel(usual_noise_share=1.0)  # what is common to all points is not in their noise


@dataclass(frozen=True, slots=True)
class ChangePoint:
    """A step between two points; those between ``last`` and ``first`` may be of either side."""

    last: int  # point before it
    first: int  # point behind it
    probability: float
    size: float
    std: float
    before: int  # points up to ``last``
    level: float  # median of the points before it


class Series(NamedTuple):
    """Points in order of distance."""

    x_km: FloatArray  # (k,)
    t_ns: FloatArray  # (k,)
    value: FloatArray  # (k,)
    std: FloatArray  # (k,) > 0

    def part(self, first: int, last: int) -> Series:
        """Return the points from ``first`` up to ``last``, which is not of them."""
        return Series(*(column[first:last] for column in self))


def newest_change(series: Series, model: StepModel = CONICITY) -> ChangePoint | None:
    """Return the newest step; None where there is none."""
    begin, newest = 0, None
    while True:  # the newest of the steps among the largest changes of a stretch, then of what is behind it
        stretch = series.part(begin, len(series.value))
        judged = (_judged(stretch, place, model) for place in sorted(_places(stretch, model), reverse=True))
        step = next((change for change in judged if change is not None), None)
        if step is None:
            return newest
        newest = replace(step, last=begin + step.last, first=begin + step.first)
        begin = newest.first


def _places(series: Series, model: StepModel) -> list[int]:
    k, least = len(series.value), model.least_points
    if k < 2 * least:
        return []
    places = np.arange(least, k - least + 1)
    change = np.array([_median_change(series, place, model) for place in places.tolist()])
    size = np.concatenate([[0.0], np.abs(change), [0.0]])
    peak = (size[1:-1] >= size[:-2]) & (size[1:-1] >= size[2:])
    peak &= np.abs(change) > model.least_change_ratio * model.least_size
    order = np.argsort(-np.abs(change[peak]), kind="stable")
    return places[peak][order][: model.most_places].tolist()  # type: ignore[no-any-return]


def _median_change(series: Series, at: int, model: StepModel) -> float:
    about = series.part(max(0, at - model.points_behind), at + model.points_behind)
    run = np.maximum(np.diff(about.x_km), model.smallest_run_km)
    usual, least = model.most_wear * model.slope_std, model.least_points
    wear = min(max(_median((np.diff(about.value) / run).tolist()), model.slope - usual), model.slope + usual)
    flat = series.part(max(0, at - model.points_beside), at + model.points_beside)
    level, here = (flat.value - wear * (flat.x_km - series.x_km[at])).tolist(), min(at, model.points_beside)
    counts = least, model.points_beside
    return min((_median(level[here : here + n]) - _median(level[max(0, here - n) : here]) for n in counts), key=abs)


def _median(values: list[float]) -> float:
    """Return the median; of so few values numpy takes twenty times as long."""
    ordered, half = sorted(values), len(values) // 2
    return ordered[half] if len(values) % 2 else 0.5 * (ordered[half - 1] + ordered[half])


def _judged(series: Series, place: int, model: StepModel) -> ChangePoint | None:
    k, least = len(series.value), model.least_points
    first = max(0, place - model.points_before)
    window = series.part(first, min(k, place + model.points_behind))
    points = _Points.of(window, model)
    at = place - first
    nothing, here = points.evidence(None), points.evidence(_Place(at - 1, at))
    if here.log_evidence + np.log(model.step_chance) < nothing.log_evidence - model.far_log_odds:
        return None
    about = range(max(least, at - model.places_around), min(len(window.value) - least, at + model.places_around) + 1)
    places = [_Place(i - width, i) for i in about for width in range(1, model.widest + 1) if i - width >= least - 1]
    steps = [(where, evidence) for where in places if points.carry(where, evidence := points.evidence(where))]
    if not steps:
        return None
    log_evidence = np.array([evidence.log_evidence for _, evidence in steps])
    log_odds = log_evidence + np.log(model.step_chance) - nothing.log_evidence
    probability = float(1.0 - 1.0 / (1.0 + np.exp(np.minimum(log_odds, 500.0)).sum()))
    likeliest = steps[int(np.argmax(log_odds))][1]
    if min(probability, likeliest.probability_beyond(model.least_size)) < model.sure:
        return None
    as_likely = [where for where, _ in compress(steps, log_odds >= log_odds.max() - model.alike_log_odds)]
    last, behind = first + min(where.last for where in as_likely), first + max(where.first for where in as_likely)
    level = float(np.median(series.value[max(0, last + 1 - model.points_beside) : last + 1]))
    return ChangePoint(last, behind, probability, likeliest.size, likeliest.std, last + 1, level)


class _Place(NamedTuple):
    last: int
    first: int


@dataclass(frozen=True, slots=True)
class _Evidence:
    log_evidence: float
    weight: FloatArray  # (f,) of the shares of noise
    sizes: FloatArray  # (f,)
    stds: FloatArray  # (f,)
    out: BoolArray  # (n,) outliers

    @property
    def size(self) -> float:
        return float(self.weight @ self.sizes)

    @property
    def std(self) -> float:
        return float(np.sqrt(self.weight @ (self.stds**2 + (self.sizes - self.size) ** 2)))

    def probability_beyond(self, least: float) -> float:
        """Return the probability that the step goes the way it seems to go and is larger than that."""
        return float(ndtr((abs(self.size) - least) / self.std))


@dataclass(frozen=True, slots=True)
class _Points:
    value: FloatArray  # (n,) less their median
    covariance: FloatArray  # (n, n)
    noise: FloatArray  # (f, n) variances
    model: StepModel

    @classmethod
    def of(cls, series: Series, model: StepModel) -> _Points:
        x = series.x_km - series.x_km[0]
        days = (series.t_ns - series.t_ns[0]) / DAY_NS
        early, late = np.minimum.outer(x, x), np.maximum.outer(x, x)
        bend = model.bend_std**2 / model.bend_km * early**2 * (3.0 * late - early) / 6.0
        wander = model.wander_std**2 * np.exp(-np.abs(np.subtract.outer(days, days)) / model.wander_days)
        level = (model.level_std * model.step_std) ** 2
        covariance = level + model.slope_std**2 * np.outer(x, x) + bend + wander
        noise = np.outer(NOISE_SHARES**2, series.std**2) + model.noise_floor**2
        value = series.value - model.slope * x
        return cls(value - np.median(value), covariance, noise, model)

    def evidence(self, place: _Place | None) -> _Evidence:
        """Return the evidence of a step, or of none, with the outliers that suit it best."""
        number = np.arange(len(self.value))
        last, first = place or (len(number), len(number))
        mixed = (number > last) & (number < first)
        step = np.where(mixed, self.model.mixed_share, number >= first)
        covariance = self.covariance + self.model.step_std**2 * np.outer(step, step)
        covariance += (self.model.mixed_share_std * self.model.step_std) ** 2 * np.diag(mixed)
        out = self._begin(first)
        best = None
        for _ in range(self.model.most_flips):
            inverse, log_evidence = self._inverse(covariance, out)
            total = float(np.logaddexp.reduce(log_evidence))
            if best is None or total > best[0]:
                best = total, inverse, log_evidence, out
            share = int(np.argmax(log_evidence))
            flipped = self._flipped(inverse[share], share, out)
            if flipped is None:
                break
            out = flipped
        total, inverse, log_evidence, out = best  # type: ignore[misc]  # there was a first round
        weight = np.exp(log_evidence - total)
        sizes = self.model.step_std**2 * np.einsum("i,fij,j->f", step, inverse, self.value)
        open_share = 1.0 - self.model.step_std**2 * np.einsum("i,fij,j->f", step, inverse, step)
        return _Evidence(total, weight, sizes, self.model.step_std * np.sqrt(np.maximum(open_share, 1e-12)), out)

    def carry(self, place: _Place, evidence: _Evidence) -> bool:
        """Return whether enough points on both sides are good, or outliers that are not of the other side."""
        sides = slice(0, place.last + 1), slice(place.first, None)
        good = [~evidence.out[side] for side in sides]
        if min(of_side.sum() for of_side in good) < self.model.least_good:
            return False
        count = self.model.points_beside
        nearest = zip(sides, good, (slice(-count, None), slice(count)), strict=True)
        before, behind = (np.median(self.value[side][of_side][keep]) for side, of_side, keep in nearest)
        off = self.model.outlier_share * abs(evidence.size)
        apart = [np.abs(self.value[side] - level) > off for side, level in zip(sides, (behind, before), strict=True)]
        counts = [int((of_side | off_other).sum()) for of_side, off_other in zip(good, apart, strict=True)]
        return min(counts) >= self.model.least_points

    def _begin(self, first: int) -> BoolArray:
        sides = self.value[:first], self.value[first:]
        apart = np.concatenate([side - _running_median(side, self.model) for side in sides])
        scale = STD_PER_MAD * np.median(np.abs(apart)) + self.model.noise_floor
        return np.asarray(np.abs(apart) > self.model.outlier_deviations * scale)

    def _variance(self, out: BoolArray) -> FloatArray:
        return self.noise + self.model.outlier_std**2 * out

    def _inverse(self, covariance: FloatArray, out: BoolArray) -> tuple[FloatArray, FloatArray]:
        n = len(self.value)
        full = covariance + self._variance(out)[:, :, None] * np.eye(n)
        factor = np.linalg.cholesky(full)
        whitened = np.linalg.inv(factor)
        log_size = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        inverse = np.einsum("fki,fkj->fij", whitened, whitened)
        residual = whitened @ self.value
        prior = -0.5 * ((np.log(NOISE_SHARES) - np.log(self.model.usual_noise_share)) / self.model.noise_spread) ** 2
        prior -= np.logaddexp.reduce(prior)
        return inverse, prior + self._log_prior(out) - log_size - 0.5 * (residual**2).sum(axis=1)

    def _log_prior(self, out: BoolArray) -> float:
        m = self.model
        before = np.concatenate([[False, False], out[:-1]])
        chance = np.where(before[1:] & ~before[:-1], m.outlier_lasts, m.outlier_chance)
        return float(np.log(np.where(out, chance, 1.0 - chance)).sum())

    def _flipped(self, inverse: FloatArray, share: int, out: BoolArray) -> BoolArray | None:
        """Return the outliers with the one change that makes them most probable; None where none does."""
        precision = np.diagonal(inverse)
        apart = (inverse @ self.value) / precision
        now = self._variance(out)[share]
        then = self._variance(~out)[share]
        others = 1.0 / precision - now  # variance of what the other points say of it
        gain = _log_normal(apart, others + then) - _log_normal(apart, others + now)
        prior = self._log_prior(out)
        for i in range(len(out)):
            changed = out.copy()
            changed[i] = not out[i]
            gain[i] += self._log_prior(changed) - prior
        best = int(np.argmax(gain))
        if gain[best] <= self.model.least_gain:
            return None
        changed = out.copy()
        changed[best] = not out[best]
        return changed


def _log_normal(apart: FloatArray, variance: FloatArray) -> FloatArray:
    return np.asarray(-0.5 * (np.log(variance) + apart**2 / variance))


def _running_median(value: FloatArray, model: StepModel) -> FloatArray:
    count = model.points_beside
    first = (max(0, i - count // 2) for i in range(len(value)))
    return np.array([np.median(value[begin : begin + count][-count:]) for begin in first])
