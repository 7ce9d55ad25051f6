"""Published numbers against the truth: error, z rms, mean z, half width, interval score, coverage and what is withheld.

Every bench that judges an accuracy has these columns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bench.coverage import Coverage
from bench.report import ResultTable
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Estimate
from estimation.values.units import NORMAL_95

MISS = 40.0  # weight of a miss in the interval score of 95 % intervals
AMPLITUDES: FloatArray = np.asarray(np.arange(4, 13) * 0.25e-3)  # m: 1 to 3 mm, of the conicities that are judged
COLUMNS = ("numbers", "error", "z rms", "mean z", "half width", "interval score", "cover", "withheld")
MOST_CODES = 2


class Compared(NamedTuple):
    """A published number against the truth."""

    error: float
    half_width: float
    covered: bool

    @property
    def score(self) -> float:
        """Interval score: small where the interval is narrow and holds the truth."""
        return 2.0 * self.half_width + MISS * max(abs(self.error) - self.half_width, 0.0)


@dataclass(frozen=True, slots=True)
class Cluster:
    """Numbers that share their errors with no others: of one fleet on its section, or of one wheelset alone.

    Attributes:
        published: Against the truth.
        withheld: Code of every number that is not published.
    """

    published: Sequence[Compared]
    withheld: Sequence[str] = ()

    @classmethod
    def read(cls, published: Iterable[Sequence[float]], withheld: Sequence[str] = ()) -> Cluster:
        """Return them as they are kept in a case."""
        return cls([Compared(error, half, bool(covered)) for error, half, covered in published], withheld)


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


def withheld_at(wanted: FloatArray, amplitude: FloatArray, found: Sequence[Estimate]) -> list[str]:
    """Return why estimates by amplitude (n,) are withheld at those that are wanted (k,); empty where published."""
    estimates = [found[int(np.argmin(np.abs(amplitude - one)))] for one in wanted]
    return [code_of(one) if one.value is None else "" for one in estimates]


def code_of(withheld: Estimate) -> str:
    """Return why an estimate is not published: the code of its reason, else its status."""
    return str(withheld.status if withheld.reason is None else withheld.reason.code)


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of published numbers, and how many were withheld.

    Mean absolute error, z rms, mean z, median half width, mean interval score; z is error over standard deviation.
    """

    count: int
    error: float
    z: float
    mean_z: float
    half: float
    score: float
    cover: Coverage
    withheld: Counter[str]

    @classmethod
    def of(cls, clusters: Iterable[Cluster]) -> Figures:
        """Return those of all numbers together; those of different clusters share no error."""
        judged = list(clusters)
        every = [number for of_cluster in judged for number in of_cluster.published]
        withheld = Counter(code for of_cluster in judged for code in of_cluster.withheld)
        cover = Coverage.of([(len(one.published), sum(n.covered for n in one.published)) for one in judged])
        if not every:
            return cls(0, *[float("nan")] * 5, cover, withheld)
        error, half, _ = np.array(every, dtype=np.float64).T
        z = NORMAL_95 * error / half
        return cls(
            count=len(every),
            error=float(np.mean(np.abs(error))),
            z=float(np.sqrt(np.mean(z**2))),
            mean_z=float(np.mean(z)),
            half=float(np.median(half)),
            score=float(np.mean([number.score for number in every])),
            cover=cover,
            withheld=withheld,
        )

    @property
    def cells(self) -> tuple[str, ...]:
        """As text, for a table of the columns ``COLUMNS``."""
        if not self.count:
            return "0", "", "", "", "", "", "", self.kept_back
        numbers = (f"{self.error:.4f}", f"{self.z:.2f}", f"{self.mean_z:+.2f}", f"{self.half:.4f}", f"{self.score:.4f}")
        return str(self.count), *numbers, str(self.cover), self.kept_back

    @property
    def kept_back(self) -> str:
        """Share of the numbers that is withheld, with its most frequent codes; empty where none is."""
        count = self.withheld.total()
        if not count:
            return ""
        whole = self.count + count
        parts = [f"{number / whole:.0%} {code}".strip() for code, number in self.withheld.most_common(MOST_CODES)]
        return f"{count / whole:.0%}: {', '.join(parts)}".replace("%", " %")


def figures_table(title: str, groups: Iterable[tuple[str, Iterable[Cluster]]]) -> ResultTable:
    """Return the figures of named groups of numbers."""
    rows = [(name, *Figures.of(clusters).cells) for name, clusters in groups]
    return ResultTable(("", *COLUMNS), rows, range(1, 7), title)
