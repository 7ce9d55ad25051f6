"""One line of a benchmark report."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BenchRow:
    """What was measured, what it gave, what was to be reached, and whether it was."""

    what: str
    measured: str
    reach: str
    met: bool
