"""Published numbers against the truth: error, z rms, half width, interval score and coverage, beside each other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bench.report import ResultTable
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Estimate
from estimation.values.units import NORMAL_95

MISS = 40.0  # weight of a miss in the interval score of 95 % intervals
AMPLITUDES: FloatArray = np.asarray(np.arange(4, 13) * 0.25e-3)  # m: 1 to 3 mm, of the conicities that are judged
COLUMNS = ("numbers", "error", "z rms", "half width", "interval score", "cover")


class Compared(NamedTuple):
    """A published number against the truth."""

    error: float
    half_width: float
    covered: bool

    @property
    def score(self) -> float:
        """Interval score: small where the interval is narrow and holds the truth."""
        return 2.0 * self.half_width + MISS * max(abs(self.error) - self.half_width, 0.0)


def compared(found: Estimate, true: float) -> Compared | None:
    """Return an estimate against the truth; None where it is not published, or nothing is true of it."""
    if found.value is None or found.low is None or found.high is None or not np.isfinite(true):
        return None
    half_width = float(0.5 * (found.high - found.low))
    return Compared(float(found.value - true), half_width, bool(found.low <= true <= found.high))


def compared_at(
    wanted: FloatArray, true: FloatArray, amplitude: FloatArray, found: Sequence[Estimate]
) -> list[Compared | None]:
    """Return estimates by amplitude (n,) against the truth (k,) at the amplitudes that are wanted (k,)."""
    places = [int(np.argmin(np.abs(amplitude - one))) for one in wanted]
    return [compared(found[place], float(truth)) for place, truth in zip(places, true, strict=True)]


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of published numbers: mean absolute error, z rms, median half width, mean interval score, coverage."""

    count: int
    error: float
    z: float
    half: float
    score: float
    cover: float

    @classmethod
    def of(cls, published: Iterable[Compared]) -> Figures:
        """Return those of all numbers together."""
        every = list(published)
        if not every:
            return cls(0, *[float("nan")] * 5)
        error, half, covered = np.array(every, dtype=np.float64).T
        z = float(np.sqrt(np.mean((NORMAL_95 * error / half) ** 2)))
        score = float(np.mean([one.score for one in every]))
        return cls(len(every), float(np.mean(np.abs(error))), z, float(np.median(half)), score, float(covered.mean()))

    @property
    def cells(self) -> tuple[str, ...]:
        """As text, for a table of the columns ``COLUMNS``."""
        if not self.count:
            return "0", "", "", "", "", ""
        figures = (f"{self.error:.4f}", f"{self.z:.2f}", f"{self.half:.4f}", f"{self.score:.4f}", f"{self.cover:.3f}")
        return str(self.count), *figures


def figures_table(title: str, groups: Iterable[tuple[str, Iterable[Compared]]]) -> ResultTable:
    """Return the figures of named groups of numbers."""
    rows = [(name, *Figures.of(published).cells) for name, published in groups]
    return ResultTable(("", *COLUMNS), rows, range(1, 7), title)
