"""Surveys as evidence: ``python -m bench surveys [--seeds 0-2] [--rows plain,coach,...] ...``.

Each drawn fleet (``survey_fleets``) meets its section without a survey, and with surveys of any std, stated as it is or
a fifth of it, and with wrong ones; the gauge is on file in all. Positions are off by 0.5 m, in two rows by 0 and 2 m.
Nothing is recorded or stored: signals go through the functions of the jobs (``survey_case``). Beside each survey the
rival uses it as it is on file. Results are appended to ``--out``, a line of JSON a fleet, and what is there is not run
again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.report import BenchRow, printed
from bench.results_page import markdown_table, write_page
from bench.survey_case import SurveyPlan, moved, on_file, score
from bench.survey_fleets import COACH, FleetPlan, drawn_fleet
from bench.survey_table import HEADER, TITLE, USUAL, differences, rows_of, summary
from bench.world import seed_range
from estimation.vehicle.vehicle_class import VehicleParameters

ROWS: Mapping[str, FleetPlan] = {
    "plain": FleetPlan(),
    "single wheelsets": FleetPlan(parameters=VehicleParameters(), bogies=False),
    "coach": FleetPlan(parameters=COACH),
    "slow": FleetPlan(speeds=(8.5, 11.0)),
    "few passes": FleetPlan(vehicles=2, journeys=2),
    "one vehicle": FleetPlan(vehicles=1),
    "switches": FleetPlan(switches=True),
    "one flat": FleetPlan(flat=True),
}
BY_SURVEY = (
    "By survey, over all fleets. The error of an alignment is against the truth in the waves of the motion, at its best"
    " place. The *rival* uses the file as it is; without one it states the std that the fleet's alignment truly has."
)
MM = 1e-3
SURVEYS: Mapping[str, SurveyPlan] = {
    "none": SurveyPlan(None),
    **{f"{std:g} mm": SurveyPlan(std * MM) for std in (0.05, 0.1, 0.3, 1.0, 3.0)},
    **{f"{std:g} mm stated as {std / 5:g}": SurveyPlan(std * MM, stated=0.2 * std * MM) for std in (0.25, 0.5, 1.5)},
    "shift 10 m": SurveyPlan(0.1 * MM, shift=10.0),
    "scale 1.2": SurveyPlan(0.1 * MM, scale=1.2),
    "other section": SurveyPlan(0.1 * MM, other_section=True),
    "other section 1 mm": SurveyPlan(MM, other_section=True),
    "sign": SurveyPlan(0.1 * MM, scale=-1.0),
    "sign 0.5 mm": SurveyPlan(0.5 * MM, scale=-1.0),
}
NAMES = [name for name, plan in SURVEYS.items() if plan.std is not None and plan.right and plan.stated is None]
POSITIONS = {"0 m": 0.0, "0.5 m": 0.5, "2 m": 2.0}
ALL_POSITIONS = ("0.3 mm",)  # surveys that are tried with every error of positions


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    options = _options(arguments)
    console = Console(width=200)
    cases = _stored(options.out)
    if not options.print_only:
        have = {(case["row"], case["seed"]) for case in cases}
        options.out.parent.mkdir(parents=True, exist_ok=True)
        for seed in options.seeds:
            for row in options.rows:
                if (row, seed) in have:
                    continue
                found = list(fleet_cases(row, seed, options.surveys))
                cases += found
                with options.out.open("a", encoding="utf-8") as file:
                    file.writelines(json.dumps(case) + "\n" for case in found)
                console.print(f"{row} seed {seed}: {len(found)} cases", highlight=False)
    made: list[BenchRow] = printed(summary(cases))
    if options.write_docs:
        body = [
            markdown_table(("what", "measured", "reach", "met"), [row.cells for row in made]),
            BY_SURVEY,
            markdown_table(HEADER, rows_of(cases, "survey"), range(1, len(HEADER))),
            "By fleet, over all right surveys.",
            markdown_table(HEADER, rows_of([case for case in cases if case["right"]], "row"), range(1, len(HEADER))),
        ]
        body += [
            "With a survey less without, by fleet: error, interval score, and that against none with its true std.",
            markdown_table(("", *NAMES), differences(cases, NAMES), range(1, len(NAMES) + 1)),
        ]
        shown = ", ".join(f"{row} {seed}" for row, seed in dict.fromkeys((case["row"], case["seed"]) for case in cases))
        body.insert(0, f"Fleets and seeds: {shown}.")
        page = write_page("surveys", TITLE, "python -m bench surveys --write-docs", body)
        console.print(f"wrote {page}", highlight=False)
    return 0 if all(row.met for row in made) else 1


def fleet_cases(row: str, seed: int, surveys: Sequence[str] = tuple(SURVEYS)) -> Iterator[dict[str, Any]]:
    """Yield the scores of one drawn fleet with every survey, as JSON values.

    Args:
        surveys: Names of those that are tried; by default all.
    """
    fleet = drawn_fleet(ROWS[row], seed)
    for survey, plan in ((name, SURVEYS[name]) for name in surveys):
        for positions in POSITIONS if survey in ALL_POSITIONS else (USUAL,):
            at = moved(fleet, POSITIONS[positions], seed)
            found, rival = score(at, on_file(at, plan, seed), rival=plan.right)
            yield {
                "row": row,
                "seed": seed,
                "survey": survey,
                "positions": positions,
                "right": plan.std is not None and plan.right,
                "understated": plan.stated is not None,
                **asdict(found),
                "rival": None if rival is None else asdict(rival),
            }


def _stored(path: Path) -> list[dict[str, Any]]:
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench surveys", description=__doc__)
    parser.add_argument("--seeds", type=seed_range, default=[0], help="as in 0-19 or 3 (default: 0)")
    parser.add_argument("--rows", type=_rows, default=list(ROWS), help="names, with commas between (default: all)")
    parser.add_argument("--surveys", type=_surveys, default=list(SURVEYS), help="likewise")
    parser.add_argument("--out", type=Path, default=Path("bench-results/surveys.jsonl"), help="lines of JSON")
    parser.add_argument("--print-only", action="store_true", help="print the tables of what --out holds")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/surveys.md")
    return parser.parse_args(arguments)


def _rows(text: str) -> list[str]:
    return _known(text, ROWS)


def _surveys(text: str) -> list[str]:
    return _known(text, SURVEYS)


def _known(text: str, known: Collection[str]) -> list[str]:
    names = text.split(",")
    unknown = [name for name in names if name not in known]
    if unknown:
        raise argparse.ArgumentTypeError(f"{', '.join(unknown)} unknown; there are {', '.join(known)}")
    return names
