"""Wheel and rail apart, over several sections: ``python -m bench rails [--seeds 0-19] [--keep FOLDER] ...``.

Every seed is a fleet of 12 wheelsets on four surveyed sections (``rails_sections``): simulated, ingested and estimated
by the scheduled jobs; with ``--kinds drawn`` on vehicles and creep that are off from those on file, with ``trend`` on
rails that wear over years. Results are written as JSON after every seed, so that nothing is lost on the way.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.rails_table import KINDS, TABLES, TITLE, page_body, terminal_tables
from bench.results_page import write_page
from estimation.errors import ScenarioError


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    options = _options(arguments)
    console = Console(width=None if Console().is_terminal else 200)
    results: dict[str, Any] = {kind: [] for kind in KINDS} | {"derailed": []}
    if options.resume and options.out.exists():
        results |= json.loads(options.out.read_text())
    with tempfile.TemporaryDirectory(prefix="treadwatch-rails-") as folder:
        _run(options, results, options.keep or Path(folder), console)
    for table in terminal_tables(results):
        console.print(table)
    if options.write_docs:
        page = write_page("rails", TITLE, "python -m bench rails --write-docs", page_body(results))
        console.print(f"wrote {page}", highlight=False)
    return 0 if all(row[-1] != "NO" for row in TABLES[0].rows(results)) else 1


def _run(options: argparse.Namespace, results: dict[str, Any], cache: Path, console: Console) -> None:
    for kind in options.kinds:
        have = {case["seed"] for case in results[kind]} | {seed for of, seed in results["derailed"] if of == kind}
        for seed in sorted(set(options.seeds) - have):
            began = time.perf_counter()
            try:
                results[kind] += _scores(kind, seed, cache)
            except ScenarioError as error:  # a wheelset climbs a rail: no railway runs it
                results["derailed"].append([kind, seed])
                console.print(f"{kind} {seed}: {error}", highlight=False)
                continue
            finally:
                options.out.write_text(json.dumps(results), encoding="utf-8")
            console.print(f"{kind} {seed}: {time.perf_counter() - began:.0f} s", highlight=False)


def _scores(kind: str, seed: int, cache: Path) -> list[dict[str, Any]]:
    from bench.rails_case import score  # noqa: PLC0415 - compiled code is loaded where it runs
    from bench.rails_trend import score_trend  # noqa: PLC0415 - the same

    return [score_trend(seed, cache)] if kind == "trend" else score(seed, cache, drawn=kind == "drawn")


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench rails", description=__doc__)
    parser.add_argument("--seeds", type=_seeds, default=[0], help="as in 0-19 or 3 (default: 0)")
    parser.add_argument("--kinds", type=lambda text: text.split(","), default=list(KINDS), help=", ".join(KINDS))
    parser.add_argument("--keep", type=Path, default=None, help="folder that keeps recordings and deployments")
    parser.add_argument("--out", type=Path, default=Path("rails.json"))
    parser.add_argument("--resume", action="store_true", help="go on with the results in --out")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/rails.md")
    return parser.parse_args(arguments)


def _seeds(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))
