"""What the conicities on file may be off by: each wheelset's own errors, and errors in common.

Errors of measured profiles are each wheelset's own as far as the differences of the library hold them. Those of
geometries rest on one class, one survey and one set of filters; some of their variance is the wheelset's own. How much
has a posterior: differences from the answers are the errors of these, whose standard deviation is not known either,
and the own errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.signatures import ConicitySource, LibraryEntry

SHARES: FloatArray = np.asarray(np.linspace(0.0, 1.0, 21))  # of the variances of geometries, that are tried
ANSWER_STD = 0.006  # of an answer about one wheelset on one section, before any is seen
ANSWER_SPREAD = 0.3  # std of its logarithm
RELUCTANCE = 3  # power of what is in common, by which shares are less likely beforehand
NEAR = 0.03  # of conicity, within which what is on file counts for an answer
_NONE = np.eye(len(SHARES))[0]  # no share of anything


@dataclass(frozen=True, slots=True)
class OnFile:
    """Standard deviations of the conicities of some entries."""

    conicity: FloatArray  # (n,)
    own: FloatArray  # (n,) of errors that are each wheelset's own
    shared: FloatArray  # (n,) of errors in common
    claimed: FloatArray  # (n,) of errors of which a share of the variance is each wheelset's own
    shares: FloatArray  # (k,) probabilities of ``SHARES``

    def __post_init__(self) -> None:
        n = len(self.conicity)
        for name in ("conicity", "own", "shared", "claimed"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))
        object.__setattr__(self, "shares", frozen_array(self.shares, (len(SHARES),), name="shares"))

    @property
    def alone(self) -> FloatArray:
        """Std (n,) of all errors that are each wheelset's own, with the share that is expected."""
        return np.asarray(np.hypot(self.own, np.sqrt(float(self.shares @ SHARES)) * self.claimed))

    def shared_std(self, conicity: float) -> FloatArray:
        """Return the std (k,) of what is off in common about a conicity, by share.

        Errors in common add up as they are, not as squares: it is a mean of standard deviations, of all entries or of
        those near by, whichever is larger.
        """
        each = self.shared[:, None] + np.sqrt(1.0 - SHARES) * self.claimed[:, None]
        near = np.exp(-0.5 * ((self.conicity - conicity) / NEAR) ** 2) + np.finfo(np.float64).tiny
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


def judged_by(before: OnFile, seen: Differences) -> OnFile:
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
        shares=_posterior(seen) if before.claimed.any() else _NONE,
    )


def _posterior(seen: Differences) -> FloatArray:
    """Return the probabilities (k,) of the shares; large ones are not likely beforehand.

    A wheelset's answers on several sections have errors of their own, so that their mean is as much better.
    """
    of = seen.claimed > 0.0
    squared, claimed, answers = seen.difference[of] ** 2, seen.claimed[of], seen.answers[of]
    about = np.linspace(-3.0, 3.0, 31)
    scale = (ANSWER_STD * np.exp(ANSWER_SPREAD * about)) ** 2
    variance = scale[:, None, None] / answers + SHARES[:, None] * claimed
    weighed = -0.5 * np.sum(squared / variance + np.log(variance), axis=-1) - 0.5 * about[:, None] ** 2
    posterior = (1.0 - SHARES) ** RELUCTANCE * np.exp(weighed - weighed.max()).sum(axis=0)
    return np.asarray(posterior / posterior.sum())
