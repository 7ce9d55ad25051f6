"""How far the answers of a library were off where it did not know the wheelset, or neither wheelset nor section.

Every wheelset of the library is judged by the others, section by section. What differs from the conicity on file is
the error of the answer, whose standard deviation is that of the posterior times a factor, and the error of what is on
file, as far as it is the wheelset's own. The factor is near 1 beforehand, and how near the errors show: its posterior
is on a grid, each wheelset counts once, and the interval is that of the mixture over it (A. Gelman and others,
"Bayesian Data Analysis", 2013, chapter 3). Answers that a library would refuse do not count: outside its conicities, or
about sections rougher or smoother than its tracks.

Errors of geometries have a part in common, such as that of a class's creep coefficients. It does not show in the
differences, and all answers have it. How large it is ``on_file`` says, and the mixture is over that as well.

What the conicities on file may be off by: each wheelset's own errors, and errors in common.

Errors of measured profiles are each wheelset's own as far as the differences of the library hold them. Those of
geometries rest on one class, one survey and one set of filters; some of their variance is the wheelset's own. How much
has a posterior: differences from the answers are the errors of these, whose standard deviation is not known either,
and the own errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np
from scipy import special
from scipy.optimize import brentq
from scipy.special import ndtr

from estimation.signatures.mixed_model import Likelihood, MixedModel, Rows, fitted, level_of, levels_between, likelihood
from estimation.signatures.parameters import SIGNATURE
from estimation.signatures.window_signatures import SignatureParameters, families
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import Basis, ConicitySource, LibraryEntry

SHARES: FloatArray = np.asarray(np.linspace(0.0, 1.0, SIGNATURE.share_points))  # of the variances of geometries
COVERAGE = SIGNATURE.interval_coverage
_NONE = np.eye(len(SHARES))[0]  # no share of anything


@dataclass(frozen=True, slots=True)
class OnFile(FrozenArrays):
    """Standard deviations of the conicities of some entries."""

    conicity: Annotated[FloatArray, "n"]
    own: Annotated[FloatArray, "n"]  # of errors that are each wheelset's own
    shared: Annotated[FloatArray, "n"]  # of errors in common
    claimed: Annotated[FloatArray, "n"]  # of errors of which a share of the variance is each wheelset's own
    shares: Annotated[FloatArray, len(SHARES)]  # probabilities of ``SHARES``

    @property
    def alone(self) -> FloatArray:
        """Std (n,) of all errors that are each wheelset's own, with the share that is expected."""
        return np.asarray(np.hypot(self.own, np.sqrt(float(self.shares @ SHARES)) * self.claimed))

    def shared_std(self, conicity: float) -> FloatArray:
        """Return the std (k,) of what is off in common about a conicity, by share."""
        # errors in common add up as they are, not as squares: it is a mean of standard deviations, of all entries or of
        # those near by, whichever is larger
        each = self.shared[:, None] + np.sqrt(1.0 - SHARES) * self.claimed[:, None]
        near = np.exp(-0.5 * ((self.conicity - conicity) / SIGNATURE.near_conicity) ** 2) + np.finfo(np.float64).tiny
        return np.asarray(np.maximum(each.mean(axis=0), near @ each / near.sum()))


def unjudged(entries: Sequence[LibraryEntry]) -> OnFile:
    """Return what entries may be off by before anything of them is judged: of measured profiles all is their own."""
    conicity, std = np.array([entry.conicity for entry in entries]), np.array([entry.std for entry in entries])
    measured = np.array([entry.source is ConicitySource.MEASURED_PROFILES for entry in entries])
    return OnFile(conicity, measured * std, 0.0 * std, ~measured * std, _NONE)


@dataclass(frozen=True, slots=True)
class Differences:
    """How far wheelsets are judged from what is on file of them."""

    difference: FloatArray  # (w,) conicities, means over answers
    answers: FloatArray  # (w,) how many
    own: FloatArray  # (w,) variances of what is on file, as in ``OnFile``
    claimed: FloatArray  # (w,)


def judged_by(before: OnFile, seen: Differences, parameters: SignatureParameters) -> OnFile:
    """Return what entries may be off by, given how far each wheelset is judged from what is on file."""
    share = 1.0
    if before.own.any():
        measured = seen.own > 0.0
        ratio = np.mean(seen.difference[measured] ** 2) / np.mean(seen.own[measured]) if measured.any() else 0.0
        share = min(1.0, float(ratio))
    return OnFile(
        conicity=before.conicity,
        own=np.sqrt(share) * before.own,
        shared=np.sqrt(1.0 - share) * before.own,
        claimed=before.claimed,
        shares=_posterior(seen, parameters) if before.claimed.any() else _NONE,
    )


def _posterior(seen: Differences, parameters: SignatureParameters) -> FloatArray:
    """Return the probabilities (k,) of the shares; large ones are not likely beforehand."""
    # a wheelset's answers on several sections have errors of their own, so that their mean is as much better
    of = seen.claimed > 0.0
    squared, claimed, answers = seen.difference[of] ** 2, seen.claimed[of], seen.answers[of]
    about = np.linspace(-3.0, 3.0, 31)
    scale = (parameters.answer_std * np.exp(parameters.answer_spread * about)) ** 2
    variance = scale[:, None, None] / answers + SHARES[:, None] * claimed
    weighed = -0.5 * np.sum(squared / variance + np.log(variance), axis=-1) - 0.5 * about[:, None] ** 2
    posterior = (1.0 - SHARES) ** parameters.reluctance * np.exp(weighed - weighed.max()).sum(axis=0)
    return np.asarray(posterior / posterior.sum())


NORMAL = float(special.ndtri(0.5 + 0.5 * COVERAGE))
FACTORS = np.exp(np.linspace(-SIGNATURE.widest_factor, SIGNATURE.widest_factor, SIGNATURE.factor_points))


@dataclass(frozen=True, slots=True)
class Reach:
    """How far left-out wheelsets were from the others: logarithms of squared distances over numbers of features."""

    mean: float
    std: float
    wheelsets: int

    @property
    def largest(self) -> float:
        """Distance from which on a signature is novel: the quantile of one more wheelset."""
        quantile = special.stdtrit(self.wheelsets - 1, SIGNATURE.novel_quantile) * np.sqrt(1.0 + 1.0 / self.wheelsets)
        return float(np.exp(self.mean + quantile * self.std))


@dataclass(frozen=True, slots=True)
class Calibration(FrozenArrays):
    """What the answers of a library need to cover, and how far from it those were."""

    weights: Annotated[FloatArray, None, len(FACTORS)]  # probabilities of shares and factors
    whole: Reach  # of all features
    roll: Reach  # of roll at short wavelengths

    def std(self, posterior: float, shared: FloatArray) -> float:
        """Return half a 95 % interval over that of a normal error."""
        each = np.hypot(FACTORS * posterior, shared[:, None])

        def beyond(reach: float) -> float:
            return float(np.sum(self.weights * (2.0 * ndtr(reach / each) - 1.0))) - COVERAGE

        return float(brentq(beyond, 0.9 * NORMAL * each.min(), 1.1 * NORMAL * each.max())) / NORMAL

    def novelty(self, distance: Likelihood) -> float:
        """Return how far a signature is, over the largest distance that is answered: of all features, or of roll."""
        # Roll over R is that of the contact angles, whatever the track: wheels of other profiles that move from side to
        # side like those of the library roll otherwise. Among all features it is lost.
        return max(distance.whole / self.whole.largest, distance.roll / self.roll.largest)


@dataclass(frozen=True, slots=True)
class _Judged:
    wheelset: int
    error: float  # less what is on file
    std: float  # of the posterior
    own: float  # variance of what is on file, whatever the share
    claimed: float  # variance of which a share is the wheelset's own
    whole: float
    roll: float
    like: bool  # whether the track is one that those who teach ran on, or like one


def calibrated(
    rows: Rows, on_file: OnFile, groups: Sequence[frozenset[str]], parameters: SignatureParameters
) -> Mapping[Basis, Calibration | Reason]:
    """Return the calibration of a library by basis, or why it has none; entries that share a group go together."""
    apart = _folds(rows, groups)
    judged = partial(_judged, rows, on_file, apart, margin=parameters.margin)
    shares = on_file.shares
    calibrations: dict[Basis, Calibration | Reason] = {
        Basis.SAME_PLACES: _of(judged(basis=Basis.SAME_PLACES), shares, parameters)
    }
    sections = len(np.unique(rows.section))
    if sections < parameters.least_sections:
        calibrations[Basis.OTHER_PLACES] = Reason(
            ReasonCode.NOT_IN_LIBRARY,
            f"the library does not have the places, and its {sections} sections do not show"
            f" how sections differ; {parameters.least_sections} are needed",
        )
    else:
        calibrations[Basis.OTHER_PLACES] = _of(judged(basis=Basis.OTHER_PLACES), shares, parameters)
    return calibrations


def differences(rows: Rows, on_file: OnFile, groups: Sequence[frozenset[str]], margin: float) -> Differences:
    """Return how far wheelsets are judged by the others from what is on file of them, on places that these have."""
    judged = list(_judged(rows, on_file, _folds(rows, groups), Basis.SAME_PLACES, margin))
    wheelset = np.unique([judgement.wheelset for judgement in judged], return_inverse=True)[1]
    answers = np.bincount(wheelset)
    error, own, claimed = (
        np.bincount(wheelset, [getattr(item, name) for item in judged]) / answers
        for name in ("error", "own", "claimed")
    )
    return Differences(error, answers.astype(np.float64), own, claimed)


def conicity_grid(conicities: FloatArray, margin: float) -> FloatArray:
    """Return the conicities (k,) that are tried."""
    low, high = max(float(conicities.min()) - 2 * margin, 0.01), float(conicities.max()) + 2 * margin
    return np.asarray(np.arange(low, high + SIGNATURE.conicity_step, SIGNATURE.conicity_step))


def _folds(rows: Rows, groups: Sequence[frozenset[str]]) -> list[BoolArray]:
    all_families = families(groups)
    family = {name: number for number, names in enumerate(all_families) for name in names}
    of_row = np.array([family[min(group)] for group in groups])
    count = min(SIGNATURE.fold_count, len(all_families))
    # families in the order of their conicity, so that every fold has all kinds
    members = np.maximum(np.bincount(of_row, minlength=len(all_families)), 1)
    means = np.bincount(of_row, rows.conicity, len(all_families)) / members
    rank = np.argsort(np.argsort(means, kind="stable"), kind="stable")[of_row]
    return [rank % count == number for number in range(count)]


def outside(answer: Likelihood, covered: tuple[float, float], margin: float) -> bool:
    """Return whether the conicity may be one that a library does not cover: then it says nothing."""
    beyond = (answer.conicity < covered[0] - margin) | (answer.conicity > covered[1] + margin)
    return float(answer.posterior[beyond].sum()) > SIGNATURE.most_outside_probability


def _judged(rows: Rows, on_file: OnFile, apart: Sequence[BoolArray], basis: Basis, margin: float) -> Iterator[_Judged]:
    """Yield how well wheelsets are judged, section by section, by those that share nothing with them."""
    # those of which nothing would be said are left out
    tasks = [task for left_out in apart for task in _tasks(rows, left_out, basis) if task[0].any() and task[1].any()]
    each = -(-SIGNATURE.most_answers // max(len(tasks), 1))
    for taught, asked in tasks:
        model = fitted(rows.chosen(np.flatnonzero(taught)))
        places = np.unique(rows.place[taught])
        ends = float(rows.conicity[taught].min()), float(rows.conicity[taught].max())
        grid = conicity_grid(rows.conicity[taught], margin)
        if basis is Basis.SAME_PLACES:
            asked = asked & np.isin(rows.place, places)  # noqa: PLW2901 - where the library has the place
        for wheelset, which in _spread(rows, asked, each):
            mine = rows.chosen(which)
            at = np.searchsorted(places, mine.place) if basis is Basis.SAME_PLACES else None
            answer = likelihood(model, mine, at, grid)
            if outside(answer, ends, margin):
                continue
            like = at is not None or not _of_other_track(model, rows, taught, mine, answer)
            error = answer.mean - float(np.mean(mine.on_file))
            own, claimed = float(np.mean(on_file.own[which])) ** 2, float(np.mean(on_file.claimed[which])) ** 2
            yield _Judged(wheelset, error, answer.std, own, claimed, answer.whole, answer.roll, like)


def _of_other_track(model: MixedModel, rows: Rows, taught: BoolArray, mine: Rows, answer: Likelihood) -> bool:
    section = rows.section[taught][np.unique(rows.place[taught], return_index=True)[1]]
    low, high = levels_between(model, section, len(np.unique(mine.place)))
    return not low <= level_of(model, mine, answer.mean) <= high


def _spread(rows: Rows, asked: BoolArray, most: int) -> Iterator[tuple[int, IntArray]]:
    at = np.flatnonzero(asked)
    pairs, which = np.unique(np.stack([rows.wheelset[at], rows.section[at]]), axis=1, return_inverse=True)
    for number in np.unique(np.linspace(0, pairs.shape[1] - 1, most).round().astype(np.int64)) if len(at) else ():
        yield int(pairs[0, number]), at[which.ravel() == number]


def _tasks(rows: Rows, left_out: BoolArray, basis: Basis) -> Iterator[tuple[BoolArray, BoolArray]]:
    if basis is Basis.SAME_PLACES:
        yield ~left_out, left_out
        return
    sections, section = np.unique(rows.section, return_inverse=True)
    count = min(SIGNATURE.fold_count, len(sections))
    for number in range(count):
        here = section % count == number
        yield ~left_out & ~here, left_out & here


def _of(judged: Iterator[_Judged], shares: FloatArray, parameters: SignatureParameters) -> Calibration | Reason:
    judgements = list(judged)
    wheelsets = len({judgement.wheelset for judgement in judgements})
    if wheelsets < 3:  # noqa: PLR2004 - a spread needs some
        return Reason(ReasonCode.LIBRARY_TOO_SMALL, "too few wheelsets of the library can be judged by the others")
    return Calibration(
        weights=_weights([judgement for judgement in judgements if judgement.like] or judgements, shares, parameters),
        whole=_reach([judgement.whole for judgement in judgements], wheelsets),
        roll=_reach([judgement.roll for judgement in judgements], wheelsets),
    )


def _reach(distances: Sequence[float], wheelsets: int) -> Reach:
    logarithms = np.log(distances)
    return Reach(float(logarithms.mean()), float(logarithms.std(ddof=1)), wheelsets)


def _weights(judgements: Sequence[_Judged], shares: FloatArray, parameters: SignatureParameters) -> FloatArray:
    """Return the probabilities (k, m) of shares and of factors on standard deviations, by those of the shares (k,)."""
    wheelset = np.unique([judgement.wheelset for judgement in judgements], return_inverse=True)[1]
    weight = 1.0 / np.bincount(wheelset)[wheelset]
    std, error, own, claimed = (
        np.array([getattr(judgement, name) for judgement in judgements]) for name in ("std", "error", "own", "claimed")
    )
    weights = np.zeros((len(shares), len(FACTORS)))
    for number in np.flatnonzero(shares):
        variance = (FACTORS[:, None] * std) ** 2 + own + SHARES[number] * claimed
        before = 0.5 * (np.log(FACTORS) / parameters.factor_std) ** 2
        weighed = -0.5 * (error**2 / variance + np.log(variance)) @ weight - before
        posterior = np.exp(weighed - weighed.max())
        weights[number] = shares[number] * posterior / posterior.sum()
    return weights
