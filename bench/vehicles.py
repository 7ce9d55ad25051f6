"""Vehicles as they run: ``python -m bench vehicles [--seeds 0-2] [--rows soft_known,...] ...``.

Every row is a scenario file in ``bench/vehicle_scenarios``; every seed of it is simulated, ingested and estimated by
the scheduled jobs (``fleet_case``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.conicities import Conicities, Reach, amplitude_tables, by_row, published_of
from bench.coverage import Verdict, verdict_of
from bench.fleet_case import cases_of, fleet_options, scored, summary_line
from bench.made_scenario import changed_scenario
from bench.report import Columns, ResultTable
from bench.study import Case, Study
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import Scenario

SCENARIOS = Path(__file__).parent / "vehicle_scenarios"
MISMATCH = "model_mismatch"
FOUND = 0.99  # share of the wheelsets of which nothing may be published, where what is on file is wrong
FALSE_ALARMS = 0.01  # share of the wheelsets, where it is right
SOFT = "soft_known"
CHANGED: Mapping[str, tuple[str, Mapping[str, Any]]] = {  # rows that are others but for some keys
    "soft_as_it_runs": (
        "vibration_2",
        {
            "section": {"survey_alignment_std_mm": 0.3, "cross_level": {"std_mm": 2.0}},
            "sensors": {"mounting_error_std_deg": 2.0, "scale_error_std_percent": 1.0},
            "position": {"offset_std_m": 0.5},
            "creep": {"law": "vermeulen_johnson", "lowest_friction": 0.15, "highest_friction": 0.5},
            "vehicle_errors": {},  # by what a class has on file where nothing is known better
        },
    ),
    "coach_known_3_h": ("coach_known", {"sessions": {"campaigns": 36, "minutes_each": 5.0}}),
    "coach_friction": ("coach_known", {"creep": {"law": "vermeulen_johnson", "friction": 0.35}}),
    "coach_polach": (  # the law for dry rails of Polach (2005)
        "coach_known",
        {
            "creep": {
                "law": "polach",
                "friction": 0.55,
                "slip_factor": 0.4,
                "sliding_friction_share": 0.4,
                "sliding_decay_s_m": 0.6,
            }
        },
    ),
    "coach_unknown_10_passes": ("coach_unknown", {"sessions": {"campaigns": 10}}),
    "scales_1_percent": (SOFT, {"sensors": {"scale_error_std_percent": 1.0, "stated_scale_std_percent": 0.5}}),
    "sensors_5_percent": (SOFT, {"sensors": {"scale_error_std_percent": 5.0, "stated_scale_std_percent": 0.0}}),
}
ROWS: Mapping[str, Reach | None] = {  # None: nothing may be published
    "paper_known": Reach(p95=0.01),
    "soft_known": Reach(p95=0.01),
    "soft_as_it_runs": Reach(p95=0.012, half=0.014),
    "coach_known": Reach(p95=0.012, half=0.014),
    "coach_known_3_h": Reach(p95=0.006, half=0.008),
    "coach_friction": Reach(p95=0.015, half=0.018),
    "coach_polach": Reach(p95=0.015, half=0.018),
    "paper_unknown": Reach(p95=0.02),
    "soft_unknown": Reach(p95=0.005, half=0.005),
    "coach_unknown": Reach(p95=0.03),
    "coach_unknown_10_passes": Reach(p95=0.02, half=0.025),
    "friction": Reach(p95=0.015),
    "positions_0_5_m": Reach(p95=0.015),
    "positions_2_m": Reach(p95=0.015),
    "positions_5_m": Reach(p95=0.015),
    "positions_20_m": Reach(p95=0.015),
    "cross_level": Reach(p95=0.03),
    "all_faults": Reach(p95=0.03),
    "demo_fleet": Reach(),
    "steep_rise": Reach(p95=0.02, half=0.02),
    "scales_1_percent": Reach(),
    "sensors_5_percent": Reach(covers_above=True),
    "vibration_2": Reach(p95=0.03),
    "vibration_5": Reach(p95=0.03),
    "vibration_10": Reach(p95=0.03),
    "gyroscopes": Reach(p95=0.02),
    "slow_bus": Reach(p95=0.01),
    "soft_parameters_drawn": Reach(p95=0.02),
    "flat": Reach(p95=0.015),
    "flat_unknown": Reach(p95=0.02),
    "frozen_positions": Reach(p95=0.015),
    "push_pull": Reach(p95=0.01),
    "coach_parameters_drawn": Reach(p95=0.015, half=0.018),
    "wrong_class_coach_as_paper": None,
    "wrong_radius_420_as_460": None,
    "wrong_wheelbase_2_5_as_1_8": None,
    "wrong_nodes_swapped": None,
    "wrong_frame_sensor_missing": None,
}
AT: Mapping[str, Sequence[Reach]] = {
    "demo_fleet": (Reach(p95=0.006, half=0.010, at=3e-3), Reach(p95=0.008, half=0.015, at=2.5e-3)),
    "steep_rise": (Reach(p95=0.02, half=0.02, at=3e-3),),
}
"""What is asked at one amplitude."""

MOST_REASONS = 2
EXPLANATION = (
    "Mean absolute error of the equivalent conicity over 1-3 mm by wheelset; share of the 95 % intervals that cover,"
    " with the 90 % interval of that share over fleets, which decides;"
    " wheelsets of which a conicity is published; wheelsets that are `model_mismatch`; processor time of the jobs per"
    " wheelset-hour recorded."
)


def run_case(row: str, seed: int) -> Case:
    """Return the score of a row for one seed."""
    return scored(scenario_of(row, seed))


def scenario_of(row: str, seed: int) -> Scenario:
    """Return the scenario of a row for one seed."""
    base, changes = CHANGED.get(row, (row, {}))
    return with_seed(replace(changed_scenario(SCENARIOS / f"{base}.toml", changes), name=row), seed)


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


def _met(name: str, cases: Sequence[Case]) -> Verdict:
    counted, reach = Counted.of(cases), ROWS[name]
    if reach is None:
        return verdict_of(counted.kept_back >= FOUND)
    return Verdict.all([reach.verdict(cases), verdict_of(counted.mismatch_share <= FALSE_ALARMS)])


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
    "reach": lambda name, _: "none" if ROWS[name] is None else str(ROWS[name]),
    "met": lambda name, cases: str(_met(name, cases)),
}


def table(cases: Sequence[Case]) -> ResultTable:
    """Return a line for each row that was run."""
    return ResultTable.of(COLUMNS, by_row(cases, ROWS).items(), range(1, 7))


main = Study(
    name="vehicles",
    title="Vehicles as they run",
    about=__doc__ or "",
    cases=lambda options, done: cases_of(run_case, options, done, options.rows),
    parts=lambda cases: [EXPLANATION, table(cases), *amplitude_tables(cases, AT)],
    line=summary_line,
    published=published_of,
    rows=ROWS,
    options=fleet_options,
).run
