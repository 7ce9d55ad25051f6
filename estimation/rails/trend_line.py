"""The trend of a section's rails: a line through its periods, and whether they are on one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from estimation.values.arrays import FloatArray
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode

PARAMETERS = 2  # of a line
DOUBT = 0.99  # share of lines whose periods are nearer to it


@dataclass(frozen=True, slots=True)
class TrendAt:
    """The trend of a section at one amplitude, 1/year, or why there is none."""

    per_year: Estimate
    periods: int = 0

    @staticmethod
    def unknown(reason: Reason) -> TrendAt:
        """Return that there is none, with the reason."""
        return TrendAt(Estimate.unknown(reason))


@dataclass(frozen=True, slots=True)
class Line:
    """A line through correlated values."""

    slope: float
    std: float  # of the slope
    squares: float  # weighted, of what is left
    freedom: int  # how many are left

    def fits(self, groups: float) -> bool:
        """Whether the values are on a line, as far as their errors say.

        Args:
            groups: Degrees of freedom behind the scale of the errors.
        """
        if self.freedom < 1:
            return True
        return self.squares <= self.freedom * float(fdtri(self.freedom, max(groups, 1.0), DOUBT))


def line(at: FloatArray, value: FloatArray, covariance: FloatArray) -> Line:
    """Return the line through correlated values."""
    columns = np.column_stack([np.ones(len(at)), at - at.mean()])
    weighted = np.linalg.solve(covariance, columns)
    matrix = columns.T @ weighted
    found = np.linalg.solve(matrix, weighted.T @ value)
    left = value - columns @ found
    squares = float(left @ np.linalg.solve(covariance, left))
    return Line(float(found[1]), float(np.sqrt(np.linalg.inv(matrix)[1, 1])), squares, len(at) - PARAMETERS)


def not_a_line(periods: int) -> TrendAt:
    """Return that the periods of a section are not on a line."""
    text = f"the excess of {periods} periods is not on a line: the rails were ground or replaced, or wear unevenly"
    return TrendAt.unknown(Reason(ReasonCode.TREND_NOT_A_LINE, text))


def too_few(periods: int, least: int) -> TrendAt:
    """Return that a section has too few periods."""
    text = f"{periods} period{'s' * (periods != 1)} of the section {'are' if periods != 1 else 'is'} known, "
    return TrendAt.unknown(Reason(ReasonCode.TOO_FEW_PERIODS, f"{text}{least} are needed"))


AS_ON_FILE = TrendAt.unknown(
    Reason(ReasonCode.RAILS_ARE_REFERENCE, "the section is named as known: nothing is measured of its rails")
)
