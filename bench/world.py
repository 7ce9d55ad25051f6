"""Other people's track and fleets: ``python -m bench world [--seeds 0-2] [--rows known_line,...] ...``.

Every row is a scenario file in ``bench/world_scenarios``; every seed of it is simulated, ingested and estimated by the
scheduled jobs (``fleet_case``). With ``--measured FOLDER`` two rows have the measured wheels of that folder
(``world_measured``).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from bench import world_measured
from bench.fleet_case import Figures, by_row, scored, summary_line
from bench.report import Part, ResultTable, say, share_of
from bench.study import Case, Key, Study, in_processes
from bench.world_measured import WheelPair
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario

SCENARIOS = Path(__file__).parent / "world_scenarios"
SURVEY_RIGHT = "survey_confirmed"


@dataclass(frozen=True, slots=True)
class Reach:
    """What a row has to reach."""

    p95: float | None = None  # of the conicity error
    survey: tuple[str, ...] = ()  # verdicts that are right; empty where no survey is on file
    covers_above: bool = False  # too wide is right as well: the passes hardly say anything


WRONG = ("survey_unrelated",)
ROWS: Mapping[str, Reach] = {
    "known_alike": Reach(0.015, (SURVEY_RIGHT,)),
    "known_alike_gauge": Reach(0.02, (SURVEY_RIGHT,)),
    "known_wide_gauge": Reach(0.02, (SURVEY_RIGHT,)),
    "known_line_alike": Reach(0.02, (SURVEY_RIGHT,)),
    "known_line": Reach(0.02, (SURVEY_RIGHT,)),
    "known_diverse_gauge": Reach(0.02, (SURVEY_RIGHT,)),
    "survey_shifted": Reach(survey=("survey_displaced",), covers_above=True),
    "survey_scaled": Reach(survey=("survey_unit", *WRONG), covers_above=True),
    "survey_mirrored": Reach(survey=("survey_mirrored", *WRONG), covers_above=True),
    "survey_of_another_section": Reach(survey=WRONG, covers_above=True),
    "gauge_of_another_section": Reach(survey=("survey_gauge_unrelated",), covers_above=True),
    "gauge_scaled": Reach(survey=("survey_gauge_unit",), covers_above=True),
    "unknown_long_gauge": Reach(0.035),
    "unknown_alike_02": Reach(covers_above=True),
    "unknown_alike_05": Reach(covers_above=True),
    "unknown_alike_08": Reach(covers_above=True),
    "measured_known": Reach(0.01, (SURVEY_RIGHT,)),
    "measured_unknown": Reach(0.02),
}
HEADER = (
    *("row", "seeds", "nothing published", "survey right", "error: median / 95 %", "covers", "half width"),
    *("diversity", "reach", "met"),
)
WIDTH_TITLE = "Intervals of the conicity against the diversity of the fleet, rows on unknown track"
WIDTH_HEADER = ("diversity", "fleets", "nothing published", "covers", "half width: median", "error: median")
DIVERSITIES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, math.inf)  # limits of the lines
UNKNOWN = "unknown"  # how the names of the rows on unknown track begin


def run_case(row: str, seed: int, keep: Path | None, wheels: tuple[WheelPair, ...] = ()) -> Case:
    """Return the score of a row for one seed; with measured wheels also which of them cannot run in it."""
    scenario, left_out = scenario_of(row, seed, wheels)
    return scored(scenario, keep) | {"left_out": left_out}


def scenario_of(row: str, seed: int, wheels: tuple[WheelPair, ...] = ()) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario of a row for one seed, and the measured wheelsets that cannot run in it."""
    scenario = with_seed(load_scenario(SCENARIOS / f"{row}.toml"), seed)
    return world_measured.with_wheels(scenario, wheels) if row in world_measured.ROWS else (scenario, ())


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case | None]:
    rows = [row for row in options.rows if row not in world_measured.ROWS or options.measured is not None]
    if options.measured is None and not rows:
        raise SystemExit(f"{', '.join(world_measured.ROWS)} need --measured")
    tasks = [(row, seed) for seed in options.seeds for row in rows if (row, seed) not in done]
    work = partial(run_case, keep=options.keep, wheels=_measured_wheels(options.measured))
    for case in in_processes(work, tasks, options.workers):
        for line in () if case is None else case["left_out"]:
            say(f"  left out: {line}")
        yield case


def _measured_wheels(folder: Path | None) -> tuple[WheelPair, ...]:
    """Return the wheelsets of the rows with measured wheels, and print what is left out."""
    if folder is None:
        return ()
    template = load_scenario(SCENARIOS / f"{world_measured.ROWS[0]}.toml")
    found = world_measured.measured_wheels(folder, with_seed(template, 0).section)
    for line in (f"{len(found.pairs)} wheelsets of measured wheels", *(f"left out: {one}" for one in found.left_out)):
        say(line)
    return found.pairs


def summary_rows(cases: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return a line for each row that was run."""
    return [_summary(name, of_row) for name, of_row in by_row(cases, ROWS).items()]


def _summary(name: str, cases: Sequence[Case]) -> tuple[str, ...]:
    reach, figures = ROWS[name], Figures.of(cases)
    right = sum(case["survey"] in reach.survey for case in cases)
    covers = figures.covers(1.0) if reach.covers_above else figures.covers()
    met = (
        (not reach.survey or right == len(cases))
        and (reach.p95 is None or figures.p95 <= reach.p95)
        and (covers if figures.published else reach.covers_above)
    )
    return (
        name,
        str(len(cases)),
        _without_intervals(cases),
        f"{right} of {len(cases)}" if reach.survey else "",
        figures.error,
        share_of(figures.covered, figures.published),
        figures.width,
        f"{np.median([case['diversity'] for case in cases]):.2f}",
        "" if reach.p95 is None else f"{reach.p95:g}",
        "yes" if met else "NO",
    )


def width_rows(cases: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return a line for each range of diversity with fleets on unknown track; the unsolved last."""
    unknown = [case for case in cases if case["row"].startswith(UNKNOWN)]
    lines = [
        (
            f"{low:g} to {high:g}" if math.isfinite(high) else f"above {low:g}",
            [case for case in unknown if low < case["diversity"] <= high],
        )
        for low, high in pairwise(DIVERSITIES)
    ]
    lines.append(("none", [case for case in unknown if not case["diversity"] > 0.0]))
    return [_width_row(name, within) for name, within in lines if within]


def _width_row(name: str, cases: Sequence[Case]) -> tuple[str, ...]:
    figures = Figures.of(cases)
    error = f"{np.median(figures.errors):.4f}" if figures.errors else ""
    share = share_of(figures.covered, figures.published)
    return name, str(len(cases)), _without_intervals(cases), share, figures.width, error


def _without_intervals(cases: Sequence[Case]) -> str:
    """Return how many fleets have no published conicity."""
    return str(sum(Figures.of([case]).published == 0 for case in cases))


def tables(cases: Sequence[Case]) -> list[Part]:
    """Return the tables; that of the intervals where there are fleets on unknown track."""
    found: list[Part] = [ResultTable(HEADER, summary_rows(cases), range(1, len(HEADER) - 2))]
    widths = width_rows(cases)
    if widths:
        found.append(ResultTable(WIDTH_HEADER, widths, range(1, len(WIDTH_HEADER)), WIDTH_TITLE))
    return found


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--keep", type=Path, default=None, help="folder that keeps recordings")
    parser.add_argument("--measured", type=Path, default=None, help="folder of measured wheels, for two rows more")


main = Study(
    name="world",
    title="Other track and other fleets",
    about=__doc__ or "",
    cases=_cases,
    parts=tables,
    line=summary_line,
    rows=ROWS,
    options=_options,
).run
