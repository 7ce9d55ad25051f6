"""Run the benchmarks and print one table: ``python -m bench [name ...]``; some have options of their own.

``--write-docs`` also writes ``docs/results/<name>.md`` for every bench that ran.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module

os.environ.setdefault("TREADWATCH_ACCESS", "open")  # the services of the bench are on loopback
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

from rich.console import Console
from rich.table import Table

from bench.report import COLUMNS, BenchRow
from bench.results_page import markdown_table, write_page

NAMES = ("contact", "estimation", "recursion", "decoding", "simulator", "trend", "en15302")
WITH_OPTIONS = (
    "section",
    "world",
    "signatures",
    "vehicles",
    "refusals",
    "mutants",
    "house",
    "chaos",
    "api",
    "feed",
    "page",
    "pools",
    "workers",
    "chunks",
    "pipeline",
    "sustained",
    "fleet_sizes",
    "rivals",
    "section_runs",
    "fleet",
    "adhesion",
    "rails",
    "dampers",
    "steps",
    "limits",
    "flats",
    "surveys",
    "statements",
)
LONG = (
    "signals",
    "curves",
    "mounting",
    "window_files",
    "stored",
    "partitions",
    "new_window",
    "trend_versions",
    "idle",
    "logs",
)  # of many minutes, run where they are named
TITLES = {
    "contact": "Contact geometry against EN 15302",
    "estimation": "Accuracy on known track",
    "recursion": "Merged sums against a recursive filter",
    "decoding": "Decoding against cantools and python-can",
    "simulator": "Speed of the simulator",
    "trend": "Coverage of trend and forecast",
    "en15302": "Conicity of wheelsets in motion against EN 15302",
    "signals": "Motion signals, by course and cutoff wavelength",
    "curves": "Cost of curves that are not on file",
    "mounting": "Sensors that are turned",
    "window_files": "Formats of window files",
    "stored": "Bytes of a wheelset and year",
    "partitions": "Bin tables as partitions by month",
    "new_window": "One new window after a year",
    "trend_versions": "A trend with the versions of a year",
    "idle": "A run of all jobs with nothing new",
    "logs": "Log files to decoded arrays",
}


def main() -> int:
    """Run what was asked for, or all; return 1 when a row falls short."""
    if len(sys.argv) > 1 and sys.argv[1] in WITH_OPTIONS:
        return int(import_module(f"bench.{sys.argv[1]}").main(sys.argv[2:]))
    options = _options()
    console = Console()
    table = Table(*COLUMNS, title="treadwatch bench", title_justify="left", show_lines=True)
    short = 0
    for name in options.name or NAMES:
        run: Callable[[], Iterator[BenchRow]] = import_module(f"bench.{name}").rows
        rows = []
        for row in run():
            console.print(f"{row.what}: {row.measured}", highlight=False, soft_wrap=True)
            rows.append(row.cells)
            short += not row.met
        for cells in rows:
            table.add_row(*cells)
        if options.write_docs:
            console.print(f"wrote {_write(name, rows)}", highlight=False, soft_wrap=True)
    console.print(table)
    return 1 if short else 0


def _write(name: str, rows: Sequence[Sequence[str]]) -> str:
    command = f"python -m bench {name} --write-docs"
    return str(write_page(name, TITLES[name], command, [markdown_table(COLUMNS, rows)]))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser("python -m bench", description="Print accuracy and speed beside what is wanted.")
    parser.add_argument(
        "name",
        nargs="*",
        type=_name,
        metavar="name",
        help=f"default: {', '.join(NAMES)}; of many minutes: {', '.join(LONG)};"
        f" with options of their own: {', '.join(WITH_OPTIONS)}",
    )
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/NAME.md for each of them too")
    return parser.parse_args()


def _name(text: str) -> str:
    if text not in (*NAMES, *LONG):
        raise argparse.ArgumentTypeError(f"{text!r} is none of {', '.join((*NAMES, *LONG))}")
    return text


if __name__ == "__main__":
    sys.exit(main())
