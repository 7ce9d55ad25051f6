"""Vehicles as they run: ``python -m bench vehicles [--seeds 0-2] [--rows soft_known,...] [--power] ...``.

Every row is a scenario file in ``bench/vehicle_scenarios``; every seed of it is simulated, ingested and estimated by
the scheduled jobs (``vehicle_case``). With ``--power`` the class on file is wrong by more and more as well
(``vehicle_power``). Results are appended to ``--out`` after every case, a line of JSON each, and what is there is not
run again.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import traceback
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from bench import vehicle_power
from bench.results_page import write_page
from bench.vehicle_table import ROWS, TITLE, counted, page_body, summary_rows, tables
from bench.world import seed_range
from bench.world_table import figures
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario

SCENARIOS = Path(__file__).parent / "vehicle_scenarios"


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short or fails."""
    options = _options(arguments)
    console = Console(width=None if Console().is_terminal else 200)
    cases = stored_cases(options.out)
    failed = 0 if options.print_only else _run(options, cases, console)
    for table in tables(cases):
        console.print(table)
    if options.write_docs:
        page = write_page("vehicles", TITLE, "python -m bench vehicles --power --write-docs", page_body(cases))
        console.print(f"wrote {page}", highlight=False)
    return 1 if failed or not all(row[-1] == "yes" for row in summary_rows(cases)) else 0


def stored_cases(path: Path) -> list[dict[str, Any]]:
    """Return the cases of a file of results, the last of each row and seed; none where there is no file."""
    if not path.exists():
        return []
    found = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return list({(case["row"], case["seed"]): case for case in found}.values())


def _run(options: argparse.Namespace, cases: list[dict[str, Any]], console: Console) -> int:
    """Add the cases that are missing; return how many failed."""
    have = {(case["row"], case["seed"]) for case in cases}
    tasks = [(row, seed) for seed in options.seeds for row in options.rows if (row, seed) not in have]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    failed = 0
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), max_tasks_per_child=1) as pool:
        for done, (row, seed) in enumerate(tasks, start=1):
            try:
                case = pool.submit(run_case, row, seed, options.keep).result()
            except Exception as error:  # noqa: BLE001 - one row that fails must not cost the hour before it
                failed += 1
                console.print(f"{done} of {len(tasks)}: {row} seed {seed}: FAILED {error!r}", highlight=False)
                console.print("".join(traceback.format_exception(error)), highlight=False)
                continue
            cases.append(case)
            with options.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(case) + "\n")
            console.print(f"{done} of {len(tasks)}: {row} seed {seed}: {_line(case)}", highlight=False)
    return failed


def run_case(row: str, seed: int, keep: Path | None) -> dict[str, Any]:
    """Return the score of a row for one seed; runs in a process of its own.

    Args:
        row: Name of a scenario file, or of a row of ``vehicle_power``.
        keep: Folder that keeps recordings; None for none.
    """
    from bench.vehicle_case import score  # noqa: PLC0415 - compiled code is loaded where it runs

    with tempfile.TemporaryDirectory(prefix="treadwatch-vehicles-") as name:
        folder = Path(name)
        scenario = scenario_of(row, seed, folder)
        return score(scenario, keep or folder / "recordings", folder / "data").as_json()


def scenario_of(row: str, seed: int, folder: Path) -> Scenario:
    """Return the scenario of a row for one seed.

    Args:
        folder: Where a class file that is wrong is written; exists.
    """
    if row in vehicle_power.ROWS:
        right = with_seed(load_scenario(SCENARIOS / f"{vehicle_power.BASE}.toml"), seed)
        return vehicle_power.with_wrong_parameter(right, row, folder)
    return with_seed(load_scenario(SCENARIOS / f"{row}.toml"), seed)


def _line(case: Mapping[str, Any]) -> str:
    errors, (covered, published), _ = figures([case])
    error = f"error {np.median(errors):.4f}, worst {max(errors):.4f}" if errors else "nothing published"
    found = counted([case])
    codes = sorted({verdict["code"] for verdict in case["verdicts"] if verdict["code"]})
    return (
        f"{error}, {covered} of {published} cover, {found.published} of {found.wheelsets} published,"
        f" {found.mismatch} do not fit, {', '.join(codes) or 'no reason'}, {case['survey'] or 'no survey'},"
        f" {case['cpu_seconds'] / case['wheelset_hours']:.1f} s/h, {case['seconds']:.0f} s {case['reason'][:60]}"
    )


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench vehicles", description=__doc__)
    parser.add_argument("--seeds", type=seed_range, default=[0], help="as in 0-19 or 3 (default: 0)")
    parser.add_argument("--rows", type=_rows, default=None, help="names, with commas between (default: all)")
    parser.add_argument("--power", action="store_true", help="the rows of the power curve too")
    parser.add_argument("--keep", type=Path, default=None, help="folder that keeps recordings (130 MB each)")
    parser.add_argument("--out", type=Path, default=Path("bench-results/vehicles.jsonl"), help="lines of JSON")
    parser.add_argument("--print-only", action="store_true", help="print the tables of what --out holds")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/vehicles.md")
    options = parser.parse_args(arguments)
    options.rows = options.rows or [*ROWS, *(vehicle_power.ROWS if options.power else ())]
    return options


def _rows(text: str) -> list[str]:
    names = text.split(",")
    known = [*ROWS, *vehicle_power.ROWS]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise argparse.ArgumentTypeError(f"no row {', '.join(unknown)}; there are {', '.join(known)}")
    return names
