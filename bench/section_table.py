"""The accuracy table: rows summed over seeds and wheelsets, against the numbers to reach."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

LIMITS: Mapping[str, float | None] = {  # 95th percentile of the conicity error; None: nothing may be estimated
    "known": 0.01,
    "unknown": 0.02,
    "unknown_position": 0.025,
    "gauge_1mm_unknown": 0.03,
    "gauge_2mm_known": 0.03,
    "gauge_2mm_unknown": 0.05,
    "no_information": None,
}
COVERAGE = (0.92, 0.98)
ALIGNMENT = 0.06e-3  # m SD, constant gauge
LEAST_INTERVALS = 100  # before a share of them is judged


@dataclass(frozen=True, slots=True)
class RowSummary:
    """One row of the table, with or without parameter errors."""

    row: str
    drawn: bool
    seeds: int
    wheelsets: int
    estimated: int  # wheelsets with a conicity
    median: float
    p95: float
    bias: float  # mean signed error
    coverage: Mapping[str, tuple[int, int]]  # kind -> (published, covered)
    given: float  # share of the amplitudes
    alignment: float  # m SD in the band, median over seeds; NaN where it was known
    alignment_filtered: float  # m SD, as published
    gauge: float  # m SD, of a gauge deviation that was found, median over seeds; NaN where none was
    false_estimated: int  # wheelsets or alignments that were estimated where nothing may be
    seconds: float  # median, passes to geometry

    @property
    def met(self) -> bool:
        """Whether the row reaches its numbers: the error, how often intervals of conicity cover, the alignment.

        The alignment where it is asked for; how often other intervals cover is not asked for, see :attr:`outside`.
        """
        limit = LIMITS.get(self.row, math.inf)  # nothing was asked of another row's error
        if limit is None:
            return self.false_estimated == 0
        published, covered = self.coverage["conicity"]
        covers = published > 0 and COVERAGE[0] <= covered / published <= COVERAGE[1]
        aligned = self.row not in {"unknown", "unknown_position"} or self.alignment <= ALIGNMENT
        return self.p95 <= limit and covers and aligned

    @property
    def outside(self) -> tuple[str, ...]:
        """The kinds of numbers whose intervals cover less or more often than in ``COVERAGE``, with their share.

        Kinds of fewer than ``LEAST_INTERVALS`` intervals are left out.
        """
        shares = {
            SHORT[kind]: covered / published
            for kind, (published, covered) in self.coverage.items()
            if published >= LEAST_INTERVALS
        }
        return tuple(
            f"{name} {100 * share:.1f} %" for name, share in shares.items() if not COVERAGE[0] <= share <= COVERAGE[1]
        )


KINDS = ("conicity", "difference", "other_bins", "nonlinearity", "zero_crossing")  # of what a wheelset publishes
SHORT: Mapping[str, str] = {
    "conicity": "conicity",
    "difference": "R bins",
    "other_bins": "D bins",  # S and A are counted with it; by the criterion of estimation.geometry none is published
    "nonlinearity": "NP",
    "zero_crossing": "zero",
    "alignment": "alignment",
    "gauge": "gauge found",  # no number is asked for it
}


def summaries(cases: Sequence[Mapping[str, Any]]) -> list[RowSummary]:
    """Return the rows in the order of the table."""
    names = [*LIMITS, *sorted({case["row"] for case in cases} - set(LIMITS))]
    keys = [(row, drawn) for drawn in (False, True) for row in names]
    found = []
    for row, drawn in keys:
        mine = [case for case in cases if (case["row"], case["drawn"]) == (row, drawn)]
        if mine:
            found.append(_summary(row, drawn, mine))
    return found


def _summary(row: str, drawn: bool, cases: Sequence[Mapping[str, Any]]) -> RowSummary:  # noqa: FBT001 - part of a key
    wheelsets = [item for case in cases for item in case["wheelsets"]]
    errors = [item["error"] for item in wheelsets if item["error"] is not None]
    signed = [item["signed"] for item in wheelsets if item["signed"] is not None]
    coverage = {
        kind: (sum(item[kind]["published"] for item in wheelsets), sum(item[kind]["covered"] for item in wheelsets))
        for kind in KINDS
    }
    aligned = [case["alignment"] for case in cases if case["alignment"] is not None]
    coverage["alignment"] = (sum(a["published"] for a in aligned), sum(a["covered"] for a in aligned))
    gauges = [(a.get("gauge_published", 0), a.get("gauge_covered", 0)) for a in aligned]  # older results lack it
    coverage["gauge"] = (sum(published for published, _ in gauges), sum(covered for _, covered in gauges))
    asked = sum(len(item["amplitudes"]) for item in wheelsets)
    estimated = len(errors) + sum(case["status"] == "estimated" for case in cases)
    return RowSummary(
        row=row,
        drawn=drawn,
        seeds=len(cases),
        wheelsets=len(wheelsets),
        estimated=len(errors),
        median=float(np.median(errors)) if errors else math.nan,
        p95=float(np.quantile(errors, 0.95)) if errors else math.nan,
        bias=float(np.mean(signed)) if signed else math.nan,
        coverage=coverage,
        given=coverage["conicity"][0] / asked if asked else 0.0,
        alignment=float(np.median([a["band"] for a in aligned])) if aligned else math.nan,
        alignment_filtered=float(np.median([a["filtered"] for a in aligned])) if aligned else math.nan,
        gauge=float(np.median(found)) if (found := [a["gauge"] for a in aligned if a.get("gauge")]) else math.nan,
        false_estimated=estimated if LIMITS.get(row, 1.0) is None else 0,
        seconds=float(np.median([sum(case["seconds"]) for case in cases])),
    )


SUMMARY_HEADER = (
    "row", "seeds", "median", "95th", "reach", "bias", "given", *SHORT.values(), "d 3-60 m (as published)",
    "gauge", "s", "met", f"outside {100 * COVERAGE[0]:.0f}-{100 * COVERAGE[1]:.0f} %",
)  # fmt: skip
SUMMARY_TITLE = (
    "equivalent conicity, mean absolute error over 1-3 mm; share of 95 % intervals that cover (of how many);"
    " D bins: S and A would count there too, but are not published"
)
SCALING_HEADER = (
    "passes", "alignment s", "windows s", "geometry s", "total s", "s per pass", "peak MiB", "of these at start"
)  # fmt: skip
SCALING_TITLE = "12 km, one core: processor time and memory of the jobs"


def summary_rows(cases: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return the cells of the accuracy table, in the order of ``SUMMARY_HEADER``."""
    return [
        (
            item.row + (" + errors" if item.drawn else ""),
            str(item.seeds),
            _number(item.median, 4),
            _number(item.p95, 4),
            _reach(item),
            _number(item.bias, 4),
            f"{item.given:.0%}",
            *(_share(item.coverage[kind]) for kind in SHORT),
            f"{_number(1e3 * item.alignment, 3)} ({_number(1e3 * item.alignment_filtered, 3)}) mm",
            f"{_number(1e3 * item.gauge, 2)} mm",
            f"{item.seconds:.0f}",
            "yes" if item.met else "NO",
            ", ".join(item.outside) or "-",
        )
        for item in summaries(cases)
    ]


def summary_table(cases: Sequence[Mapping[str, Any]]) -> Table:
    """Return the accuracy table for a terminal."""
    return _table(SUMMARY_HEADER, SUMMARY_TITLE, summary_rows(cases))


def _reach(item: RowSummary) -> str:
    if item.row not in LIMITS:
        return "-"
    limit = LIMITS[item.row]
    return f"{limit:g}" if limit is not None else f"none estimated: {item.false_estimated}"


def scaling_rows(sizes: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return the cells of time and memory by number of passes, in the order of ``SCALING_HEADER``."""
    return [
        (
            str(size["passes"]),
            *(f"{value:.1f}" for value in size["parts"]),
            f"{size['seconds']:.1f}",
            f"{size['seconds'] / size['passes']:.2f}",
            f"{size['peak_mib']:.0f}",
            f"{size['base_mib']:.0f}",
        )
        for size in sizes
    ]


def scaling_table(sizes: Sequence[Mapping[str, Any]]) -> Table:
    """Return time and memory by number of passes, for a terminal."""
    return _table(SCALING_HEADER, SCALING_TITLE, scaling_rows(sizes))


def _table(header: Sequence[str], title: str, rows: Sequence[Sequence[str]]) -> Table:
    table = Table(*header, title=title, title_justify="left")
    for cells in rows:
        table.add_row(*cells)
    return table


def _share(count: tuple[int, int]) -> str:
    published, covered = count
    if not published:
        return "-"
    shown = f"{100 * covered / published:.1f} %" if published >= LEAST_INTERVALS else f"{covered}/{published}"
    return f"{shown} ({published})" if published >= LEAST_INTERVALS else shown


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
