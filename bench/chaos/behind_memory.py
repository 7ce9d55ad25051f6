"""Memory of a process, at a tenth of what it is given and at the end."""

from __future__ import annotations

import resource
from pathlib import Path

from bench.report import BenchRow

MOST_GROWTH_MB = 16.0


def resident_mb(pid: int) -> float:
    """Return how much memory a process has, MB."""
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize() / 1e6


def grown(what: str, early_mb: float, late_mb: float) -> BenchRow:
    """Return the row of memory that is to stay flat.

    Args:
        early_mb, late_mb: At a tenth, and at the end.
    """
    measured = f"{early_mb:.0f} MB at a tenth, {late_mb:.0f} MB at the end"
    return BenchRow(what, measured, f"{MOST_GROWTH_MB:g} MB more at most", late_mb - early_mb <= MOST_GROWTH_MB)
