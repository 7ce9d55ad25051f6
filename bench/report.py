"""What benches print and write: rows and tables on the terminal, and the same on pages in ``docs/results``."""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from bench.coverage import Verdict, verdict_of

RESULTS = Path(__file__).parents[1] / "docs" / "results"
LIBRARIES = ("numpy", "scipy")
COLUMNS = ("what", "measured", "reach", "met")


@dataclass(frozen=True, slots=True)
class BenchRow:
    """What was measured, what it gave, what was to be reached, and whether it was."""

    what: str
    measured: str
    reach: str
    met: bool | Verdict

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """As text, for a table of the columns ``COLUMNS``."""
        return self.what, self.measured, self.reach, verdict_of(self.met)


Columns = Mapping[str, Callable[..., str]]
"""What makes the cell of each column from the values that a row is made of."""


@dataclass(frozen=True, slots=True)
class ResultTable:
    """A table of results; ``right`` numbers the columns that are set flush right."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    right: Iterable[int] = ()
    title: str = ""

    @classmethod
    def of(
        cls, columns: Columns, groups: Iterable[Sequence[Any]], right: Iterable[int] = (), title: str = ""
    ) -> ResultTable:
        """Return a table whose cells are made column by column from what belongs to each row."""
        rows = [tuple(cell(*group) for cell in columns.values()) for group in groups]
        return cls(tuple(columns), rows, right, title)

    @property
    def met(self) -> bool:
        """Whether no row falls short, where the table has a column "met"."""
        return "met" not in self.header or all(row[self.header.index("met")] != Verdict.NO for row in self.rows)

    def terminal(self) -> Table:
        """Return the table for a terminal."""
        table = Table(*self.header, title=self.title or None, title_justify="left", show_lines=self.header == COLUMNS)
        for row in self.rows:
            table.add_row(*row)
        return table

    def markdown(self) -> str:
        """Return the table in Markdown, below its title."""
        right = set(self.right)
        rule = ["---:" if column in right else "---" for column in range(len(self.header))]
        cells = [[cell.replace("|", "\\|") for cell in row] for row in (self.header, rule, *self.rows)]
        lines = "\n".join(f"| {' | '.join(row)} |" for row in cells)
        return f"{self.title}.\n\n{lines}" if self.title else lines


Part = str | ResultTable
"""A paragraph, which the page alone has, or a table."""


def row_table(rows: Iterable[BenchRow]) -> ResultTable:
    """Return rows as a table."""
    return ResultTable(COLUMNS, [row.cells for row in rows])


def printed(rows: Iterable[BenchRow]) -> list[BenchRow]:
    """Print each row as soon as it is there, and return all of them."""
    every = []
    for row in rows:
        say("  ".join(row.cells))
        every.append(row)
    return every


def say(line: str) -> None:
    """Print a line as it is."""
    Console().print(line, highlight=False, soft_wrap=True)


def ended(parts: Iterable[Part], name: str, title: str, command: str | None) -> int:
    """Print the tables, write the page where a command is given that does so; return 1 where a row falls short."""
    parts = list(parts)
    tables = [part for part in parts if isinstance(part, ResultTable)]
    console = Console(width=None if Console().is_terminal else 200)
    for table in tables:
        console.print(table.terminal())
    if command is not None:
        say(f"wrote {write_page(name, title, command, parts)}")
    return 0 if all(table.met for table in tables) else 1


Options = Mapping[str, tuple[Any, str] | tuple[Any, str, Sequence[str]]]
"""Default, help and perhaps choices of each option; a list takes several values."""


def _options(bench: str, about: str, known: Options, arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=f"python -m bench {bench}", description=about)
    for name, (default, words, *choices) in known.items():
        several = isinstance(default, list)
        kind, count = type(default[0] if several else default), "+" if several else None
        chosen = choices[0] if choices else None
        parser.add_argument(
            f"--{name}", type=kind, nargs=count, default=default, choices=chosen, help=f"{words} ({default})"
        )
    parser.add_argument("--write-docs", action="store_true", help=f"write docs/results/{bench}.md too")
    return parser.parse_args(arguments)


@dataclass(frozen=True, slots=True)
class Bench:
    """A bench that measures once, in an empty folder."""

    name: str
    title: str
    about: str
    parts: Callable[[argparse.Namespace, Path], Iterable[Part]]
    options: Options = field(default_factory=dict)

    def run(self, arguments: Sequence[str]) -> int:
        """Measure, print, and return 1 where a row falls short."""
        options = _options(self.name, self.about, self.options, arguments)
        with tempfile.TemporaryDirectory(prefix=f"treadwatch-{self.name}-") as folder:
            parts = list(self.parts(options, Path(folder)))
        command = " ".join(["python -m bench", self.name, *arguments]) if options.write_docs else None
        return ended(parts, self.name, self.title, command)


Rows = Callable[[argparse.Namespace, Path], Iterable[BenchRow]]


def row_bench(name: str, title: str, about: str | None, rows: Rows, options: Options | None = None) -> Bench:
    """Return a bench of rows that are printed as soon as they are there."""
    return Bench(name, title, about or "", lambda *given: [row_table(printed(rows(*given)))], options or {})


def write_page(name: str, title: str, command: str, parts: Iterable[Part], folder: Path = RESULTS) -> Path:
    """Write the page of results ``name``, and return its path; its folder is made if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    head = f"Written by `{command}`: {machine()}."
    body = [part if isinstance(part, str) else part.markdown() for part in parts]
    path = folder / f"{name}.md"
    path.write_text("\n\n".join([f"# {title}", head, *body]) + "\n", encoding="utf-8")
    return path


def machine() -> str:
    """Return processor, number of cores, Python and libraries in words."""
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return f"{_processor()}, {os.cpu_count()} cores, Python {platform.python_version()}, {libraries}"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())
