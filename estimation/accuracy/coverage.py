"""Whether the intervals of estimates cover what was measured, and how sure a count of that is."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

from scipy.special import betaincinv

from estimation.values.intervals import NORMAL_95
from estimation.values.quantities import Estimate
from estimation.values.served import Served

_TAIL = 0.025  # on either side of a 95 % interval


def covers(estimated: Estimate, measured: Estimate) -> bool | None:
    """Return whether the 95 % interval of an estimate covers a measured value; None where either is unknown.

    The measurement errs too: the half of the interval on its side and 1.96 of its standard deviations are added as
    squares.

    Args:
        measured: With its standard deviation, of the same quantity in the same unit.
    """
    if estimated.value is None or estimated.low is None or estimated.high is None:
        return None
    if measured.value is None or measured.std is None:
        return None
    difference = measured.value - estimated.value
    half = estimated.high - estimated.value if difference > 0.0 else estimated.value - estimated.low
    return abs(difference) <= math.hypot(half, NORMAL_95 * measured.std)


@dataclass(frozen=True, slots=True)
class CoverageCount:
    """How many intervals were compared with a measurement, and how many covered it."""

    compared: Annotated[int, Served("Intervals that were compared with a measurement.")] = 0
    covered: Annotated[int, Served("Of these, the ones that cover it.")] = 0

    @staticmethod
    def of(outcomes: Iterable[bool | None]) -> CoverageCount:
        """Return the count of outcomes of :func:`covers`; those that are None are not counted."""
        known = [outcome for outcome in outcomes if outcome is not None]
        return CoverageCount(len(known), sum(known))

    @property
    def fraction(
        self,
    ) -> Annotated[float | None, Served("Share that is covered; null where nothing was compared.", "fraction_1")]:
        """Share that is covered; None where nothing was compared."""
        return self.covered / self.compared if self.compared else None

    @property
    def interval_95(self) -> tuple[float, float] | None:
        """The 95 % interval of the share after Clopper and Pearson (Biometrika 26, 1934); None without a comparison.

        Comparisons count as independent of each other.
        """
        n, k = self.compared, self.covered
        if n == 0:
            return None
        low = 0.0 if k == 0 else float(betaincinv(k, n - k + 1, _TAIL))
        high = 1.0 if k == n else float(betaincinv(k + 1, n - k, 1.0 - _TAIL))
        return low, high
