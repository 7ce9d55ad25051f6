"""Other people's track and fleets: ``python -m bench world [--seeds 0-2] [--rows known_line,...] ...``.

Every row is a scenario file in ``bench/world_scenarios``; every seed of it is simulated, ingested and estimated by the
scheduled jobs (``world_case``). Results are written as JSON after every case, so that nothing is lost on the way.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from bench.results_page import markdown_table, write_page
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario_file import load_scenario

SCENARIOS = Path(__file__).parent / "world_scenarios"
COVERAGE = (0.92, 0.98)
SURVEY_RIGHT = "survey_confirmed"


@dataclass(frozen=True, slots=True)
class Reach:
    """What a row has to reach."""

    p95: float | None = None  # of the conicity error
    survey: tuple[str, ...] = ()  # verdicts that are right; empty where no survey is on file
    covers_above: bool = False  # too wide is right as well: the passes hardly say anything


WRONG = ("survey_unrelated", "survey_differs")
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
    "unknown_long_gauge": Reach(0.035),
    "unknown_alike_02": Reach(covers_above=True),
    "unknown_alike_05": Reach(covers_above=True),
    "unknown_alike_08": Reach(covers_above=True),
}
HEADER = ("row", "seeds", "survey right", "error: median / 95 %", "covers", "half width", "diversity", "reach", "met")


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    options = _options(arguments)
    console = Console(width=None if Console().is_terminal else 200)
    cases: list[dict[str, Any]] = json.loads(options.out.read_text()) if options.resume and options.out.exists() else []
    _run(options, cases, console)
    rows = [_summary(name, [case for case in cases if case["row"] == name]) for name in ROWS]
    table = Table(*HEADER, title="Other track and other fleets", title_justify="left")
    for cells in (row for row in rows if row is not None):
        table.add_row(*cells)
    console.print(table)
    if options.write_docs:
        body = [markdown_table(HEADER, [row for row in rows if row is not None], range(1, len(HEADER) - 2))]
        page = write_page("world", "Other track and other fleets", "python -m bench world --write-docs", body)
        console.print(f"wrote {page}", highlight=False)
    return 0 if all(row[-1] == "yes" for row in rows if row is not None) else 1


def _run(options: argparse.Namespace, cases: list[dict[str, Any]], console: Console) -> None:
    have = {(case["row"], case["seed"]) for case in cases}
    tasks = [(row, seed) for seed in options.seeds for row in options.rows if (row, seed) not in have]
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(run_case, row, seed, options.keep): (row, seed) for row, seed in tasks}
        for done, future in enumerate(as_completed(futures), start=1):
            cases.append(future.result())
            options.out.write_text(json.dumps(cases), encoding="utf-8")
            row, seed = futures[future]
            console.print(f"{done} of {len(tasks)}: {row} seed {seed}: {_line(cases[-1])}", highlight=False)


def run_case(row: str, seed: int, keep: Path | None) -> dict[str, Any]:
    """Return the score of a row for one seed; runs in a process of its own.

    Parameters
    ----------
    row
        Name of a scenario file.
    seed
        Of the scenario.
    keep
        Folder that keeps recordings; None for none.
    """
    from bench.world_case import score  # noqa: PLC0415 - compiled code is loaded where it runs

    scenario = with_seed(load_scenario(SCENARIOS / f"{row}.toml"), seed)
    with tempfile.TemporaryDirectory(prefix="treadwatch-world-") as folder:
        return score(scenario, keep or Path(folder) / "recordings", Path(folder) / "data").as_json()


def _line(case: Mapping[str, Any]) -> str:
    errors, (covered, published), _ = _figures([case])
    error = f"error {np.median(errors):.4f}, {covered} of {published} cover" if errors else "nothing published"
    return f"{case['survey'] or 'no survey'}, {error}, {case['seconds']:.0f} s {case['reason'][:60]}"


def _figures(cases: Sequence[Mapping[str, Any]]) -> tuple[list[float], tuple[int, int], list[float]]:
    """Return errors of conicity by wheelset, how many intervals cover of how many, and their half widths."""
    wheelsets = [item for case in cases for item in case["wheelsets"]]
    errors = [item["error"] for item in wheelsets if item["error"] is not None]
    counts = [item["conicity"] for item in wheelsets]
    covered = (sum(one["covered"] for one in counts), sum(one["published"] for one in counts))
    return errors, covered, [width for case in cases for width in case["half_widths"]]


def _summary(name: str, cases: Sequence[Mapping[str, Any]]) -> tuple[str, ...] | None:
    if not cases:
        return None
    reach = ROWS[name]
    errors, (covered, published), widths = _figures(cases)
    right = sum(case["survey"] in reach.survey for case in cases)
    p95 = float(np.percentile(errors, 95)) if errors else float("nan")
    share = covered / published if published else float("nan")
    highest = 1.0 if reach.covers_above else COVERAGE[1]
    met = (
        (not reach.survey or right == len(cases))
        and (reach.p95 is None or p95 <= reach.p95)
        and (COVERAGE[0] <= share <= highest if published else reach.covers_above)
    )
    return (
        name,
        str(len(cases)),
        f"{right} of {len(cases)}" if reach.survey else "",
        f"{np.median(errors):.4f} / {p95:.4f}" if errors else "none",
        f"{100 * share:.1f} % of {published}" if published else "",
        f"{np.median(widths):.3f}" if widths else "",
        f"{np.median([case['diversity'] for case in cases]):.2f}",
        "" if reach.p95 is None else f"{reach.p95:g}",
        "yes" if met else "NO",
    )


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench world", description=__doc__)
    parser.add_argument("--seeds", type=_seeds, default=[0], help="as in 0-19 or 3 (default: 0)")
    parser.add_argument("--rows", type=_rows, default=list(ROWS), help="names, with commas between (default: all)")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--keep", type=Path, default=None, help="folder that keeps recordings")
    parser.add_argument("--out", type=Path, default=Path("world.json"))
    parser.add_argument("--resume", action="store_true", help="go on with the results in --out")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/world.md")
    return parser.parse_args(arguments)


def _seeds(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def _rows(text: str) -> list[str]:
    names = text.split(",")
    unknown = [name for name in names if name not in ROWS]
    if unknown:
        raise argparse.ArgumentTypeError(f"no row {', '.join(unknown)}; there are {', '.join(ROWS)}")
    return names
