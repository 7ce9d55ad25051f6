"""Pages of results in ``docs/results``: a title, the command that wrote the page, the machine, and tables."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from bench.report import COLUMNS, BenchRow

RESULTS = Path(__file__).parents[1] / "docs" / "results"
LIBRARIES = ("numpy", "scipy")


def write_page(name: str, title: str, command: str, body: Sequence[str], folder: Path = RESULTS) -> Path:
    """Write a page of results, and return its path.

    Args:
        name: Of the file, without its suffix.
        body: Paragraphs and tables in Markdown; an empty line is put between them.
        folder: Where the page goes; made if missing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    head = f"Written by `{command}`: {machine()}."
    path = folder / f"{name}.md"
    path.write_text("\n\n".join([f"# {title}", head, *body]) + "\n", encoding="utf-8")
    return path


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[int] = ()) -> str:
    """Return a table in Markdown.

    Args:
        header: (n,) titles of the columns.
        rows: (m,) rows of n cells each.
        right: Numbers of the columns that are set flush right.
    """
    rule = ["---:" if column in right else "---" for column in range(len(header))]
    cells = [[cell.replace("|", "\\|") for cell in row] for row in (header, rule, *rows)]
    return "\n".join(f"| {' | '.join(row)} |" for row in cells)


def ended(rows: Sequence[BenchRow], name: str, title: str, command: str | None) -> int:
    """Write the page of a bench where a command is given for it; return 1 where a row falls short.

    Args:
        command: What writes it, as it is typed; None for no page.
    """
    if command is not None:
        write_page(name, title, command, [markdown_table(COLUMNS, [row.cells for row in rows])])
    return 0 if all(row.met for row in rows) else 1


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
