"""Vehicles as they run: ``python -m bench vehicles [--seeds 0-2] [--rows soft_known,...] ...``.

Every row is a scenario file in ``bench/vehicle_scenarios``; every seed of it is simulated, ingested and estimated by
the scheduled jobs (``fleet_case``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.fleet_case import Conicities, by_row, cases_of, fleet_options, published_of, scored, summary_line
from bench.report import Columns, ResultTable, yes_or_no
from bench.study import Case, Study
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
MOST_REASONS = 2
EXPLANATION = (
    "Mean absolute error of the equivalent conicity over 1-3 mm by wheelset; share of the 95 % intervals that cover;"
    " wheelsets of which a conicity is published; wheelsets that are `model_mismatch`; processor time of the jobs per"
    " wheelset-hour recorded."
)


def run_case(row: str, seed: int) -> Case:
    """Return the score of a row for one seed."""
    return scored(with_seed(load_scenario(SCENARIOS / f"{row}.toml"), seed))


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


def _met(name: str, cases: Sequence[Case]) -> bool:
    figures, counted, limit = Conicities.of(cases), Counted.of(cases), ROWS[name]
    if limit is None:
        return counted.kept_back >= FOUND
    return figures.p95 <= limit and figures.covers() and counted.mismatch_share <= FALSE_ALARMS


def _cpu(cases: Sequence[Case]) -> float:
    return sum(sum(case["cpu_s"]) for case in cases) / sum(case["wheelset_hours"] for case in cases)


def _reasons(cases: Sequence[Case]) -> str:
    codes = Counter(verdict["code"] for case in cases for verdict in case["verdicts"] if verdict["code"])
    if not (codes or Counted.of(cases).published):  # nothing was refused: there is no alignment
        return ", ".join(sorted({case["survey"] for case in cases if case["survey"]}))
    return ", ".join(f"{code} {count}" for code, count in codes.most_common(MOST_REASONS))


COLUMNS: Columns = {
    "row": lambda name, _: name,
    "seeds": lambda _, cases: str(len(cases)),
    "error: median / 95 %": lambda _, cases: Conicities.of(cases).error,
    "covers": lambda _, cases: Conicities.of(cases).cover,
    "half width": lambda _, cases: Conicities.of(cases).width,
    "published": lambda _, cases: "{0.published} of {0.wheelsets}".format(Counted.of(cases)),
    "mismatch": lambda _, cases: "{0.mismatch} of {0.wheelsets}".format(Counted.of(cases)),
    "reasons": lambda _, cases: _reasons(cases),
    "CPU s/h": lambda _, cases: f"{_cpu(cases):.1f}",
    "reach": lambda name, _: "none" if ROWS[name] is None else f"{ROWS[name]:g}",
    "met": lambda name, cases: yes_or_no(_met(name, cases)),
}


def table(cases: Sequence[Case]) -> ResultTable:
    """Return a line for each row that was run."""
    return ResultTable.of(COLUMNS, by_row(cases, ROWS).items(), range(1, 7))


main = Study(
    name="vehicles",
    title="Vehicles as they run",
    about=__doc__ or "",
    cases=lambda options, done: cases_of(run_case, options, done, options.rows),
    parts=lambda cases: [EXPLANATION, table(cases)],
    line=summary_line,
    published=published_of,
    rows=ROWS,
    options=fleet_options,
).run
