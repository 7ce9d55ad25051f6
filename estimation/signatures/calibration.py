"""How far the answers of a library were off where it did not know the wheelset, or neither wheelset nor section.

Every wheelset of the library is judged by the others, section by section. The factor that makes the intervals of these
answers cover is the larger of two: the conformal quantile of their errors over their standard deviations, each wheelset
with one weight (V. Vovk, A. Gammerman and G. Shafer, "Algorithmic Learning in a Random World", 2005), and what Student
makes of their root mean square, with as many degrees of freedom as wheelsets: the first is sure of the form of the
errors, the second of their number. Answers about one wheelset are not independent, wheelsets are; corrected for the
number of wheelsets instead of answers the first was the largest of all errors for up to 20 wheelsets.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from estimation.signatures.mixed_model import Likelihood, Rows, fitted, likelihood
from estimation.signatures.parameters import SignatureParameters
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import Basis

COVERAGE = 0.95
FOLDS = 6
GRID = 0.002  # of conicity
NOVEL = 0.999  # quantile of the distances, by their logarithms, from which on a signature is novel


@dataclass(frozen=True, slots=True)
class Calibration:
    """What the answers of a library need to cover, and how far from it those were."""

    factor: float  # half a 95 % interval over the std of the posterior
    largest_distance: float  # squared, over the number of features
    wheelsets: int
    answers: int


@dataclass(frozen=True, slots=True)
class _Judged:
    wheelset: int
    score: float  # |error| over std
    distance: float


def calibrated(
    rows: Rows, std: FloatArray, groups: Sequence[frozenset[str]], parameters: SignatureParameters
) -> Mapping[Basis, Calibration | Reason]:
    """Return the calibration of a library by basis of its answers, or why it has none.

    Parameters
    ----------
    rows
        Entries.
    std
        (n,) of the known conicities.
    groups
        Of every entry the wheelsets whose data are in it: what shares one is left out together.
    parameters
        What a library must hold.
    """
    apart = _folds(rows, groups)
    found: dict[Basis, Calibration | Reason] = {Basis.SAME_PLACES: _of(_judged(rows, std, apart, Basis.SAME_PLACES))}
    sections = len(np.unique(rows.section))
    if sections < parameters.least_sections:
        found[Basis.OTHER_PLACES] = Reason(
            ReasonCode.NOT_IN_LIBRARY,
            f"the library does not have the places, and its {sections} sections do not show"
            f" how sections differ; {parameters.least_sections} are needed",
        )
    else:
        found[Basis.OTHER_PLACES] = _of(_judged(rows, std, apart, Basis.OTHER_PLACES))
    return found


def conicity_grid(known: FloatArray, margin: float) -> FloatArray:
    """Return the conicities (k,) that are tried.

    Parameters
    ----------
    known
        (n,) of the library.
    margin
        How far beyond them an answer may be.
    """
    low, high = max(float(known.min()) - 2 * margin, 0.01), float(known.max()) + 2 * margin
    return np.asarray(np.arange(low, high + GRID, GRID))


def _folds(rows: Rows, groups: Sequence[frozenset[str]]) -> list[BoolArray]:
    """Return which rows (n,) are left out together; rows that share data are."""
    family: dict[int, frozenset[str]] = {}
    for number, group in zip(rows.wheelset, groups, strict=True):
        family[int(number)] = family.get(int(number), frozenset()) | group
    merged: list[tuple[set[int], frozenset[str]]] = []
    for number, group in sorted(family.items()):
        members, names = {number}, group
        apart = []
        for other, theirs in merged:
            if names & theirs:
                members, names = members | other, names | theirs
            else:
                apart.append((other, theirs))
        merged = [*apart, (members, names)]
    count = min(FOLDS, len(merged))
    # families in the order of their conicity, so that every fold has all kinds
    means = [float(np.mean(rows.conicity[np.isin(rows.wheelset, list(members))])) for members, _ in merged]
    order = np.argsort(means, kind="stable")
    out = [np.zeros(len(rows.wheelset), dtype=np.bool_) for _ in range(count)]
    for rank, at in enumerate(order):
        out[rank % count] |= np.isin(rows.wheelset, list(merged[at][0]))
    return out


def _judged(rows: Rows, std: FloatArray, apart: Sequence[BoolArray], basis: Basis) -> Iterator[_Judged]:
    """Yield how well wheelsets are judged, section by section, by those that share nothing with them."""
    for left_out in apart:
        for taught, asked in _tasks(rows, left_out, basis):
            if not (taught.any() and asked.any()):
                continue
            model = fitted(rows.chosen(np.flatnonzero(taught)))
            known = np.unique(rows.place[taught])
            grid = conicity_grid(rows.conicity[taught], 2 * GRID + float(np.ptp(rows.conicity)))
            for wheelset, section in np.unique(np.stack([rows.wheelset, rows.section])[:, asked], axis=1).T:
                which = asked & (rows.wheelset == wheelset) & (rows.section == section)
                at = None
                if basis is Basis.SAME_PLACES:
                    which &= np.isin(rows.place, known)
                    at = np.searchsorted(known, rows.place[which])
                if which.any():
                    mine = rows.chosen(np.flatnonzero(which))
                    found = likelihood(model, mine, at, grid)
                    yield _score(found, mine, float(np.mean(std[which])), int(wheelset))


def _tasks(rows: Rows, left_out: BoolArray, basis: Basis) -> Iterator[tuple[BoolArray, BoolArray]]:
    """Yield which rows teach and which are asked for."""
    if basis is Basis.SAME_PLACES:
        yield ~left_out, left_out
        return
    for section in np.unique(rows.section):
        here = rows.section == section
        yield ~left_out & ~here, left_out & here


def _score(found: Likelihood, rows: Rows, std: float, wheelset: int) -> _Judged:
    error = abs(found.mean - float(np.mean(rows.conicity)))
    distance = float(found.distance.min()) / rows.powers.shape[1]
    return _Judged(wheelset, error / float(np.hypot(found.std, std)), distance)


def _of(judged: Iterator[_Judged]) -> Calibration | Reason:
    found = list(judged)
    numbers, wheelset = np.unique([one.wheelset for one in found], return_inverse=True)
    if len(numbers) < 3:  # noqa: PLR2004 - a spread needs some
        return Reason(ReasonCode.LIBRARY_TOO_SMALL, "too few wheelsets of the library can be judged by the others")
    score = np.array([one.score for one in found])
    weight = 1.0 / np.bincount(wheelset)[wheelset]
    logarithm = np.log([one.distance for one in found])
    reach = stats.t.ppf(NOVEL, len(numbers) - 1) * np.sqrt(1 + 1 / len(numbers))
    return Calibration(
        factor=_factor(score, weight, len(numbers)),
        largest_distance=float(np.exp(logarithm.mean() + reach * logarithm.std(ddof=1))),
        wheelsets=len(numbers),
        answers=len(found),
    )


def _factor(score: FloatArray, weight: FloatArray, wheelsets: int) -> float:
    """Return the factor on standard deviations that covers 95 %."""
    order = np.argsort(score)
    share = np.cumsum(weight[order]) / weight.sum()
    level = COVERAGE * (1 + 1 / len(score))
    conformal = float(score[order][min(int(np.searchsorted(share, level)), len(score) - 1)])
    student = stats.t.ppf(0.5 + 0.5 * COVERAGE, wheelsets - 1) * np.sqrt(1 + 1 / wheelsets)
    return max(conformal, float(student * np.sqrt(weight @ score**2 / weight.sum())))
