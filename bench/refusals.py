"""Right vehicles that are refused, and wrong ones that are not: ``python -m bench refusals [--seeds 0-199] ...``.

Every seed draws a vehicle over sensors, vibration, profiles, speed, arrangement, track and survey
(``refusals_case``), and judges it as it is, every third one also wrong in several ways (``refusals_judged``), by the
functions that the jobs call. Results are appended to ``--out`` after every seed, a line of JSON each wheelset, and what
is there is not run again. ``--seeds 0-29`` is a quick look; the figures that decide take 300 wheelsets.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.refusals_table import TITLE, page_body, rows_met, tables
from bench.results_page import write_page
from bench.world import seed_range

CAMPAIGNS = 3  # of two minutes: 6 windows
WRONG_EVERY = 3  # seeds that are also judged wrong on file: right ones are more, and cheaper
SKIPPED = "skipped"  # of a seed whose wheelsets derail or hunt off the contact table: no right vehicle


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    options = _options(arguments)
    console = Console(width=None if Console().is_terminal else 200)
    found = stored(options.out)
    if not options.print_only:
        done = {one["seed"] for one in found}
        options.out.parent.mkdir(parents=True, exist_ok=True)
        for seed in options.seeds:
            if seed not in done:
                lines = run_seed(seed, options.campaigns, options.wrong_every)
                found += lines
                with options.out.open("a", encoding="utf-8") as file:
                    file.writelines(json.dumps(line) + "\n" for line in lines)
                console.print(_line(lines), highlight=False)
    for table in tables(found):
        console.print(table)
    if options.write_docs:
        seeds = [one["seed"] for one in found]
        command = f"python -m bench refusals --seeds {min(seeds)}-{max(seeds)} --write-docs"
        page = write_page("refusals", TITLE, command, page_body(found))
        console.print(f"wrote {page}", highlight=False)
    return 0 if rows_met(found) else 1


def stored(path: Path) -> list[dict[str, Any]]:
    """Return the wheelsets of a file of results; none where there is no file."""
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def run_seed(seed: int, campaigns: int, wrong_every: int) -> list[dict[str, Any]]:
    """Return what is said of the wheelsets of a seed, right and wrong on file.

    Args:
        seed: From 0.
        wrong_every: Seeds by one of which it is also judged wrong on file.
    """
    from bench.refusals_case import drawn_case, simulated  # noqa: PLC0415 - compiled code is loaded where it runs
    from bench.refusals_judged import IN_BOGIES, OnFile, judged  # noqa: PLC0415
    from estimation.errors import TreadwatchError  # noqa: PLC0415

    try:
        case = simulated(seed, campaigns)
    except TreadwatchError:
        return [{"seed": seed, "kind": SKIPPED, "drawn": drawn_case(seed)}]
    in_bogie = case.vehicle_class.bogie is not None
    return [
        {
            "seed": seed,
            "kind": str(kind),
            "drawn": dict(case.drawn),
            "published": one.published,
            "withheld": one.withheld,
            "doubted": one.doubted,
            "code": one.code,
            "errors": one.errors,
            "covered": one.covered,
            "axle": axle,
            "values": one.values,
            "radius": one.radius,
        }
        for kind in OnFile
        if kind is OnFile.RIGHT or (seed % wrong_every == 0 and (in_bogie or kind not in IN_BOGIES))
        for axle, one in enumerate(judged(case, kind))
    ]


def _line(lines: Sequence[dict[str, Any]]) -> str:
    first = lines[0]
    said = ", ".join(f"{one['kind']}: {one['code'] or 'good'}" for one in lines if one["kind"] != SKIPPED)
    return f"seed {first['seed']}: {', '.join(first['drawn'].values())}; {said or SKIPPED}"


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench refusals", description=__doc__)
    parser.add_argument("--seeds", type=seed_range, default=list(range(30)), help="as in 0-199 or 3 (default: 0-29)")
    parser.add_argument("--campaigns", type=int, default=CAMPAIGNS, help=f"of two minutes (default: {CAMPAIGNS})")
    parser.add_argument("--wrong-every", type=int, default=WRONG_EVERY, help=f"seeds (default: {WRONG_EVERY})")
    parser.add_argument("--out", type=Path, default=Path("bench-results/refusals.jsonl"), help="lines of JSON")
    parser.add_argument("--print-only", action="store_true", help="print the tables of what --out holds")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/refusals.md")
    return parser.parse_args(arguments)
