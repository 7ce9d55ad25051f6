"""Conicities of simulated fleets against the truth: their figures by row, and what rows have to reach."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.coverage import RIGHT, TOLERATED, Verdict, verdict_of
from bench.report import ResultTable
from bench.scores import AMPLITUDES, COLUMNS, Cluster, Figures

Case = Mapping[str, Any]
"""As ``fleet_case.score`` returns it."""


@dataclass(frozen=True, slots=True)
class Conicities:
    """Errors of the conicity by wheelset, and the figures of all numbers."""

    errors: list[float]
    figures: Figures

    @classmethod
    def of(cls, cases: Sequence[Case], at: float | None = None) -> Conicities:
        """Return those of all cases together, at one amplitude (m) or at all."""
        clusters = [published_of(case, at) for case in cases]
        errors = [error for case in cases for item in case["wheelsets"] if (error := _error(item, at)) is not None]
        return cls(errors, Figures.of(clusters))

    @property
    def published(self) -> int:
        """How many numbers are published."""
        return self.figures.count

    @property
    def p95(self) -> float:
        """95th percentile of the errors; NaN without any."""
        return float(np.percentile(self.errors, 95)) if self.errors else float("nan")

    @property
    def error(self) -> str:
        """Median and 95th percentile of the errors in words."""
        return f"{np.median(self.errors):.4f} / {self.p95:.4f}" if self.errors else "none"

    @property
    def cover(self) -> str:
        """Share of the intervals that cover, with its interval."""
        return str(self.figures.cover)

    @property
    def width(self) -> str:
        """Median half width in words."""
        return f"{self.figures.half:.4f}" if self.published else ""


def amplitude_tables(cases: Sequence[Case], wanted: Mapping[str, Sequence[Reach]]) -> list[ResultTable]:
    """Return the table of what rows have to reach at single amplitudes; none where no such row was run."""
    lines = []
    for name, of_row in by_row(cases, wanted).items():
        for reach in wanted[name]:
            found, met = Conicities.of(of_row, reach.at), str(reach.verdict(of_row))
            lines.append((name, f"{1e3 * (reach.at or 0.0):g}", found.error, *found.figures.cells, str(reach), met))
    header = ("row", "mm", "error: median / 95 %", *COLUMNS, "reach", "met")
    return [ResultTable(header, lines, range(1, 9), "At one amplitude")] if lines else []


def _error(item: Mapping[str, Any], at: float | None) -> float | None:
    """Return the mean absolute error of a wheelset over its amplitudes, or that at one of them (m)."""
    if at is None:
        return None if item["error"] is None else float(item["error"])
    number = item["compared"][_place(at)]
    return None if number is None else abs(float(number[0]))


def _place(at: float) -> int:
    return int(np.argmin(np.abs(AMPLITUDES - at)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """What the conicities of a row have to reach; None: nothing is asked.

    Attributes:
        p95: 95th percentile of the error by wheelset.
        half: Median half width.
        at: Amplitude (m) of which this is; None: of all.
        covers_above: Too wide is right as well: the passes hardly say anything.
    """

    p95: float | None = None
    half: float | None = None
    at: float | None = None
    covers_above: bool = False

    def verdict(self, cases: Sequence[Case]) -> Verdict:
        """Return whether error and half width are reached and the coverage is decided to be right."""
        found = Conicities.of(cases, self.at)
        if not found.published:
            return verdict_of(self.covers_above)
        highest = (1.0, 1.0) if self.covers_above else (RIGHT[1], TOLERATED[1])
        return Verdict.all(
            [
                found.figures.cover.verdict((RIGHT[0], highest[0]), (TOLERATED[0], highest[1])),
                verdict_of(self.p95 is None or found.p95 <= self.p95),
                verdict_of(self.half is None or found.figures.half <= self.half),
            ]
        )

    def __str__(self) -> str:
        """Return it as a cell."""
        asked = [] if self.p95 is None else [f"{self.p95:g}"]
        asked += [] if self.half is None else [f"+-{self.half:g}"]
        return ", ".join(asked)


def by_row(cases: Sequence[Case], rows: Sequence[str] | Mapping[str, Any]) -> dict[str, list[Case]]:
    """Return the cases of each row that was run."""
    groups = {name: [case for case in cases if case["row"] == name] for name in rows}
    return {name: of_row for name, of_row in groups.items() if of_row}


def published_of(case: Case, at: float | None = None) -> Cluster:
    """Return the conicities of a case, at one amplitude (m) or at all: a fleet on its section shares its errors."""
    numbers = [number for item in case["wheelsets"] for number in _at(item["compared"], at) if number is not None]
    asked = len(AMPLITUDES) if at is None else 1
    estimated = {item["serial"] for item in case["wheelsets"]}
    refused = [verdict["code"] for verdict in case["verdicts"] if verdict["serial"] not in estimated]
    codes = [code for code in refused for _ in range(asked)]
    codes += [code for item in case["wheelsets"] for code in _at(item["withheld"], at) if code]
    return Cluster.read(numbers, codes)


def _at(by_amplitude: Sequence[Any], at: float | None) -> Sequence[Any]:
    return by_amplitude if at is None else [by_amplitude[_place(at)]]
