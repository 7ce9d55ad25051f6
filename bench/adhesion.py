"""Creep forces and friction: ``python -m bench adhesion [--seeds 0-2] [--rows low,...] [--out FILE] [--write-docs]``.

Every row is a scenario file in ``bench/adhesion_scenarios``; every seed of it is simulated and estimated by the pure
functions that the jobs use (``adhesion_case``). ``wrong_file`` stands for the rows of ``adhesion_wrong``,
``quiet_rows`` for those of ``adhesion_quiet``. Results are appended to ``--out`` after every case, a line of JSON each,
and what is there is not run again. The passes of each case stay in ``--sums``: ``--again`` pools them, which judges a
change of pooling or decision in seconds.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from bench.adhesion_quiet import QUIET, as_seen, quiet_scenario
from bench.adhesion_stored import path_of, read_passes, write_passes
from bench.adhesion_table import CHOICE_COLUMNS, FRICTION_COLUMNS, choice_rows, friction_rows, summary
from bench.adhesion_wrong import OF, ONE, WRONG, as_on_file, first_vehicle, with_others
from bench.report import BenchRow
from bench.results_page import markdown_table, write_page
from bench.world import seed_range
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario_file import load_scenario

SCENARIOS = Path(__file__).parent / "adhesion_scenarios"
FILES = tuple(sorted({path.stem for path in SCENARIOS.glob("*.toml")} - set(QUIET)))
ROWS = (*FILES, *QUIET, *WRONG, *ONE)  # a row of one vehicle comes behind those that it is put together from
GROUPS = {"wrong_file": (*WRONG, *ONE), "quiet_rows": tuple(QUIET)}
TITLE = "Creep forces and friction"
COLUMNS = ("what", "measured", "reach", "met")


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    options = _options(arguments)
    console = Console(width=None if Console().is_terminal else 200)
    cases = _stored(options.out)
    if options.again:
        cases = _again(cases, options.sums)
    elif not options.print_only:
        _run(options, cases, console)
    rows = summary(cases)
    tables: tuple[tuple[Sequence[str], Sequence[tuple[str, ...]]], ...] = (
        (COLUMNS, _cells(rows)),
        (FRICTION_COLUMNS, friction_rows(cases)),
        (CHOICE_COLUMNS, choice_rows(cases)),
    )
    for header, cells in tables:
        table = Table(*header, show_lines=True)
        for row in cells:
            table.add_row(*row)
        console.print(table)
    if options.write_docs:
        body = [markdown_table(header, cells) for header, cells in tables]
        console.print(f"wrote {write_page('adhesion', TITLE, 'python -m bench adhesion --write-docs', body)}")
    return 0 if all(row.met for row in rows) else 1


def _cells(rows: Sequence[BenchRow]) -> list[tuple[str, ...]]:
    return [(row.what, row.measured, row.reach, "yes" if row.met else "NO") for row in rows]


def _stored(path: Path) -> list[dict[str, Any]]:
    if not path.exists():
        return []
    found = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return list({(case["row"], case["seed"]): case for case in found}.values())


def _run(options: argparse.Namespace, cases: list[dict[str, Any]], console: Console) -> None:
    have = {(case["row"], case["seed"]) for case in cases}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    for seed in options.seeds:
        for made in _cases([row for row in options.rows if (row, seed) not in have], seed, options.sums):
            case = json.loads(json.dumps(made))
            cases.append(case)
            with options.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(case) + "\n")
            found = f"{sum(case['found'])} of {len(case['found'])} stretches, {len(case['alarms'])} alarms"
            console.print(f"{case['row']} seed {seed}: {found}", highlight=False)


def _cases(rows: Sequence[str], seed: int, sums: Path) -> Iterator[dict[str, Any]]:
    """Yield the cases of rows for a seed; a scenario that rows share is simulated once."""
    from bench.adhesion_case import score, vehicle_km  # noqa: PLC0415 - compiled code is loaded where it runs
    from bench.adhesion_fleet import simulate  # noqa: PLC0415 - as above

    for row in rows:
        if row in QUIET:
            quiet = as_seen(simulate(with_seed(quiet_scenario(SCENARIOS, QUIET[row]), seed)), QUIET[row])
            yield score(quiet, row, sums, left_out_too=False).as_json()
    for file in FILES:
        own = [row for row in rows if row == file or (file == OF and row in WRONG | ONE)]
        if not own:
            continue
        fleet = simulate(with_seed(load_scenario(SCENARIOS / f"{file}.toml"), seed))
        for row in own:
            if row in ONE:
                case = score(as_on_file(first_vehicle(fleet), ONE[row]), row, sums, left_out_too=False).as_json()
                yield case | _with_others(row, seed, sums) | {"vehicle_km": vehicle_km(fleet)}
            else:
                seen = as_on_file(fleet, WRONG[row]) if row in WRONG else fleet
                yield score(seen, row, sums, left_out_too=row == file).as_json()


def _with_others(row: str, seed: int, sums: Path) -> dict[str, Any]:
    """Return the friction of a fleet whose first vehicle alone is wrong; keep its passes in place of that vehicle's."""
    from bench.adhesion_friction import judge  # noqa: PLC0415 - as above

    own, right = path_of(sums, row, seed), path_of(sums, OF, seed)
    if not right.exists():
        raise SystemExit(f"row {row} needs row {OF} of seed {seed}")
    stored = with_others(read_passes(own), read_passes(right))
    write_passes(own, stored)
    return asdict(judge(stored))


def _again(cases: Sequence[dict[str, Any]], sums: Path) -> list[dict[str, Any]]:
    """Return the cases with the friction that their stored passes give now."""
    from bench.adhesion_friction import judge  # noqa: PLC0415 - as above

    done = []
    for case in cases:
        path = path_of(sums, case["row"], case["seed"])
        done.append(case | asdict(judge(read_passes(path))) if path.exists() else case)
    return done


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench adhesion", description=__doc__)
    parser.add_argument("--seeds", type=seed_range, default=[0], help="as in 0-19 or 3 (default: 0)")
    parser.add_argument("--rows", type=_rows, default=list(ROWS), help="names, with commas between (default: all)")
    parser.add_argument("--out", type=Path, default=Path("bench-results/adhesion.jsonl"), help="lines of JSON")
    parser.add_argument("--sums", type=Path, default=Path("bench-results/adhesion-sums"), help="folder of the passes")
    parser.add_argument("--again", action="store_true", help="run no case, pool the passes of those in --out again")
    parser.add_argument("--print-only", action="store_true", help="print the tables of what --out holds")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/adhesion.md")
    return parser.parse_args(arguments)


def _rows(text: str) -> list[str]:
    names = [name for word in text.split(",") for name in GROUPS.get(word, (word,))]
    unknown = [name for name in names if name not in ROWS]
    if unknown:
        raise argparse.ArgumentTypeError(f"no row {', '.join(unknown)}; there are {', '.join((*ROWS, *GROUPS))}")
    return names
