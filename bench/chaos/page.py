"""The page ``docs/results/chaos.md``: a section for each part, kept until the part runs again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.results_page import RESULTS, machine, markdown_table

TITLE = "# What operation does to the product"
COLUMNS = ("what", "measured", "reach", "met")


def write_section(
    name: str, summary: str, command: str, seconds: float, cells: Sequence[Sequence[str]], folder: Path = RESULTS
) -> Path:
    """Put what a part measured in its section of the page, in place of what it measured before; return the page.

    Args:
        cells: (n, 4) what, measured, reach and met of each row.
        folder: Where the page is; made if missing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "chaos.md"
    sections = dict(_sections(path.read_text(encoding="utf-8"))) if path.exists() else {}
    head = f"Written by `{command}` in {seconds:.0f} s: {machine()}."
    sections[name] = "\n\n".join([f"{summary[0].upper()}{summary[1:]}.", head, markdown_table(COLUMNS, cells)])
    path.write_text(_page(sections), encoding="utf-8")
    return path


def _sections(page: str) -> Mapping[str, str]:
    parts = (text.partition("\n") for text in page.split("\n## ")[1:])
    return {name.strip(): body.strip() for name, _, body in parts}


def _page(sections: Mapping[str, str]) -> str:
    bodies = (f"## {name}\n\n{sections[name]}" for name in sorted(sections))
    return "\n\n".join([TITLE, "Each section was written by the command in it.", *bodies]) + "\n"
