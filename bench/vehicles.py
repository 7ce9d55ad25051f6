"""Vehicles as they run: ``python -m bench vehicles [--seeds 0-2] [--rows soft_known,...] ...``.

Every row is a scenario file in ``bench/vehicle_scenarios``; every seed of it is simulated, ingested and estimated by
the scheduled jobs (``fleet_case``).
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from bench.fleet_case import Conicities, by_row, published_of, scored, summary_line
from bench.report import ResultTable, share_of
from bench.study import Case, Key, Study, in_processes
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario_file import load_scenario

SCENARIOS = Path(__file__).parent / "vehicle_scenarios"
MISMATCH = "model_mismatch"
FOUND = 0.99  # share of the wheelsets of which nothing may be published, where what is on file is wrong
FALSE_ALARMS = 0.01  # share of the wheelsets, where it is right
ROWS: Mapping[str, float | None] = {  # 95th percentile of the conicity error; None: nothing may be published
    "paper_known": 0.01,
    "soft_known": 0.01,
    "coach_known": 0.02,
    "paper_unknown": 0.02,
    "soft_unknown": 0.02,
    "coach_unknown": 0.03,
    "friction": 0.015,
    "positions_0_5_m": 0.015,
    "positions_2_m": 0.015,
    "positions_5_m": 0.015,
    "positions_20_m": 0.015,
    "cross_level": 0.03,
    "all_faults": 0.03,
    "vibration_2": 0.03,
    "vibration_5": 0.03,
    "vibration_10": 0.03,
    "gyroscopes": 0.02,
    "slow_bus": 0.01,
    "soft_parameters_drawn": 0.02,
    "flat": 0.015,
    "flat_unknown": 0.02,
    "frozen_positions": 0.015,
    "push_pull": 0.01,
    "coach_parameters_drawn": 0.02,
    "wrong_class_coach_as_paper": None,
    "wrong_radius_420_as_460": None,
    "wrong_wheelbase_2_5_as_1_8": None,
    "wrong_nodes_swapped": None,
    "wrong_frame_sensor_missing": None,
}
HEADER = (
    *("row", "seeds", "error: median / 95 %", "covers", "half width", "published", "mismatch", "reasons", "CPU s/h"),
    *("reach", "met"),
)
MOST_REASONS = 2
EXPLANATION = (
    "Mean absolute error of the equivalent conicity over 1-3 mm by wheelset; share of the 95 % intervals that cover;"
    " wheelsets of which a conicity is published; wheelsets that are `model_mismatch`; processor time of the jobs per"
    " wheelset-hour recorded."
)


def run_case(row: str, seed: int, keep: Path | None) -> Case:
    """Return the score of a row for one seed."""
    return scored(with_seed(load_scenario(SCENARIOS / f"{row}.toml"), seed), keep)


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case | None]:
    tasks = [(row, seed) for seed in options.seeds for row in options.rows if (row, seed) not in done]
    yield from in_processes(partial(run_case, keep=options.keep), tasks)


@dataclass(frozen=True, slots=True)
class Counted:
    """Wheelsets of some cases: in all, published, published with a doubt beside, and not of their class."""

    wheelsets: int
    published: int
    doubted: int
    mismatch: int

    @classmethod
    def of(cls, cases: Sequence[Case]) -> Counted:
        """Count them."""
        verdicts = [verdict for case in cases for verdict in case["verdicts"]]
        return cls(
            len(verdicts),
            sum(verdict["published"] for verdict in verdicts),
            sum(verdict["published"] and bool(verdict["code"]) for verdict in verdicts),
            sum(verdict["status"] == MISMATCH for verdict in verdicts),
        )

    @property
    def kept_back(self) -> float:
        """Share of the wheelsets of which no conicity is published as good: without a doubt beside it."""
        return 1.0 - (self.published - self.doubted) / self.wheelsets

    @property
    def mismatch_share(self) -> float:
        """Share of the wheelsets of which the status is that of a model that does not fit."""
        return self.mismatch / self.wheelsets


def summary_rows(cases: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return a line for each row that was run."""
    return [_summary(name, of_row) for name, of_row in by_row(cases, ROWS).items()]


def _summary(name: str, cases: Sequence[Case]) -> tuple[str, ...]:
    figures, counted, limit = Conicities.of(cases), Counted.of(cases), ROWS[name]
    cpu = sum(sum(case["cpu_s"]) for case in cases) / sum(case["wheelset_hours"] for case in cases)
    met = counted.kept_back >= FOUND
    if limit is not None:
        met = figures.p95 <= limit and figures.covers() and counted.mismatch_share <= FALSE_ALARMS
    return (
        name,
        str(len(cases)),
        figures.error,
        share_of(figures.covered, figures.published),
        figures.width,
        f"{counted.published} of {counted.wheelsets}",
        f"{counted.mismatch} of {counted.wheelsets}",
        _reasons(cases),
        f"{cpu:.1f}",
        "none" if limit is None else f"{limit:g}",
        "yes" if met else "NO",
    )


def _reasons(cases: Sequence[Case]) -> str:
    codes = Counter(verdict["code"] for case in cases for verdict in case["verdicts"] if verdict["code"])
    if not (codes or Counted.of(cases).published):  # nothing was refused: there is no alignment
        return ", ".join(sorted({case["survey"] for case in cases if case["survey"]}))
    return ", ".join(f"{code} {count}" for code, count in codes.most_common(MOST_REASONS))


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--keep", type=Path, default=None, help="folder that keeps recordings (130 MB each)")


main = Study(
    name="vehicles",
    title="Vehicles as they run",
    about=__doc__ or "",
    cases=_cases,
    parts=lambda cases: [EXPLANATION, ResultTable(HEADER, summary_rows(cases), range(1, 7))],
    line=summary_line,
    published=published_of,
    rows=ROWS,
    options=_options,
).run
