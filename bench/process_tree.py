"""Processor time and memory of this process with all that it started, and that these started."""

from __future__ import annotations

import os
from pathlib import Path

from bench.worker_kinds import TICKS


def tree(root: int) -> list[int]:
    """Return the number of a process and of all that descend from it and run."""
    found, left = [], [root]
    while left:
        pid = left.pop()
        found.append(pid)
        for children in Path(f"/proc/{pid}/task").glob("*/children"):
            left += map(int, _text(children).split())
    return found


def cpu_of_tree() -> float:
    """Return the processor time of all of them so far, with that of children that have ended, s."""
    fields = (_text(Path(f"/proc/{pid}/stat")).rpartition(") ")[2].split() for pid in tree(os.getpid()))
    return sum(sum(map(int, one[11:15])) for one in fields if one) / TICKS


def memory_of_tree() -> int:
    """Return the memory of all of them, in which what several share counts once, bytes."""
    total = 0
    for pid in tree(os.getpid()):
        for line in _text(Path(f"/proc/{pid}/smaps_rollup")).splitlines():
            if line.startswith("Pss:"):
                total += 1024 * int(line.split()[1])
    return total


def _text(path: Path) -> str:
    """Return what a file of the kernel says; nothing where its process is gone."""
    try:
        return path.read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
