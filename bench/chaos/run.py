"""The command ``python -m bench chaos``."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from bench.chaos.catalogue import parts
from bench.chaos.part import ChaosPart, ChaosSettings
from bench.report import BenchRow
from bench.results_page import markdown_table, write_page

COLUMNS = ("part", "what", "measured", "reach", "met")


def main(arguments: Sequence[str]) -> int:
    """Run the parts that are named, or all; return 1 when a row falls short.

    Parameters
    ----------
    arguments
        Of the command line.
    """
    options = _options(arguments)
    chosen = [part for part in parts() if not options.part or part.name in options.part]
    console, cells = Console(), []
    for part in chosen:
        console.print(f"{part.name}: {part.summary}", highlight=False, soft_wrap=True)
        for row in _rows(part, options):
            console.print(f"  {row.what}: {row.measured}", highlight=False, soft_wrap=True)
            cells.append((part.name, row.what, row.measured, row.reach, "yes" if row.met else "NO"))
    table = Table(*COLUMNS, title="treadwatch chaos", title_justify="left", show_lines=True)
    for line in cells:
        table.add_row(*line)
    console.print(table)
    if options.write_docs:
        command = "python -m bench chaos --write-docs"
        page = write_page("chaos", "What operation does to the product", command, [markdown_table(COLUMNS, cells)])
        console.print(f"wrote {page}", highlight=False, soft_wrap=True)
    return 1 if any(line[-1] == "NO" for line in cells) else 0


def _rows(part: ChaosPart, options: argparse.Namespace) -> Iterator[BenchRow]:
    size = options.size or (part.short if options.short else part.size)
    with tempfile.TemporaryDirectory(prefix=f"treadwatch-chaos-{part.name}-") as folder:
        yield from part.rows(ChaosSettings(size, options.seed, Path(folder)))


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    names = [part.name for part in parts()]
    parser = argparse.ArgumentParser("python -m bench chaos", description="Do to the product what operation does.")
    parser.add_argument("part", nargs="*", choices=[*names, []], help=f"default: all of {', '.join(names)}")
    parser.add_argument("--size", type=int, help="rounds, kills, files or connections of each part; default: its own")
    parser.add_argument("--short", action="store_true", help="the sizes that the tests run")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/chaos.md too")
    return parser.parse_args(arguments)
