"""The regression of a library: features = response(conicity, speed) + track of the place + wheelset + rest.

The response is a second-order polynomial in the logarithms of conicity and speed. The track of a place adds the same to
all that pass it: the logarithm of a power is that of the track's plus that of what the wheelset makes of it. So where
the library has a place its track cancels; where it does not, the track is a random effect, whose covariance over places
and sections the library shows: what all tracks have in common, as the form of their spectra, cancels still. What a
wheelset has of its own, such as its vehicle's differences from the class, is a random effect, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray, IntArray, frozen_array

CONICITY, SPEED = 0.2, 20.0  # that the polynomial is about
TERMS = 5
SHRINKING = 0.1  # of covariances towards their diagonals
RIDGE = 1e-4  # variance of a log feature that nothing is better known than


@dataclass(frozen=True, slots=True)
class MixedModel:
    """What the library has taught, over f features; covariances (f, f)."""

    response: FloatArray  # (5, f)
    mean: FloatArray  # (f,) of all places
    places: FloatArray  # (p, f) effects of the known places
    passes: FloatArray  # (p,) entries behind each
    rest: FloatArray
    of_wheelset: FloatArray
    of_place: FloatArray  # of places of one section
    of_section: FloatArray

    def __post_init__(self) -> None:
        f = len(self.mean)
        object.__setattr__(self, "response", frozen_array(self.response, (TERMS, f), name="response"))
        object.__setattr__(self, "mean", frozen_array(self.mean, (f,), name="mean"))
        object.__setattr__(self, "places", frozen_array(self.places, (None, f), name="places"))
        object.__setattr__(self, "passes", frozen_array(self.passes, (len(self.places),), name="passes"))
        for name in ("rest", "of_wheelset", "of_place", "of_section"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (f, f), name=name))


@dataclass(frozen=True, slots=True)
class Rows:
    """Entries as arrays; places, sections and wheelsets are numbers from 0."""

    features: FloatArray  # (n, f)
    conicity: FloatArray  # (n,)
    speed: FloatArray  # (n,) m/s
    place: IntArray  # (n,)
    section: IntArray  # (n,)
    wheelset: IntArray  # (n,)

    def chosen(self, which: Sequence[int] | IntArray) -> Rows:
        """Return some of the rows.

        Parameters
        ----------
        which
            Their numbers.
        """
        at = np.asarray(which, dtype=np.int64)
        columns = (self.features, self.conicity, self.speed, self.place, self.section, self.wheelset)
        return Rows(*(column[at] for column in columns))


def terms(conicity: FloatArray, speed: FloatArray) -> FloatArray:
    """Return the terms (..., 5) of the response.

    Parameters
    ----------
    conicity, speed
        Of shapes that broadcast; speed in m/s.
    """
    c, v = np.broadcast_arrays(np.log(conicity / CONICITY), np.log(speed / SPEED))
    return np.stack([c, c * c, v, v * v, c * v], axis=-1)


def fitted(rows: Rows) -> MixedModel:
    """Return the model of a library.

    The response is that within places (their effects are fixed in it), and covariances follow from its residuals,
    step by step: of wheelsets, of places, of sections.

    Parameters
    ----------
    rows
        Entries of one class and axle position.
    """
    kept, place = np.unique(rows.place, return_inverse=True)
    regressors = terms(rows.conicity, rows.speed)
    within = [values - _means(values, place)[place] for values in (regressors, rows.features)]
    response = np.linalg.lstsq(within[0], within[1], rcond=None)[0]
    left = rows.features - regressors @ response
    effects = _means(left, place)
    residuals = left - effects[place]
    wheelsets, wheelset = np.unique(rows.wheelset, return_inverse=True)
    own = _means(residuals, wheelset)
    rest = residuals - own[wheelset]
    freedom = max(len(rest) - len(kept) - len(wheelsets), 1)
    sections, section = np.unique(rows.section[np.unique(place, return_index=True)[1]], return_inverse=True)
    by_section = _means(effects, section)
    around = effects - by_section[section]
    mean = by_section.mean(axis=0)
    of_sections = by_section - mean
    return MixedModel(
        response=response,
        mean=mean,
        places=effects,
        passes=np.bincount(place).astype(np.float64),
        rest=_covariance(rest, freedom),
        of_wheelset=_covariance(own, max(len(wheelsets) - TERMS, 1)),
        of_place=_covariance(around, max(len(kept) - len(sections), 1)),
        of_section=_covariance(of_sections, max(len(sections) - 1, 1)),
    )


def _means(values: FloatArray, group: IntArray) -> FloatArray:
    """Return the means (g, k) of rows (n, k) by group."""
    count = np.bincount(group)
    sums = np.stack([np.bincount(group, column) for column in values.T], axis=1)
    return np.asarray(sums / count[:, None])


def _covariance(residuals: FloatArray, freedom: int) -> FloatArray:
    raw = residuals.T @ residuals / freedom
    return np.asarray((1 - SHRINKING) * raw + SHRINKING * np.diag(np.diag(raw)) + RIDGE * np.eye(len(raw)))


@dataclass(frozen=True, slots=True)
class Likelihood:
    """How well each conicity explains the features of a wheelset."""

    conicity: FloatArray  # (k,)
    distance: FloatArray  # (k,) squared Mahalanobis distances

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
    """Return how well conicities explain the mean of some signatures of one wheelset.

    Parameters
    ----------
    model
        Of the library.
    rows
        Signatures of the wheelset; their conicities are not read.
    known
        (n,) numbers of their places in the model; None where the library does not have them.
    conicity
        (k,) increasing.
    """
    n = len(rows.features)
    mean_terms = terms(conicity[:, None], rows.speed[None, :]).mean(axis=1)
    expected = mean_terms @ model.response
    covariance = model.rest / n + model.of_wheelset
    if known is None:
        places, sections = len(np.unique(rows.place)), len(np.unique(rows.section))
        covariance = covariance + model.of_place / places + model.of_section / sections
        track = model.mean
    else:
        track = model.places[known].mean(axis=0)
        shares = np.bincount(known, minlength=len(model.passes)) / n
        covariance = covariance + model.rest * float(np.sum(shares**2 / model.passes))
    residual = rows.features.mean(axis=0) - track - expected
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), residual.T)
    return Likelihood(conicity, np.sum(whitened**2, axis=0))
