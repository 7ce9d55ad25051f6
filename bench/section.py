"""The accuracy table of unknown track: ``python -m bench section [--seeds 0-19] [--rows known,unknown] ...``.

Every row is a built-in scenario; every seed of a row is simulated, ingested and estimated by the scheduled jobs
(``fleet_case``), without and with errors of the vehicle parameters.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from api.comparison.trial import recording_key
from bench.conicities import Reach, amplitude_tables, published_of
from bench.coverage import RIGHT, Coverage, Verdict, verdict_of
from bench.fleet_case import fleet_options, scored, summary_line
from bench.report import Columns, ResultTable
from bench.study import Case, Key, Study, in_processes
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import Scenario, VehicleErrors
from ingest.simulator.scenario_file import builtin_scenarios, load_scenario

LIMITS: Mapping[str, Reach | None] = {  # None: nothing may be estimated
    "known": Reach(p95=0.01),
    "unknown": Reach(p95=0.02),
    "unknown_position": Reach(p95=0.025),
    "gauge_1mm_unknown": Reach(p95=0.03),
    "gauge_2mm_known": Reach(p95=0.03),
    "gauge_2mm_unknown": Reach(p95=0.05),
    "no_information": None,
}
AT: Mapping[str, Sequence[Reach]] = {"gauge_1mm_unknown": (Reach(p95=0.010, half=0.015, at=3e-3),)}
"""What is asked at one amplitude."""

OTHERS = tuple(sorted(set(builtin_scenarios()) - set(LIMITS)))  # run where they are named
NO_INFORMATION = "no_information"
VARIANTS = {"both": (False, True), "none": (False,), "only": (True,)}
ALIGNMENT = 0.06e-3  # m SD, constant gauge
ANY = Reach()  # of another row: nothing but that its intervals cover
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
TITLE = (
    "equivalent conicity, mean absolute error over 1-3 mm; share of 95 % intervals that cover (of how many);"
    " D bins: S and A would count there too, but are not published"
)


def seed_cases(seed: int, rows: Sequence[str], drawn: bool) -> list[Case]:  # noqa: FBT001 - a task
    """Return the scores of rows for one seed, which share one simulation."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-section-") as folder:
        return [scored(row_scenario(row, seed, drawn=drawn), Path(folder)) for row in rows]


def row_scenario(row: str, seed: int, *, drawn: bool) -> Scenario:
    """Return the scenario of a row for one seed, with or without errors of the vehicle parameters."""
    scenario = with_seed(load_scenario(row), seed)
    return replace(scenario, vehicle_errors=VehicleErrors()) if drawn else scenario


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case | None]:
    tasks = [
        (seed, rows, drawn)
        for drawn in VARIANTS[options.parameter_errors]
        for seed in options.seeds
        for rows in _sharing([row for row in options.rows if _is_due(row, seed, drawn, done)], seed)
    ]
    for cases in in_processes(seed_cases, tasks, options.workers):
        yield from [None] if cases is None else cases


def _is_due(row: str, seed: int, drawn: bool, done: Collection[Key]) -> bool:  # noqa: FBT001 - part of a key
    """Return whether a row is still to do; a section without information has no variant with errors."""
    return (row, seed, drawn) not in done and not (drawn and row == NO_INFORMATION)


def _sharing(rows: Sequence[str], seed: int) -> list[list[str]]:
    groups: dict[str, list[str]] = {}
    for row in rows:
        groups.setdefault(recording_key(row_scenario(row, seed, drawn=False)), []).append(row)
    return list(groups.values())


@dataclass(frozen=True, slots=True)
class RowSummary:
    """One row of the table, with or without parameter errors."""

    row: str
    drawn: bool
    seeds: int
    median: float
    p95: float
    bias: float  # mean signed error
    coverage: Mapping[str, Sequence[tuple[int, int]]]  # kind -> (published, covered) of each fleet
    reached: Verdict  # of error, half width and coverage of the conicity
    given: float  # share of the amplitudes
    alignment: float  # m SD in the band, median over seeds; NaN where it was known
    alignment_filtered: float  # m SD, as published
    gauge: float  # m SD, of a gauge deviation that was found, median over seeds; NaN where none was
    false_estimated: int  # wheelsets or alignments that were estimated where nothing may be
    seconds: float  # median, passes to geometry

    @property
    def met(self) -> Verdict:
        """Whether what is asked of the conicity, and an alignment that is asked for, are reached."""
        if LIMITS.get(self.row, ANY) is None:
            return verdict_of(self.false_estimated == 0)
        aligned = self.row not in {"unknown", "unknown_position"} or self.alignment <= ALIGNMENT
        return Verdict.all([self.reached, verdict_of(aligned)])

    @property
    def outside(self) -> tuple[str, ...]:
        """Kinds of which it is decided that their intervals cover less or more often than they should."""
        covers = {SHORT[kind]: Coverage.of(of_fleets) for kind, of_fleets in self.coverage.items()}
        return tuple(f"{name} {100 * one.share:.1f} %" for name, one in covers.items() if one.verdict() is Verdict.NO)


def summaries(cases: Sequence[Case]) -> list[RowSummary]:
    """Return the rows in the order of the table."""
    names = [*LIMITS, *sorted({case["row"] for case in cases} - set(LIMITS))]
    groups = [
        (row, drawn, [case for case in cases if (case["row"], case["drawn"]) == (row, drawn)])
        for drawn in (False, True)
        for row in names
    ]
    return [_summary(row, drawn, of_row) for row, drawn, of_row in groups if of_row]


def _summary(row: str, drawn: bool, cases: Sequence[Case]) -> RowSummary:  # noqa: FBT001 - part of a key
    wheelsets = [item for case in cases for item in case["wheelsets"]]
    errors = [item["error"] for item in wheelsets if item["error"] is not None]
    signed = [item["signed"] for item in wheelsets if item["signed"] is not None]
    coverage = {kind: [_counted([item[kind] for item in case["wheelsets"]]) for case in cases] for kind in KINDS}
    aligned = [case["alignment"] for case in cases if case["alignment"] is not None]
    coverage["alignment"] = [(one["published"], one["covered"]) for one in aligned]
    coverage["gauge"] = [(one["gauge_published"], one["gauge_covered"]) for one in aligned]
    asked = sum(item["asked"] for item in wheelsets)
    estimated = len(errors) + sum(case["status"] == "estimated" for case in cases)
    return RowSummary(
        row=row,
        drawn=drawn,
        seeds=len(cases),
        median=_median(errors),
        p95=float(np.quantile(errors, 0.95)) if errors else math.nan,
        bias=float(np.mean(signed)) if signed else math.nan,
        coverage=coverage,
        reached=(LIMITS.get(row) or ANY).verdict(cases),
        given=sum(published for published, _ in coverage["conicity"]) / asked if asked else 0.0,
        alignment=_median([a["band"] for a in aligned]),
        alignment_filtered=_median([a["filtered"] for a in aligned]),
        gauge=_median([a["gauge"] for a in aligned if a["gauge"]]),
        false_estimated=estimated if LIMITS.get(row, ANY) is None else 0,
        seconds=_median([sum(case["cpu_s"]) for case in cases]),
    )


def _counted(counts: Sequence[Mapping[str, int]]) -> tuple[int, int]:
    return sum(one["published"] for one in counts), sum(one["covered"] for one in counts)


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else math.nan


def _reach(item: RowSummary) -> str:
    limit = LIMITS.get(item.row, ANY)
    return f"none estimated: {item.false_estimated}" if limit is None else str(limit) or "-"


def _share(of_fleets: Sequence[tuple[int, int]]) -> str:
    published, covered = (sum(column) for column in zip((0, 0), *of_fleets, strict=True))
    return f"{100 * covered / published:.1f} % ({published})" if published else "-"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


COLUMNS: Columns = {
    "row": lambda item: item.row + (" + errors" if item.drawn else ""),
    "seeds": lambda item: str(item.seeds),
    "median": lambda item: _number(item.median, 4),
    "95th": lambda item: _number(item.p95, 4),
    "reach": _reach,
    "bias": lambda item: _number(item.bias, 4),
    "given": lambda item: f"{item.given:.0%}",
    **{short: lambda item, kind=kind: _share(item.coverage[kind]) for kind, short in SHORT.items()},
    "d 3-60 m (as published)": lambda item: (
        f"{_number(1e3 * item.alignment, 3)} ({_number(1e3 * item.alignment_filtered, 3)}) mm"
    ),
    "gauge": lambda item: f"{_number(1e3 * item.gauge, 2)} mm",
    "s": lambda item: f"{item.seconds:.0f}",
    "met": lambda item: str(item.met),
    f"outside {100 * RIGHT[0]:.0f}-{100 * RIGHT[1]:.0f} %": lambda item: ", ".join(item.outside) or "-",
}


def tables(cases: Sequence[Case]) -> list[ResultTable]:
    """Return the accuracy table, and what is asked at one amplitude."""
    table = ResultTable.of(COLUMNS, [(item,) for item in summaries(cases)], range(1, 7), TITLE)
    return [table, *amplitude_tables(cases, AT)]


def _options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(rows=list(LIMITS))
    parser.add_argument("--parameter-errors", choices=VARIANTS, default="both", help="run rows without, with, or both")
    fleet_options(parser)


main = Study(
    name="section",
    title="Accuracy on simulated fleets",
    about=__doc__ or "",
    cases=_cases,
    parts=tables,
    line=summary_line,
    published=published_of,
    rows=(*LIMITS, *OTHERS),
    seeds="0-19",
    key=("row", "seed", "drawn"),
    options=_options,
    page="accuracy",
).run
