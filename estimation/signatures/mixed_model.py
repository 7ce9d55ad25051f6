"""The regression of a library: features = response(conicity, speed) + track of the place + wheelset + rest.

Features are the level, the shape of y over the bands, and per band the ratios R over y and roll over R, all as
logarithms: in ratios most of the track cancels, so that their covariances are small and nearly diagonal. The level is
the mean logarithm of the powers of y and R.

The response is a polynomial of second order in the logarithms of conicity and speed, and the product of conicity and
the level of the place: a wheel has another conicity where the motion is larger. The track of a place adds the same to
all that pass it: the logarithm of a power is that of the track's plus that of what the wheelset does with it. So where
the library has a place its track cancels; where it does not, the track is a random effect, whose covariance over places
and sections the library shows: what all tracks have in common, as the form of their spectra, cancels still. What a
wheelset has of its own, such as its vehicle's differences from the class, is a random effect, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated

import numpy as np

from estimation.signatures.parameters import SIGNATURE
from estimation.values.arrays import FloatArray, FrozenArrays, IntArray
from estimation.values.signatures import SIGNALS

TERMS = 5  # without the product of conicity and level
LEVEL = 0  # number of the feature


@dataclass(frozen=True, slots=True)
class MixedModel(FrozenArrays):
    """What the library has taught, over f features; covariances (f, f)."""

    response: Annotated[FloatArray, TERMS + 1, "f"]  # ; the last row is of the product of conicity and level
    mean: Annotated[FloatArray, "f"]  # of all places
    of_level: Annotated[FloatArray, "f"]  # by how much the effects of places change with their level
    places: Annotated[FloatArray, "p", "f"]  # effects of the known places
    passes: Annotated[FloatArray, "p"]  # entries behind each
    rest: Annotated[FloatArray, "f", "f"]
    of_wheelset: Annotated[FloatArray, "f", "f"]
    of_fit: Annotated[FloatArray, "f", "f"]  # of wheelsets and the errors of their conicities, for the fit
    leverage: Annotated[FloatArray, 3, 3]  # of 1, and logarithm of the conicity and its square, by wheelset
    of_place: Annotated[FloatArray, "f", "f"]  # of places of one section
    of_section: Annotated[FloatArray, "f", "f"]

    @property
    def levels(self) -> FloatArray:
        """Levels (p,) of the known places, from their mean."""
        return np.asarray(self.places[:, LEVEL] - self.mean[LEVEL])


@dataclass(frozen=True, slots=True)
class Rows:
    """Entries as arrays; places, sections and wheelsets are numbers from 0."""

    powers: FloatArray  # (n, f) logarithms, signal after signal: y, R, roll
    conicity: FloatArray  # (n,) expected, given that on file
    on_file: FloatArray  # (n,) conicity
    speed: FloatArray  # (n,) m/s
    place: IntArray  # (n,)
    section: IntArray  # (n,)
    wheelset: IntArray  # (n,)
    variance: FloatArray  # (n,) of the logarithm of the conicity: how well it is known

    def chosen(self, which: Sequence[int] | IntArray) -> Rows:
        """Return some of the rows."""
        at = np.asarray(which, dtype=np.int64)
        return Rows(*(getattr(self, item.name)[at] for item in fields(self)))


def features_of(powers: FloatArray) -> FloatArray:
    """Return features (n, f), the level first, of logarithms of powers (n, f), signal after signal: y, R, roll."""
    y, difference, roll = np.split(powers, SIGNALS, axis=1)
    level = 0.5 * (y.mean(axis=1) + difference.mean(axis=1))
    shape = y - y.mean(axis=1)[:, None]  # the last band follows from the others
    return np.concatenate([level[:, None], shape[:, :-1], difference - y, roll - difference], axis=1)


def terms(conicity: FloatArray, speed: FloatArray) -> FloatArray:
    """Return the terms (..., 5) of the response, the logarithm of the conicity first."""
    c, v = np.broadcast_arrays(np.log(conicity / SIGNATURE.middle_conicity), np.log(speed / SIGNATURE.usual_speed))
    return np.stack([c, c * c, v, v * v, c * v], axis=-1)


def track_effects(rows: Rows) -> FloatArray:
    """Return what the features (n, f) of entries have beyond the response: track, wheelset and rest."""
    features, regressors, place = features_of(rows.powers), terms(rows.conicity, rows.speed), rows.place
    return np.asarray(features - regressors @ _within(regressors, features, place))


def fitted(rows: Rows) -> MixedModel:
    """Return the model of a library."""
    # The response is that within places (their effects are fixed in it), and covariances follow from its residuals,
    # step by step: of wheelsets, of places, of sections. What the errors of the known conicities add to the covariance
    # of wheelsets is taken out again: they are none of the features.
    kept, place = np.unique(rows.place, return_inverse=True)
    response, left = _response(rows, place)
    effects = _means(left, place)
    residuals = left - effects[place]
    wheelset = np.unique(rows.wheelset, return_inverse=True)[1]
    of_own, of_rest = scatter_of(residuals, wheelset, len(kept))
    sections, section = np.unique(rows.section[np.unique(place, return_index=True)[1]], return_inverse=True)
    mean = _means(effects, section).mean(axis=0)
    level = effects[:, LEVEL] - mean[LEVEL]
    of_level = level @ (effects - mean) / max(float(level @ level), SIGNATURE.ridge_variance)
    around = effects - mean - level[:, None] * of_level
    by_section = _means(around, section)
    bent = _bent(_means(rows.conicity[:, None], wheelset)[:, 0])
    of_place = _covariance(around - by_section[section], max(len(kept) - len(sections), 1))
    of_section = _covariance(by_section, max(len(sections) - 1, 1))
    return MixedModel(
        response=response,
        mean=mean,
        of_level=np.asarray(of_level),
        places=effects,
        passes=np.bincount(place).astype(np.float64),
        rest=of_rest,
        of_wheelset=_less(of_own, _of_errors(rows, response, level[place])),
        of_fit=of_own,
        leverage=np.asarray(np.linalg.pinv(bent.T @ bent)),
        of_place=_less(of_place, of_rest * _of_means(place)),
        of_section=_less(of_section, of_place * _of_means(section)),
    )


def _of_errors(rows: Rows, response: FloatArray, level: FloatArray) -> FloatArray:
    """Return the covariance (f, f) that errors of the known conicities give the features, by the slopes at each."""
    c, v = np.log(rows.conicity / SIGNATURE.middle_conicity), np.log(rows.speed / SIGNATURE.usual_speed)
    none = np.zeros_like(c)
    slopes = np.stack([none + 1.0, 2.0 * c, none, none, v, level], axis=1) @ response
    return np.asarray((slopes * rows.variance[:, None]).T @ slopes / len(slopes))


def scatter_of(residuals: FloatArray, wheelset: IntArray, means: int) -> tuple[FloatArray, FloatArray]:
    """Return the covariances (f, f) of residuals, less ``means`` means as of places, of wheelsets and within these."""
    of_wheelsets = _means(residuals, wheelset)
    freedom = max(len(residuals) - means - len(of_wheelsets), 1)
    rest = _covariance(residuals - of_wheelsets[wheelset], freedom)
    of_means = _covariance(of_wheelsets, max(len(of_wheelsets) - TERMS, 1))
    return _less(of_means, rest * _of_means(wheelset)), rest


def _bent(conicity: FloatArray) -> FloatArray:
    c = np.log(conicity / SIGNATURE.middle_conicity)
    return np.stack([np.ones_like(c), c, c * c], axis=-1)


def _response(rows: Rows, place: IntArray) -> tuple[FloatArray, FloatArray]:
    features, regressors = features_of(rows.powers), terms(rows.conicity, rows.speed)
    first = _within(regressors, features[:, [LEVEL]], place)
    level = _means(features[:, [LEVEL]] - regressors @ first, place)[place]
    product = regressors[:, [0]] * (level - level.mean())
    full = np.concatenate([regressors, product], axis=1)
    response = _within(full, features, place)
    response[:, LEVEL] = np.append(first[:, 0], 0.0)
    return response, np.asarray(features - full @ response)


def _within(regressors: FloatArray, values: FloatArray, place: IntArray) -> FloatArray:
    """Return the coefficients (t, f) of values (n, f) on regressors (n, t), means of places taken out of both."""
    place = np.unique(place, return_inverse=True)[1]
    apart = [array - _means(array, place)[place] for array in (regressors, values)]
    return np.asarray(np.linalg.lstsq(apart[0], apart[1], rcond=None)[0], dtype=np.float64)


def _means(values: FloatArray, group: IntArray) -> FloatArray:
    count = np.bincount(group)
    sums = np.stack([np.bincount(group, column) for column in values.T], axis=1)
    return np.asarray(sums / count[:, None])


def _covariance(residuals: FloatArray, freedom: int) -> FloatArray:
    raw = residuals.T @ residuals / freedom
    share, ridge = SIGNATURE.covariance_shrinkage, SIGNATURE.ridge_variance
    return np.asarray((1 - share) * raw + share * np.diag(np.diag(raw)) + ridge * np.eye(len(raw)))


def _of_means(group: IntArray) -> float:
    """Return the share of a variance that is left in means by group, on the average of these."""
    count = np.bincount(group)
    return float(np.mean(1.0 / count[count > 0]))


def _less(whole: FloatArray, part: FloatArray) -> FloatArray:
    root = np.linalg.cholesky(whole)
    half = np.linalg.solve(root, part)
    share, axes = np.linalg.eigh(np.linalg.solve(root, half.T))
    left = root @ axes * np.sqrt(1.0 - np.clip(share, 0.0, SIGNATURE.largest_share))
    return np.asarray(left @ left.T)


def level_of(model: MixedModel, rows: Rows, conicity: float) -> float:
    """Return the level of the track under some signatures, from the mean of the known places."""
    response = terms(np.array(conicity), rows.speed).mean(axis=0) @ model.response[:TERMS, LEVEL]
    return float(features_of(rows.powers)[:, LEVEL].mean() - response - model.mean[LEVEL])


def levels_between(model: MixedModel, section: IntArray, places: int) -> tuple[float, float]:
    """Return between which levels the mean of some places is where their section is like those of a library."""
    # it may be as far outside as the outermost section is from the next
    section = np.unique(section, return_inverse=True)[1]
    mean = np.bincount(section, model.levels) / np.bincount(section)
    within = float(np.std(model.levels - mean[section]))
    ordered = np.sort(mean)
    gap = float(max(ordered[1] - ordered[0], ordered[-1] - ordered[-2], SIGNATURE.level_margin))
    reach = gap + 2.0 * within / np.sqrt(places)
    return float(ordered[0]) - reach, float(ordered[-1]) + reach


@dataclass(frozen=True, slots=True)
class Likelihood:
    """How well each conicity explains the features of a wheelset."""

    conicity: FloatArray  # (k,)
    distance: FloatArray  # (k,) squared Mahalanobis distances
    whole: float  # least squared distance, over the number of features
    roll: float  # at that conicity, of roll over R in the shorter half of the bands alone

    @property
    def posterior(self) -> FloatArray:
        """Probabilities (k,) of the conicities, all alike beforehand."""
        weight = np.exp(-0.5 * (self.distance - self.distance.min()))
        return np.asarray(weight / weight.sum())

    @property
    def mean(self) -> float:
        """Mean of the posterior."""
        return float(self.posterior @ self.conicity)

    @property
    def std(self) -> float:
        """Standard deviation of the posterior, that of its grid at least."""
        spread = float(self.posterior @ (self.conicity - self.mean) ** 2)
        return float(np.sqrt(spread + (self.conicity[1] - self.conicity[0]) ** 2 / 12))


def likelihood(model: MixedModel, rows: Rows, known: IntArray | None, conicity: FloatArray) -> Likelihood:
    """Return how well conicities explain the mean of signatures at known places (n,) of the model; None: at others."""
    n = len(rows.powers)
    features = features_of(rows.powers).mean(axis=0)
    base = terms(conicity[:, None], rows.speed[None, :]).mean(axis=1)
    expected = base @ model.response[:TERMS]
    covariance = model.rest / n + model.of_wheelset
    if known is None:
        places, sections = len(np.unique(rows.place)), len(np.unique(rows.section))
        covariance = covariance + model.of_place / places + model.of_section / sections
        level = features[LEVEL] - expected[:, LEVEL] - model.mean[LEVEL]
        track = model.mean + level[:, None] * model.of_level
    else:
        level = np.full(len(conicity), model.levels[known].mean())
        track = model.places[known].mean(axis=0)[None, :]
        shares = np.bincount(known, minlength=len(model.passes)) / n
        covariance = covariance + model.rest * float(np.sum(shares**2 / model.passes))
    expected = expected + (base[:, 0] * level)[:, None] * model.response[TERMS] + track
    difference = (features - expected).T
    nearest = _distances(covariance, difference).argmin()
    term = _bent(conicity[nearest : nearest + 1])[0]
    covariance = covariance + float(term @ model.leverage @ term) * model.of_fit
    distance = _distances(covariance, difference)
    best, rolls = int(distance.argmin()), len(features) // SIGNALS // 2  # the shorter half of the bands
    of_roll = _distances(covariance[-rolls:, -rolls:], difference[-rolls:, best : best + 1])
    return Likelihood(conicity, distance, float(distance[best]) / len(features), float(of_roll[0]) / rolls)


def _distances(covariance: FloatArray, difference: FloatArray) -> FloatArray:
    return np.asarray(np.sum(np.linalg.solve(np.linalg.cholesky(covariance), difference) ** 2, axis=0))
