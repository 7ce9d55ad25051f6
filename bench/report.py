"""One line of a benchmark report, and how lines are printed as they come."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rich.console import Console

COLUMNS = ("what", "measured", "reach", "met")
SHORT = "NO"
"""In the last column of a row that falls short."""


@dataclass(frozen=True, slots=True)
class BenchRow:
    """What was measured, what it gave, what was to be reached, and whether it was."""

    what: str
    measured: str
    reach: str
    met: bool

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """As text, for a table of the columns ``COLUMNS``."""
        return self.what, self.measured, self.reach, "yes" if self.met else SHORT


def printed(rows: Iterable[BenchRow]) -> list[BenchRow]:
    """Print each row as soon as it is there, and return all of them."""
    console, found = Console(), []
    for row in rows:
        console.print("  ".join(row.cells), highlight=False, soft_wrap=True)
        found.append(row)
    return found
