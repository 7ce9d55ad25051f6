"""How often intervals hold the truth, with an interval of that share, and whether it is decided that it is right.

Numbers of one fleet go wrong together: conicities of one wheelset at nine amplitudes, and what a section has in common.
So numbers come in clusters, of which nothing is shared with others. Within a cluster they hold the truth with a chance
of its own, which is beta distributed about the share that is looked for, with a correlation that is not known either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.special import betaln

RIGHT = (0.92, 0.98)  # of 95 % intervals
TOLERATED = (0.90, 0.99)  # within which the whole interval of a share counts as right
NODES = 200  # of the share
CORRELATIONS = 30  # nodes of the correlation
TAIL = 0.05  # on either side: 90 % intervals, so that both bounds of an equivalence are tested at 5 %


class Verdict(StrEnum):
    """Whether something is reached, as the cell of the column "met"."""

    YES = "yes"
    NO = "NO"
    OPEN = "not decided"

    @classmethod
    def all(cls, verdicts: Sequence[Verdict]) -> Verdict:
        """Return that of all together: one that falls short decides."""
        if cls.NO in verdicts:
            return cls.NO
        return cls.OPEN if cls.OPEN in verdicts else cls.YES


def verdict_of(met: bool) -> Verdict:  # noqa: FBT001 - the cell of a column
    """Return the verdict of what is decided."""
    return Verdict.YES if met else Verdict.NO


@dataclass(frozen=True, slots=True)
class Coverage:
    """Share of intervals that hold the truth, and the 90 % interval of that share; NaN without any."""

    share: float
    low: float
    high: float

    @classmethod
    def of(cls, clusters: Sequence[tuple[int, int]]) -> Coverage:
        """Return the coverage of clusters of numbers, each with how many there are and how many are held.

        The interval is of the posterior, for a share that may be anything (Jeffreys) and a correlation that is rather
        small. One cluster, or clusters that hold all, say little of the correlation: then it is wide. Of simulated fleets of 8 wheelsets at 9
        amplitudes it holds the true share in 83 to 96 %, however their errors are shared.
        """
        counted = np.array([one for one in clusters if one[0]], dtype=np.float64).reshape(-1, 2)
        if not len(counted):
            return cls(*[float("nan")] * 3)
        alike, times = np.unique(counted, axis=0, return_counts=True)
        number, held = alike.T[:, :, np.newaxis, np.newaxis]
        # nodes of the share by the arcsine, in which the prior is even and its ends are fine
        share = (np.sin(0.5 * np.pi * (np.arange(NODES) + 0.5) / NODES) ** 2)[:, np.newaxis]
        correlation = (np.arange(CORRELATIONS) + 0.5) ** 2 / CORRELATIONS**2
        # falls evenly to none at 1: of an even one it would take 50 fleets that hold all to show that this is too wide
        prior = (1.0 - correlation) * np.sqrt(correlation)
        total = (1.0 - correlation) / correlation
        a, b = share * total, (1.0 - share) * total
        log = np.tensordot(times, betaln(a + held, b + number - held) - betaln(a, b), 1)
        weight = (np.exp(log - log.max()) * prior).sum(axis=1)
        below = np.cumsum(weight) - 0.5 * weight
        low, high = np.interp([TAIL, 1.0 - TAIL], below / weight.sum(), share[:, 0])
        whole = float(counted[:, 1].sum() / counted[:, 0].sum())
        return cls(whole, float(min(low, whole)), float(max(high, whole)))

    def verdict(self, right: tuple[float, float] = RIGHT, tolerated: tuple[float, float] = TOLERATED) -> Verdict:
        """Return whether the share is right, as a decision of equivalence.

        "NO" where its interval has nothing in common with ``right``; "yes" where the whole interval is within
        ``tolerated``, which is a little wider, since a share at the very bound could never be decided else; else it is
        not decided, however near the share itself is: more fleets decide it.
        """
        if np.isnan(self.share):
            return Verdict.OPEN
        if self.high < right[0] or self.low > right[1]:
            return Verdict.NO
        return Verdict.YES if tolerated[0] <= self.low and self.high <= tolerated[1] else Verdict.OPEN

    def __str__(self) -> str:
        """Return share and interval as a cell."""
        return "" if np.isnan(self.share) else f"{self.share:.3f} [{self.low:.3f}, {self.high:.3f}]"
