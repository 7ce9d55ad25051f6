"""Other people's track and fleets: ``python -m bench world [--seeds 0-2] [--rows known_line,...] ...``.

Every row is a scenario file in ``bench/world_scenarios``; every seed of it is simulated, ingested and estimated by the
scheduled jobs (``world_case``). Results are written as JSON after every case, so that nothing is lost on the way.
With ``--measured FOLDER`` two rows have the measured wheels of that folder (``world_measured``).
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from bench import world_measured
from bench.results_page import write_page
from bench.world_measured import WheelPair
from bench.world_table import ROWS, TITLE, figures, page_body, summary_rows, tables
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario

SCENARIOS = Path(__file__).parent / "world_scenarios"


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    options = _options(arguments)
    console = Console(width=None if Console().is_terminal else 200)
    cases: list[dict[str, Any]] = json.loads(options.out.read_text()) if options.resume and options.out.exists() else []
    _run(options, cases, console)
    for table in tables(cases):
        console.print(table)
    if options.write_docs:
        page = write_page("world", TITLE, "python -m bench world --write-docs", page_body(cases))
        console.print(f"wrote {page}", highlight=False)
    return 0 if all(row[-1] == "yes" for row in summary_rows(cases)) else 1


def _run(options: argparse.Namespace, cases: list[dict[str, Any]], console: Console) -> None:
    have = {(case["row"], case["seed"]) for case in cases}
    tasks = [(row, seed) for seed in options.seeds for row in options.rows if (row, seed) not in have]
    wheels = _measured_wheels(options, console)
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(run_case, row, seed, options.keep, wheels): (row, seed) for row, seed in tasks}
        for done, future in enumerate(as_completed(futures), start=1):
            cases.append(future.result())
            options.out.write_text(json.dumps(cases), encoding="utf-8")
            row, seed = futures[future]
            console.print(f"{done} of {len(tasks)}: {row} seed {seed}: {_line(cases[-1])}", highlight=False)
            for line in cases[-1]["left_out"]:
                console.print(f"  left out: {line}", highlight=False)


def _measured_wheels(options: argparse.Namespace, console: Console) -> tuple[WheelPair, ...]:
    """Return the wheelsets of the rows with measured wheels, and print what is left out."""
    if options.measured is None:
        return ()
    template = load_scenario(SCENARIOS / f"{world_measured.ROWS[0]}.toml")
    found = world_measured.measured_wheels(options.measured, with_seed(template, 0).section)
    console.print(f"{len(found.pairs)} wheelsets of measured wheels", highlight=False)
    for line in found.left_out:
        console.print(f"left out: {line}", highlight=False)
    return found.pairs


def run_case(row: str, seed: int, keep: Path | None, wheels: tuple[WheelPair, ...] = ()) -> dict[str, Any]:
    """Return the score of a row for one seed; runs in a process of its own.

    Args:
        keep: Folder that keeps recordings; None for none.
    """
    from bench.world_case import score  # noqa: PLC0415 - compiled code is loaded where it runs

    scenario, left_out = scenario_of(row, seed, wheels)
    with tempfile.TemporaryDirectory(prefix="treadwatch-world-") as folder:
        found = score(scenario, keep or Path(folder) / "recordings", Path(folder) / "data").as_json()
    return found | {"left_out": left_out}


def scenario_of(row: str, seed: int, wheels: tuple[WheelPair, ...] = ()) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario of a row for one seed, and the measured wheelsets that cannot run in it."""
    scenario = with_seed(load_scenario(SCENARIOS / f"{row}.toml"), seed)
    return world_measured.with_wheels(scenario, wheels) if row in world_measured.ROWS else (scenario, ())


def _line(case: Mapping[str, Any]) -> str:
    errors, (covered, published), _ = figures([case])
    error = f"error {np.median(errors):.4f}, {covered} of {published} cover" if errors else "nothing published"
    return f"{case['survey'] or 'no survey'}, {error}, {case['seconds']:.0f} s {case['reason'][:60]}"


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench world", description=__doc__)
    parser.add_argument("--seeds", type=seed_range, default=[0], help="as in 0-19 or 3 (default: 0)")
    parser.add_argument("--rows", type=_rows, default=None, help="names, with commas between (default: all)")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--keep", type=Path, default=None, help="folder that keeps recordings")
    parser.add_argument("--out", type=Path, default=Path("world.json"))
    parser.add_argument("--resume", action="store_true", help="go on with the results in --out")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/world.md")
    parser.add_argument("--measured", type=Path, default=None, help="folder of measured wheels, for two rows more")
    options = parser.parse_args(arguments)
    without = [row for row in ROWS if row not in world_measured.ROWS]
    options.rows = options.rows or (without if options.measured is None else list(ROWS))
    if options.measured is None and not set(options.rows) <= set(without):
        parser.error(f"{', '.join(world_measured.ROWS)} need --measured")
    return options


def seed_range(text: str) -> list[int]:
    """Return the seeds of ``0-19`` or ``3``."""
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def _rows(text: str) -> list[str]:
    names = text.split(",")
    unknown = [name for name in names if name not in ROWS]
    if unknown:
        raise argparse.ArgumentTypeError(f"no row {', '.join(unknown)}; there are {', '.join(ROWS)}")
    return names
