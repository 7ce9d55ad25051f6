"""The parts of the chaos run, its command ``python -m bench chaos``, and its page ``docs/results/chaos.md``."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from bench.report import COLUMNS, RESULTS, BenchRow, ResultTable, ended, machine, say

TITLE = "# What operation does to the product"


@dataclass(frozen=True, slots=True)
class ChaosSettings:
    """How a part runs: its number of rounds, kills, files or connections; the seed of all that is drawn; a folder."""

    size: int
    seed: int
    folder: Path  # empty, of its own


@dataclass(frozen=True, slots=True)
class ChaosPart:
    """A part of the chaos run: its module's ``rows`` yield what was measured beside what is to be reached."""

    name: str
    summary: str
    size: int  # of the full run
    short: int  # of the form that the tests run

    @property
    def rows(self) -> Callable[[ChaosSettings], Iterator[BenchRow]]:
        """What runs it; it imports what it needs only then."""
        found: Callable[[ChaosSettings], Iterator[BenchRow]] = import_module(f"bench.chaos.{self.name}").rows
        return found


PARTS = (
    ChaosPart("kills", "ingest, estimate, schedule and serve killed while recordings come in", 500, 4),
    ChaosPart("ingests", "two to eight ingests of one vehicle at once, on both databases", 100, 2),
    ChaosPart("outages", "the database away for 1 s to 5 min, disks that are full", 8, 1),
    ChaosPart("clock", "the clock of the server 400 days ahead or an hour behind for a while", 4, 1),
    ChaosPart("live", "a live receiver is killed, also without its database, its disk is full", 100, 1),
    ChaosPart("connections", "clients that open connections and do not use them", 1000, 300),
    ChaosPart("mutations", "log files are damaged, so many of each format, and read", 100_000, 40),
    ChaosPart("workers", "many workers are killed, stopped, cut off from the database", 60, 3),
    ChaosPart("behind", "chunks that nobody decodes, a bus without its database, for up to an hour", 60, 1),
    ChaosPart("orders", "windows in any order and in pieces, half of the rounds with late ones", 200, 2),
    ChaosPart("registry", "mistakes in the registry, made at random and corrected", 50, 2),
)


def main(arguments: Sequence[str]) -> int:
    """Run the parts that are named, or all; return 1 when a row falls short."""
    names = [part.name for part in PARTS]
    parser = argparse.ArgumentParser("python -m bench chaos", description="Do to the product what operation does.")
    parser.add_argument("part", nargs="*", choices=[*names, []], help=f"default: all of {', '.join(names)}")
    parser.add_argument("--size", type=int, help="rounds, kills, files or connections of each part; default: its own")
    parser.add_argument("--short", action="store_true", help="the sizes that the tests run")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write-docs", action="store_true", help="write their sections of docs/results/chaos.md too")
    options = parser.parse_args(arguments)
    cells = []
    for part in (part for part in PARTS if not options.part or part.name in options.part):
        size, begin = options.size or (part.short if options.short else part.size), time.monotonic()
        say(f"{part.name}: {part.summary}")
        rows = []
        with tempfile.TemporaryDirectory(prefix=f"treadwatch-chaos-{part.name}-") as folder:
            for row in part.rows(ChaosSettings(size, options.seed, Path(folder))):
                say(f"  {row.what}: {row.measured}")
                rows.append(row.cells)
        cells += [(part.name, *row) for row in rows]
        if options.write_docs:
            command = f"python -m bench chaos {part.name} --size {size} --seed {options.seed} --write-docs"
            say(f"wrote {write_section(part.name, part.summary, command, time.monotonic() - begin, rows)}")
    return ended([ResultTable(("part", *COLUMNS), cells)], "chaos", "", None)


def write_section(
    name: str, summary: str, command: str, seconds: float, cells: Sequence[Sequence[str]], folder: Path = RESULTS
) -> Path:
    """Put what a part measured in its section of the page, in place of what it measured before; return the page."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "chaos.md"
    sections = dict(_sections(path.read_text(encoding="utf-8"))) if path.exists() else {}
    head = f"Written by `{command}` in {seconds:.0f} s: {machine()}."
    body = [f"{summary[0].upper()}{summary[1:]}.", head, ResultTable(COLUMNS, cells).markdown()]
    sections[name] = "\n\n".join(body)
    bodies = (f"## {name}\n\n{sections[name]}" for name in sorted(sections))
    page = "\n\n".join([TITLE, "Each section was written by the command in it.", *bodies])
    path.write_text(f"{page}\n", encoding="utf-8")
    return path


def _sections(page: str) -> Mapping[str, str]:
    parts = (text.partition("\n") for text in page.split("\n## ")[1:])
    return {name.strip(): body.strip() for name, _, body in parts}
