"""Vehicles as they run: ``python -m bench vehicles [--seeds 0-2] [--rows soft_known,...] [--power] ...``.

Every row is a scenario file in ``bench/vehicle_scenarios``; every seed of it is simulated, ingested and estimated by
the scheduled jobs (``fleet_case``). With ``--power`` the class on file is wrong by more and more as well: the soft
bogies of ``soft_known`` run as they are, and the class on file differs from them in one parameter. Names of these rows
are ``power:<parameter>:<error in percent>``; an error of 0 gives the false alarms.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from bench.fleet_case import Figures, by_row, scored, summary_line
from bench.report import Part, ResultTable, share_of
from bench.study import Case, Key, Study, in_processes
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import ClassOnFile, Scenario
from ingest.simulator.scenario_file import load_scenario
from ingest.vehicle_class_schema import read_vehicle_class

SCENARIOS = Path(__file__).parent / "vehicle_scenarios"
POWER, POWER_BASE, NOTHING = "power", "soft_known", "nothing"
CLASS_FILE = SCENARIOS / "classes" / "soft.toml"
STIFFNESS_PERCENT = (-50, -20, -10, 10, 20, 50, 100)
PARAMETERS: Mapping[str, tuple[str, tuple[int, ...]]] = {  # key in the class file, where it stands first; percent
    "yaw_stiffness": ("yaw_stiffness_n_m_rad", STIFFNESS_PERCENT),
    "lateral_stiffness": ("lateral_stiffness_n_m", STIFFNESS_PERCENT),
    "wheelbase": ("wheelbase_m", (-30, -20, -10, 10, 20, 30)),
    "nominal_radius": ("nominal_radius_mm", (-10, -5, -2, 2, 5, 10)),
    "mass": ("mass_kg", (-20, -10, 10, 20)),
}
POWER_ROWS: tuple[str, ...] = (
    f"{POWER}:{NOTHING}:0",
    *(f"{POWER}:{name}:{percent:+d}" for name, (_, sizes) in PARAMETERS.items() for percent in sizes),
)
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
POWER_TITLE = "What tests of fit find where one parameter of the class on file is wrong: soft bogies, survey on file"
POWER_HEADER = ("parameter", "error on file", "wheelsets", "mismatch", "published", "error: median / 95 %", "covers")
MOST_REASONS = 2
EXPLANATION = (
    "Mean absolute error of the equivalent conicity over 1-3 mm by wheelset; share of the 95 % intervals that cover;"
    " wheelsets of which a conicity is published; wheelsets that are `model_mismatch`; processor time of the jobs per"
    " wheelset-hour recorded."
)


def run_case(row: str, seed: int, keep: Path | None) -> Case:
    """Return the score of a row for one seed."""
    return scored(lambda folder: scenario_of(row, seed, folder), keep)


def scenario_of(row: str, seed: int, folder: Path) -> Scenario:
    """Return the scenario of a row for one seed; a class file that is wrong is written into a folder."""
    if row not in POWER_ROWS:
        return with_seed(load_scenario(SCENARIOS / f"{row}.toml"), seed)
    right = with_seed(load_scenario(SCENARIOS / f"{POWER_BASE}.toml"), seed)
    _, name, percent = row.split(":")
    text = CLASS_FILE.read_text(encoding="utf-8")
    if name != NOTHING:
        text = _scaled(text, PARAMETERS[name][0], 1.0 + int(percent) / 100.0)
    path = folder / CLASS_FILE.name
    path.write_text(text, encoding="utf-8")
    on_file = read_vehicle_class(path)
    radius = on_file.parameters.nominal_radius if name == "nominal_radius" else None
    return replace(right, name=row, class_on_file=ClassOnFile(path, on_file, radius))


def _scaled(text: str, key: str, factor: float) -> str:
    """Return a class file with the first value of ``key`` multiplied by ``factor``."""
    found = re.search(rf"^{key} = (\S+)$", text, flags=re.MULTILINE)
    assert found is not None, key
    begin, end = found.span(1)
    return f"{text[:begin]}{factor * float(found[1]):g}{text[end:]}"


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case | None]:
    rows = [*options.rows, *(POWER_ROWS if options.power else ())]
    tasks = [(row, seed) for seed in options.seeds for row in rows if (row, seed) not in done]
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
    figures, counted, limit = Figures.of(cases), Counted.of(cases), ROWS[name]
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


def power_rows(cases: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return a line for each size of a wrong parameter that was run."""
    return [_power_row(name, of_row) for name, of_row in by_row(cases, POWER_ROWS).items()]


def _power_row(name: str, cases: Sequence[Case]) -> tuple[str, ...]:
    _, parameter, percent = name.split(":")
    figures, counted = Figures.of(cases), Counted.of(cases)
    return (
        parameter,
        f"{percent} %" if int(percent) else "",
        str(counted.wheelsets),
        f"{counted.mismatch_share:.0%}".replace("%", " %"),
        f"{1.0 - counted.kept_back:.0%}".replace("%", " %"),
        figures.error,
        share_of(figures.covered, figures.published),
    )


def _reasons(cases: Sequence[Case]) -> str:
    codes = Counter(verdict["code"] for case in cases for verdict in case["verdicts"] if verdict["code"])
    if not (codes or Counted.of(cases).published):  # nothing was refused: there is no alignment
        return ", ".join(sorted({case["survey"] for case in cases if case["survey"]}))
    return ", ".join(f"{code} {count}" for code, count in codes.most_common(MOST_REASONS))


def tables(cases: Sequence[Case]) -> list[Part]:
    """Return the tables of the page."""
    found: list[Part] = [EXPLANATION, ResultTable(HEADER, summary_rows(cases), range(1, 7))]
    power = power_rows(cases)
    if power:
        found.append(ResultTable(POWER_HEADER, power, range(1, len(POWER_HEADER)), POWER_TITLE))
    return found


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--power", action="store_true", help="the rows of the power curve too")
    parser.add_argument("--keep", type=Path, default=None, help="folder that keeps recordings (130 MB each)")


main = Study(
    name="vehicles",
    title="Vehicles as they run",
    about=__doc__ or "",
    cases=_cases,
    parts=tables,
    line=summary_line,
    rows=ROWS,
    options=_options,
    command=lambda _: "python -m bench vehicles --power --write-docs",
).run
