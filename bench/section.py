"""The accuracy table of unknown track: ``python -m bench section [--seeds 0-19] [--rows known,unknown] ...``.

Every row is a built-in scenario; every seed of a row is simulated, ingested and estimated by the scheduled jobs
(``section_case``).
Two processes share the seeds. Results are written as JSON after every seed, so that nothing is lost on the way.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
import traceback
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.console import Console

from api.comparison.trial import recording_key
from bench.results_page import RESULTS, markdown_table, write_page
from bench.section_table import (
    LIMITS,
    SCALING_HEADER,
    SCALING_TITLE,
    SUMMARY_HEADER,
    SUMMARY_TITLE,
    scaling_rows,
    scaling_table,
    summaries,
    summary_rows,
    summary_table,
)
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import Scenario, VehicleErrors
from ingest.simulator.scenario_file import builtin_scenarios, load_scenario

NO_INFORMATION = "no_information"
WORKERS = 2


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    options = _options(arguments)
    console = Console(width=None if Console().is_terminal else 200)
    results = _before(options)
    if not options.print_only:
        _write(options.out, results)  # now, not after an hour
        _run_rows(options, results, console)
        if options.scaling and not results["scaling"]:
            _run_sizes(options, results, console)
    _show(console, results)
    if options.write_docs:
        console.print(f"wrote {write_results(results)}", highlight=False)
    if options.print_only:
        return 0
    console.print(f"wrote {options.out}", highlight=False)
    return 1 if results["failures"] or not all_met(results["cases"]) else 0


def _run_rows(options: argparse.Namespace, results: dict[str, Any], console: Console) -> None:
    """Add the cases that ``results`` lacks; stored after every task."""
    variants = {"both": (False, True), "none": (False,), "only": (True,)}[options.parameter_errors]
    have = {(case["row"], case["seed"], case["drawn"]) for case in results["cases"]}
    tasks = [
        (seed, rows, drawn)
        for drawn in variants
        for seed in options.seeds
        for rows in _sharing(_missing(options.rows, have, seed, drawn=drawn), seed)
    ]
    began = time.monotonic()
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(seed_cases, seed, rows, options.keep, drawn=drawn): seed for seed, rows, drawn in tasks}
        for done, future in enumerate(as_completed(futures), start=1):
            cases, failures = future.result()
            results["cases"] += cases
            results["failures"] += failures
            _write(options.out, results)
            passed = (time.monotonic() - began) / 60.0
            lines = [f"seed {futures[future]} done, {done} of {len(futures)} tasks, {passed:.1f} min"]
            lines += ["  " + summary_line(case) for case in cases]
            lines += [f"  FAILED {item['row']} seed {item['seed']}: {item['error']}" for item in failures]
            for line in lines:
                console.print(line, highlight=False)


def _run_sizes(options: argparse.Namespace, results: dict[str, Any], console: Console) -> None:
    """Add time and memory by number of passes; stored after every size."""
    from bench.section_scaling import scaling  # noqa: PLC0415 - only where asked for

    for size in scaling(options.keep):
        results["scaling"].append(size)
        _write(options.out, results)
        console.print(f"  {size['passes']} passes: {size['seconds']:.1f} s, {size['peak_mib']:.0f} MiB")


def write_results(results: Mapping[str, Any], folder: Path = RESULTS) -> Path:
    """Write the tables as a page of results, and return its path.

    Args:
        results: As ``--out`` holds them.
    """
    body = [SUMMARY_TITLE + ".", markdown_table(SUMMARY_HEADER, summary_rows(results["cases"]), range(1, 7))]
    if results["scaling"]:
        sizes = markdown_table(SCALING_HEADER, scaling_rows(results["scaling"]), range(len(SCALING_HEADER)))
        body += [SCALING_TITLE + ".", sizes]
    return write_page("accuracy", "Accuracy on simulated fleets", "python -m bench section --write-docs", body, folder)


def seed_cases(
    seed: int, rows: Sequence[str], keep: Path | None, *, drawn: bool
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the scores of ``rows`` for one seed, and what failed; runs in a process of its own."""
    from bench.section_case import score  # noqa: PLC0415 - compiled code is loaded where it runs

    cases, failures = [], []
    with tempfile.TemporaryDirectory(prefix="treadwatch-section-") as folder:
        for row in rows:
            data = Path(folder) / row
            try:
                cases.append(
                    score(row_scenario(row, seed, drawn=drawn), keep or Path(folder) / "recordings", data).as_json()
                )
            except Exception as error:  # noqa: BLE001 - one row that fails must not cost the hour before it
                trace = "".join(traceback.format_exception(error)[-2:])
                failures.append({"row": row, "seed": seed, "drawn": drawn, "error": repr(error), "trace": trace})
            shutil.rmtree(data, ignore_errors=True)
    return cases, failures


def row_scenario(row: str, seed: int, *, drawn: bool) -> Scenario:
    """Return the scenario of a row for one seed, with or without errors of the vehicle parameters."""
    scenario = with_seed(load_scenario(row), seed)
    return replace(scenario, vehicle_errors=VehicleErrors()) if drawn else scenario


def _missing(rows: Sequence[str], have: set[tuple[str, int, bool]], seed: int, *, drawn: bool) -> list[str]:
    """Return the rows that are still to do; a section without information has no variant with errors."""
    return [row for row in rows if (row, seed, drawn) not in have and not (drawn and row == NO_INFORMATION)]


def _sharing(rows: Sequence[str], seed: int) -> list[list[str]]:
    """Return the rows in groups that share one simulation."""
    groups: dict[str, list[str]] = {}
    for row in rows:
        groups.setdefault(recording_key(row_scenario(row, seed, drawn=False)), []).append(row)
    return list(groups.values())


def _before(options: argparse.Namespace) -> dict[str, Any]:
    """Return what was found before, where the run goes on from there."""
    if not (options.resume or options.print_only):
        return {"cases": [], "failures": [], "scaling": []}
    stored = json.loads(options.out.read_text(encoding="utf-8"))
    return {"cases": stored["cases"], "failures": [], "scaling": stored["scaling"]}


def _show(console: Console, results: dict[str, Any]) -> None:
    console.print(summary_table(results["cases"]))
    if results["scaling"]:
        console.print(scaling_table(results["scaling"]))


def summary_line(case: dict[str, Any]) -> str:
    """Return one case in a line."""
    errors = [item["error"] for item in case["wheelsets"] if item["error"] is not None]
    published = sum(item["conicity"]["published"] for item in case["wheelsets"])
    covered = sum(item["conicity"]["covered"] for item in case["wheelsets"])
    name = case["row"] + (" with parameter errors" if case["drawn"] else "")
    line = f"{name}, {case['pair']}: "
    line += f"error mean {sum(errors) / len(errors):.4f}, worst {max(errors):.4f}" if errors else "nothing estimated"
    if published:
        line += f", {covered}/{published} intervals cover"
    if case["alignment"] is not None:
        line += f", alignment {1e3 * case['alignment']['band']:.3f} mm"
    if case["reason"]:
        line += f" ({case['reason']})"
    return line + f", {sum(case['seconds']):.0f} s"


def all_met(cases: Sequence[dict[str, Any]]) -> bool:
    """Whether every row that was run reaches its numbers."""
    return all(item.met for item in summaries(cases))


def _write(path: Path, results: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(results, indent=1), encoding="utf-8")


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench section", description=__doc__)
    parser.add_argument("--seeds", type=_seeds, default=list(range(20)), help="as 0-19 or 0,3,7; default 0-19")
    parser.add_argument("--rows", type=_rows, default=list(LIMITS), help=f"of {', '.join(LIMITS)}; default all")
    parser.add_argument(
        "--parameter-errors", choices=("both", "none", "only"), default="both", help="run rows without, with, or both"
    )
    parser.add_argument("--no-scaling", dest="scaling", action="store_false", help="leave time and memory out")
    parser.add_argument("--resume", action="store_true", help="keep what --out holds, and do what it lacks")
    parser.add_argument("--print-only", action="store_true", help="print the table of what --out holds")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/accuracy.md too")
    parser.add_argument("--workers", type=int, default=WORKERS, help="processes")
    parser.add_argument("--keep", type=Path, default=None, help="folder that keeps recordings (150 MB each)")
    parser.add_argument("--out", type=Path, default=Path("bench-results/section.json"), help="JSON file to write")
    return parser.parse_args(arguments)


def _seeds(text: str) -> list[int]:
    seeds: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        seeds += range(int(first), int(last or first) + 1)
    return seeds


def _rows(text: str) -> list[str]:
    rows, known = text.split(","), builtin_scenarios()
    for row in rows:
        if row not in known:
            raise argparse.ArgumentTypeError(f"{row!r} is none of {', '.join(known)}")
    return rows
