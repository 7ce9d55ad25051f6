"""Lateral dampers: ``python -m bench dampers [--seeds 0-4] [--rows "coach"] [--resume] [--write-docs]``.

Every seed is a vehicle off its class, with dampers of a known share (``dampers_case``). Results are written as JSON
after every vehicle, so that nothing is lost on the way.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.dampers_case import ROWS, SHARES, scores
from bench.dampers_table import HEADER, TITLE, bad_table, bench_rows, page_body, table
from bench.results_page import write_page
from bench.world import seed_range


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    options = _options(arguments)
    console = Console(width=None if Console().is_terminal else 200)
    found: list[dict[str, Any]] = json.loads(options.out.read_text()) if options.resume and options.out.exists() else []
    _run(options, found, console)
    for cells in (HEADER, *table(found), *bad_table(found)):
        console.print("  ".join(cells), highlight=False, soft_wrap=True)
    rows = list(bench_rows(found))
    for row in rows:
        console.print("  ".join(row.cells), highlight=False, soft_wrap=True)
    if options.write_docs:
        page = write_page("dampers", TITLE, "python -m bench dampers --write-docs", page_body(found))
        console.print(f"wrote {page}", highlight=False)
    return 0 if all(row.met for row in rows) else 1


def _run(options: argparse.Namespace, found: list[dict[str, Any]], console: Console) -> None:
    have = {(one["row"], one["seed"], one["share"]) for one in found}
    for seed in options.seeds:
        for row in options.rows:
            for share in SHARES:
                if (row, seed, share) in have:
                    continue
                found.extend(one.as_json() for one in scores(row, seed, share))
                options.out.write_text(json.dumps(found), encoding="utf-8")
            console.print(f"{row}, seed {seed}: done", highlight=False)


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench dampers", description=__doc__)
    parser.add_argument("--seeds", type=seed_range, default=list(range(5)), help="as in 0-19 or 3 (default: 0-4)")
    parser.add_argument("--rows", type=_rows, default=list(ROWS), help="; ".join(ROWS))
    parser.add_argument("--out", type=Path, default=Path("dampers.json"))
    parser.add_argument("--resume", action="store_true", help="go on with the results in --out")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/dampers.md")
    return parser.parse_args(arguments)


def _rows(text: str) -> list[str]:
    chosen = [name.strip() for name in text.split(";")]
    if not set(chosen) <= set(ROWS):
        raise argparse.ArgumentTypeError(f"{text!r}: there are {'; '.join(ROWS)}")
    return chosen
