"""The command ``python -m bench chaos``."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from bench.chaos.catalogue import parts
from bench.chaos.page import COLUMNS as PAGE_COLUMNS
from bench.chaos.page import write_section
from bench.chaos.part import ChaosPart, ChaosSettings
from bench.report import BenchRow

COLUMNS = ("part", *PAGE_COLUMNS)


def main(arguments: Sequence[str]) -> int:
    """Run the parts that are named, or all; return 1 when a row falls short."""
    options = _options(arguments)
    chosen = [part for part in parts() if not options.part or part.name in options.part]
    console, cells = Console(), []
    for part in chosen:
        console.print(f"{part.name}: {part.summary}", highlight=False, soft_wrap=True)
        begin, of_part = time.monotonic(), []
        for row in _rows(part, options):
            console.print(f"  {row.what}: {row.measured}", highlight=False, soft_wrap=True)
            of_part.append((row.what, row.measured, row.reach, "yes" if row.met else "NO"))
        cells += [(part.name, *line) for line in of_part]
        if options.write_docs:
            taken_s = time.monotonic() - begin
            page = write_section(part.name, part.summary, _command(part, options), taken_s, of_part)
            console.print(f"wrote {page}", highlight=False, soft_wrap=True)
    table = Table(*COLUMNS, title="treadwatch chaos", title_justify="left", show_lines=True)
    for line in cells:
        table.add_row(*line)
    console.print(table)
    return 1 if any(line[-1] == "NO" for line in cells) else 0


def _size(part: ChaosPart, options: argparse.Namespace) -> int:
    return int(options.size or (part.short if options.short else part.size))


def _command(part: ChaosPart, options: argparse.Namespace) -> str:
    return f"python -m bench chaos {part.name} --size {_size(part, options)} --seed {options.seed} --write-docs"


def _rows(part: ChaosPart, options: argparse.Namespace) -> Iterator[BenchRow]:
    with tempfile.TemporaryDirectory(prefix=f"treadwatch-chaos-{part.name}-") as folder:
        yield from part.rows(ChaosSettings(_size(part, options), options.seed, Path(folder)))


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    names = [part.name for part in parts()]
    parser = argparse.ArgumentParser("python -m bench chaos", description="Do to the product what operation does.")
    parser.add_argument("part", nargs="*", choices=[*names, []], help=f"default: all of {', '.join(names)}")
    parser.add_argument("--size", type=int, help="rounds, kills, files or connections of each part; default: its own")
    parser.add_argument("--short", action="store_true", help="the sizes that the tests run")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write-docs", action="store_true", help="write their sections of docs/results/chaos.md too")
    return parser.parse_args(arguments)
