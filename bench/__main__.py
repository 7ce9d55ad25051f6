"""Run the benchmarks and print one table: ``python -m bench [name ...]``; some have options of their own."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from importlib import import_module

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

from rich.console import Console
from rich.table import Table

from bench.report import BenchRow

NAMES = ("contact", "estimation", "recursion", "decoding", "simulator")
WITH_OPTIONS = ("section", "mutants", "house")
LONG = ("signals", "curves", "window_files")  # of many minutes, run where they are named


def main() -> int:
    """Run what was asked for, or all; return 1 when a row falls short."""
    if len(sys.argv) > 1 and sys.argv[1] in WITH_OPTIONS:
        return int(import_module(f"bench.{sys.argv[1]}").main(sys.argv[2:]))
    wanted = _names() or NAMES
    console = Console()
    table = Table("what", "measured", "reach", "met", title="treadwatch bench", title_justify="left", show_lines=True)
    short = 0
    for name in wanted:
        rows: Callable[[], Iterator[BenchRow]] = import_module(f"bench.{name}").rows
        for row in rows():
            console.print(f"{row.what}: {row.measured}", highlight=False, soft_wrap=True)
            table.add_row(row.what, row.measured, row.reach, "yes" if row.met else "NO")
            short += not row.met
    console.print(table)
    return 1 if short else 0


def _names() -> list[str]:
    parser = argparse.ArgumentParser("python -m bench", description="Print accuracy and speed beside what is wanted.")
    parser.add_argument(
        "name",
        nargs="*",
        type=_name,
        metavar="name",
        help=f"default: {', '.join(NAMES)}; of many minutes: {', '.join(LONG)};"
        f" with options of their own: {', '.join(WITH_OPTIONS)}",
    )
    names: list[str] = parser.parse_args().name
    return names


def _name(text: str) -> str:
    if text not in (*NAMES, *LONG):
        raise argparse.ArgumentTypeError(f"{text!r} is none of {', '.join((*NAMES, *LONG))}")
    return text


if __name__ == "__main__":
    sys.exit(main())
